"""Make a phantom to print: two halves of a kidney with walls, pins and landmarks, cut through few calyces."""

from typing import Any

from ursnav_torch._runner import caller_path, progress, runner


@runner("print_phantom")
def main(config: Any) -> None:
    """Instantiate the kidney and call `kidney.printing` with it."""
    from hydra.utils import instantiate

    from ursnav_torch.files import check_output
    from ursnav_torch.printing import make_printed_phantom, write_phantom

    out = caller_path(config.out)
    check_output(out, config.overwrite)
    kidney = instantiate(config.kidney, _convert_="all")
    phantom = make_printed_phantom(kidney, float(config.scale), float(config.wall_mm), progress)
    check = write_phantom(phantom, out, config.overwrite)
    crossed = ", ".join(phantom.kidney.calyces[c].name for c in phantom.cut.crossed) or "none"
    print(f"{out}: two halves at {phantom.kidney.scale:g} times anatomy, {check.volume_ml:.1f} mL of material")
    print(f"calyces crossed by the seam: {crossed}; thinnest wall {check.thinnest_wall_mm:.2f} mm")
    if check.thinnest_septum_mm < 0.9 * phantom.wall_mm:
        print(f"between neighboring parts of the lumen the wall is the anatomy's: {check.thinnest_septum_mm:.2f} mm")
    print(f"landmarks to touch: {out / 'landmarks.csv'}; build the VID with the same kidney and kidney.scale")


if __name__ == "__main__":
    main()
