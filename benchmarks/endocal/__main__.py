"""Does `calibrate` agree with the reference intrinsics of endocal (PyPI, BSD-3), pictures of fluid-immersed endoscopes?

    python -m benchmarks.endocal folder=DIR

DIR is the unpacked package's ``endocal/data`` (``pip download --no-deps endocal``). The reference of ``sample_001`` was
made of its first ten pictures, says its file's name, that of ``sample_002`` of all eleven and a board whose dots stand
3 mm apart in rows 1 mm apart. The boards were held almost alike in all pictures, so that few determine so much: with
the eleventh picture the focal length of ``sample_001`` comes out 5 % longer, OpenCV's own just so.
"""

import sys
from pathlib import Path
from typing import Any

import yaml

from benchmarks.shared.results import Report, overrides
from ursnav_torch.calibration import Board, Calibration, calibrate_camera
from ursnav_torch.camera import load_camera
from ursnav_torch.errors import InputError
from ursnav_torch.features import read_image

#: The reference's file, how many pictures it was made of, and from a dot to the next in its row, mm.
_SAMPLES = {"sample_001": ("calibration_001-010.xml", 10, 2.0), "sample_002": ("calibration_001-011.yml", 11, 3.0)}
SETTINGS: dict[str, Any] = {"folder": "", "out": ""}


def reference(path: Path) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy in px of a reference: OpenCV's XML, or the package's own YAML with matrices as text."""
    if path.suffix == ".xml":
        lens = load_camera(path, fov_deg=70.0)  # of the picture's circle; its corners are no picture
        return lens.fx, lens.fy, lens.cx, lens.cy
    text = yaml.safe_load(path.read_text(encoding="utf-8"))["camera_matrix"]
    fx, _, cx, _, fy, cy, *_ = (float(v) for v in text.replace("[", " ").replace("]", " ").split())
    return fx, fy, cx, cy


def found(folder: Path, name: str) -> Calibration:
    """What `calibrate` makes of a sample's pictures."""
    _, count, column_mm = _SAMPLES[name]
    paths = sorted((folder / name).glob("frame_*.jpg"))[:count]
    if len(paths) < count:
        raise InputError(
            f"{folder / name} has {len(paths)} pictures, {count} are needed: give endocal/data as folder=."
        )
    board = Board("asymmetric_circles", 3, 11, 1.0, column_mm=column_mm)
    return calibrate_camera({path.name: read_image(path) for path in paths}, board, "plumb_bob")


def main(arguments: list[str]) -> None:
    """Calibrate both samples; print and keep how far each intrinsic is from the reference's."""
    settings = overrides(SETTINGS, arguments)
    report = Report("endocal", settings | {"folder": ""})
    for name, (file, _, _) in _SAMPLES.items():
        truth = reference(Path(settings["folder"]) / name / file)
        result = found(Path(settings["folder"]), name)
        lens, used = result.camera, len(result.corners)
        note = f"{used} pictures, {result.rms_px:.2f} px RMS, fx {lens.fx:.1f} ± {result.focal_sd_px:.1f} px"
        for what, ours, theirs in zip(
            ("fx", "fy", "cx", "cy"), (lens.fx, lens.fy, lens.cx, lens.cy), truth, strict=True
        ):
            report.add(name, what, "%", [100 * abs(ours / theirs - 1)], note, used)
    report.finish(settings["out"])


if __name__ == "__main__":
    main(sys.argv[1:])
