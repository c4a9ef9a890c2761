"""Export what was found to other programs: 3D Slicer, DICOM archives, Foxglove (MCAP), evo (TUM)."""

from typing import Any

from ursnav_torch._runner import caller_path, runner

#: Overrides that name files besides those that all runners share.
PATHS = ("track", "landmarks", "em_to_kidney", "segmentation", "scan", "pictures", "record")


@runner("export", paths=PATHS)
def main(config: Any) -> None:
    """Call `runs.export.export`."""
    from ursnav_torch.runs.export import ExportInputs, export

    paths = {key: None if config[key] is None else caller_path(config[key]) for key in ("vid", *PATHS)}
    series = None if config.series is None else str(config.series)
    inputs = ExportInputs(frame=config.frame, series=series, **paths)
    print(export(str(config.to), inputs, caller_path(config.out), config.overwrite))


if __name__ == "__main__":
    main()
