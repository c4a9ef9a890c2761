"""An `export` run: what was found, written for other programs."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ursnav_torch.errors import InputError
from ursnav_torch.evaluation import write_tum
from ursnav_torch.exploration.coverage import CoverageSettings, divide_wall
from ursnav_torch.exports import (
    LabeledMask,
    Study,
    calyx_markup,
    inspected_wall,
    lps_from_kidney,
    mask_of_mesh,
    path_markups,
    point_markup,
    read_study,
    write_capture,
    write_fiducials,
    write_markups,
    write_mcap,
    write_seg,
    write_tfm,
)
from ursnav_torch.features import IMAGE_SUFFIXES, read_image
from ursnav_torch.files import check_output, check_output_file, natural_key, whole_file, whole_folder
from ursnav_torch.geometry import Array, apply
from ursnav_torch.records import read_json, to_record
from ursnav_torch.registration import Landmarks, Registration, read_landmarks
from ursnav_torch.runs.track_files import read_track
from ursnav_torch.segmentation import Markup, read_scan, write_stl
from ursnav_torch.session import Replay
from ursnav_torch.tables import read_csv
from ursnav_torch.vid import Vid, load_vid


@dataclass(frozen=True, slots=True)
class ExportInputs:
    """What is to be exported; None for what is not.

    Attributes:
        vid: folder of the VID.
        frame: of the kidney's coordinates: ``lps`` or ``ras``.
        track: CSV from `track`; its coverage is taken from the file beside it.
        landmarks: CSV as for `register`.
        em_to_kidney: JSON from `register`.
        segmentation: folder from `segment`.
        scan: folder of the DICOM series that was segmented.
        series: its UID where there are several.
        pictures: a picture, or a folder of them.
        record: folder of a recorded session.
    """

    vid: Path | None = None
    frame: str | None = None
    track: Path | None = None
    landmarks: Path | None = None
    em_to_kidney: Path | None = None
    segmentation: Path | None = None
    scan: Path | None = None
    series: str | None = None
    pictures: Path | None = None
    record: Path | None = None


def export(to: str, inputs: ExportInputs, out: Path, overwrite: bool = False) -> str:
    """Write what ``inputs`` name in the format ``to``; a summary for people to read.

    Args:
        to: ``slicer`` or ``dicom`` (folders), ``mcap`` or ``tum`` (files).
        inputs: what there is.
        out: file or folder to be made.
        overwrite: replace what stands there.

    Raises:
        InputError: an unknown format, something it needs is missing, or a file cannot be used.
        MissingExtraError: the format's extra is not installed.
    """
    if to not in _FORMATS:
        raise InputError(f"to={to!r} is no format; accepted are {', '.join(_FORMATS)}.")
    write, needed, used = _FORMATS[to]
    given = {name for name in ExportInputs.__dataclass_fields__ if getattr(inputs, name) is not None}
    missing, idle = [n for n in needed if n not in given], sorted(given - set(needed) - set(used))
    if missing:
        raise InputError(f"to={to} needs {', '.join(f'{name}=' for name in missing)}; --help tells what they are.")
    if idle:
        raise InputError(f"to={to} has no use for {', '.join(f'{name}=' for name in idle)}; leave it out.")
    return write(inputs, out, overwrite)


def _to_slicer(inputs: ExportInputs, out: Path, overwrite: bool) -> str:
    check_output(out, overwrite)
    vid, frame = _vid(inputs), _frame(inputs)
    T = lps_from_kidney(frame)
    with whole_folder(out, overwrite) as work:
        write_stl(work / "kidney.stl", vid.kidney.mesh, str(frame))
        write_markups(work / "calyces.mrk.json", [calyx_markup(vid.kidney, T)])
        if inputs.track is not None:
            write_markups(work / "path.mrk.json", path_markups(read_track(inputs.track).T_kidney_camera, T))
        if inputs.landmarks is not None:
            write_markups(work / "landmarks.mrk.json", [_landmarks(inputs.landmarks, T)])
        if inputs.em_to_kidney is not None:
            write_tfm(work / "em_to_kidney.tfm", Registration.from_json(inputs.em_to_kidney).T_kidney_em, T)
        names = sorted(path.name for path in work.iterdir())
    return f"{', '.join(names)} in {out}; drag them into 3D Slicer."


def _to_dicom(inputs: ExportInputs, out: Path, overwrite: bool) -> str:
    check_output(out, overwrite)
    vid, T = _vid(inputs), lps_from_kidney(_frame(inputs))
    study = read_study(_given(inputs.scan, "scan"), inputs.series)
    mesh = vid.kidney.mesh.copy().apply_transform(T)
    lumen = _label_map(inputs.segmentation, study) if inputs.segmentation else mask_of_mesh(mesh, study)
    lists = {"calyces": calyx_markup(vid.kidney, T)}
    if inputs.landmarks is not None:
        lists["landmarks"] = _landmarks(inputs.landmarks, T)
    with whole_folder(out, overwrite) as work:
        write_seg(work / "lumen.seg.dcm", [LabeledMask("Lumen of the collecting system", lumen)], study, "lumen")
        if inputs.track is not None:
            wall, seen = _coverage(inputs.track, vid)
            write_seg(
                work / "inspected.seg.dcm", inspected_wall(lumen, apply(T, wall), seen, study), study, "inspected"
            )
        write_fiducials(work / "fiducials.dcm", lists, study)
        if inputs.pictures is not None:
            write_capture(work, _pictures(inputs.pictures), study)
        names = sorted(path.name for path in work.iterdir())
    return f"{', '.join(names)} in {out}; all in the frame of reference {study.frame_of_reference}."


def _to_mcap(inputs: ExportInputs, out: Path, overwrite: bool) -> str:
    check_output_file(out, overwrite)
    kidney = None if inputs.vid is None else load_vid(inputs.vid).kidney.mesh
    counts = write_mcap(out, Replay(_given(inputs.record, "record"), speed=0), kidney, overwrite)
    return f"{out}: " + ", ".join(f"{n} {topic}" for topic, n in sorted(counts.items()))


def _to_tum(inputs: ExportInputs, out: Path, overwrite: bool) -> str:
    check_output_file(out, overwrite)
    track = read_track(_given(inputs.track, "track"))
    with whole_file(out, overwrite) as partial:
        write_tum(partial, track.t_s, track.T_kidney_camera)
    return f"{int(np.isfinite(track.T_kidney_camera).all((1, 2)).sum())} poses, in meters, in {out}"


#: By name: what writes it, what it needs, and what else it takes.
_FORMATS: dict[str, tuple[Callable[[ExportInputs, Path, bool], str], tuple[str, ...], tuple[str, ...]]] = {
    "slicer": (_to_slicer, ("vid",), ("frame", "segmentation", "track", "landmarks", "em_to_kidney")),
    "dicom": (_to_dicom, ("vid", "scan"), ("frame", "segmentation", "series", "track", "landmarks", "pictures")),
    "mcap": (_to_mcap, ("record",), ("vid",)),
    "tum": (_to_tum, ("track",), ()),
}


def _given(path: Path | None, name: str) -> Path:
    if path is None:
        raise InputError(f"{name}= is missing.")
    return path


def _vid(inputs: ExportInputs) -> Vid:
    return load_vid(_given(inputs.vid, "vid"))


def _frame(inputs: ExportInputs) -> str | None:
    """What was said, else what the segmentation's own description says.

    Raises:
        InputError: the two contradict each other.
    """
    if inputs.segmentation is None:
        return inputs.frame
    path = inputs.segmentation / "segmentation.json"
    said = str(to_record(read_json(path, "segmentation"), dict[str, Any], str(path)).get("frame", "")).lower()
    if inputs.frame is not None and inputs.frame != said:
        raise InputError(f"frame={inputs.frame}, but {path} says {said.upper()}; leave frame= out.")
    return said


def _label_map(folder: Path, study: Study) -> Any:
    """(X, Y, Z) bool: the voxels that `segment` marked, on the study's grid.

    Raises:
        InputError: they are on another grid.
    """
    path = folder / "labels.nii.gz"
    scan = read_scan(path)
    corners = np.array(np.meshgrid(*([0, n - 1] for n in study.shape))).reshape(3, -1).T
    apart = np.inf
    if scan.voxels.shape == study.shape:
        apart = float(np.abs(scan.to_lps(corners) - apply(study.T_lps_voxel, corners)).max())
    if apart > 0.5 * float(scan.spacing_mm.min()):
        raise InputError(
            f"{path} has {' x '.join(map(str, scan.voxels.shape))} voxels and the scan "
            f"{' x '.join(map(str, study.shape))}, or they lie elsewhere; give the series that it was made from."
        )
    return scan.voxels > 0


def _landmarks(path: Path, T_lps_kidney: Array) -> Markup:
    landmarks: Landmarks = read_landmarks(path)
    rows = read_csv(path, (), "landmark")
    names = [row.get("name", "").strip() or f"L{i + 1}" for i, row in enumerate(rows)]
    return point_markup(names, landmarks.kidney_mm, T_lps_kidney)


def _coverage(track: Path, vid: Vid) -> tuple[Array, list[int]]:
    """Middles of the wall's patches (P, 3), kidney frame, and which of them the track saw.

    Raises:
        InputError: the track has no coverage beside it, or an older one, or one of another kidney.
    """
    path = track.with_suffix(".coverage.json")
    data = to_record(read_json(path, "coverage"), dict[str, Any], str(path))
    try:
        settings = CoverageSettings(**data["settings"])
        seen, count = [int(i) for i in data["seen_patches"]], int(data["patches"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path} does not say which patches of the wall were seen ({error}); make it again: `track` writes it."
        ) from None
    center = divide_wall(vid.kidney, vid.lumen, settings).center_mm
    if count != len(center):
        raise InputError(f"{path} is of a wall in {count} patches, {vid.folder} has {len(center)}: another kidney.")
    return center, seen


def _pictures(path: Path) -> list[tuple[str, Any]]:
    files = [path]
    if path.is_dir():
        found = [p for p in path.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file()]
        files = sorted(found, key=lambda p: natural_key(str(p.relative_to(path))))
    if not files:
        raise InputError(f"The folder {path} holds no picture ({', '.join(IMAGE_SUFFIXES)}).")
    return [(file.name, read_image(file)) for file in files]
