"""Segment a CT urography: the surface of the collecting system, a label map, and a picture to check them by."""

from typing import Any

from ursnav_torch._runner import caller_path, progress, runner


@runner("segment", paths=("landmarks", "unenhanced", "kidney.centerline"))
def main(config: Any) -> None:
    """Instantiate the choice and call `segmentation.segment_scan` with it."""
    from hydra.utils import instantiate

    from ursnav_torch.errors import InputError
    from ursnav_torch.segmentation import BesideScan, SegmentationSettings, load_ct_kidney, segment_scan

    out = caller_path(config.out)
    chosen = instantiate(config.kidney, _partial_=True, _convert_="all")
    if chosen.func is not load_ct_kidney:
        raise InputError("Only scans are segmented: kidney=ct. A mesh or a phantom goes straight into build_vid.")
    landmarks, unenhanced = (
        None if given is None else caller_path(given) for given in (config.landmarks, config.unenhanced)
    )
    settings = dict(chosen.keywords)
    path, calyces, centerline = (settings.pop(name) for name in ("path", "calyces", "centerline"))
    beside = BesideScan(calyces, centerline, landmarks, unenhanced)
    made = segment_scan(out, path, SegmentationSettings(**settings), beside, config.overwrite, progress)
    kidney = made.kidney
    poles = ", ".join(f"{c.name} {c.pole}" for c in kidney.calyces)
    print(f"{kidney.mesh.volume / 1000:.2f} mL, {len(kidney.mesh.faces)} triangles; calyces: {poles}")
    print(made.stones.sentence)
    print(f"Look at {out / 'preview.png'} before using {out / 'lumen.stl'}.")


if __name__ == "__main__":
    main()
