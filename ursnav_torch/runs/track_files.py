"""A track's rows again: written for other tools, and scored where the true poses are known."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.columns import POSE_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.evaluation import frames_to_loss, jitter_mm, pose_errors, success, trajectory_error_mm, write_tum
from ursnav_torch.exploration import ExplorationSettings
from ursnav_torch.files import fingerprint, write_json
from ursnav_torch.results import WholeSet
from ursnav_torch.stones import KnownStone
from ursnav_torch.tables import number, read_csv, whole_number
from ursnav_torch.tracking.tracker import TRACKING
from ursnav_torch.units import check_in_box
from ursnav_torch.vid import poses_from_rows

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TrackFile:
    """The rows of a track.

    Attributes:
        frame: (N,) numbers of the pictures.
        t_s: (N,) when they were taken.
        T_kidney_camera: (N, 4, 4), nan unless tracking: a pose that is searched about is none.
        calyx: of each, blank for none.
        state: of each.
    """

    frame: NDArray[np.int64]
    t_s: Array
    T_kidney_camera: Array
    calyx: list[str]
    state: list[str]


def read_track(path: Path) -> TrackFile:
    """The rows that `track` wrote.

    Raises:
        InputError: there are none, or one cannot be read.
    """
    rows = read_csv(path, ("frame", "t_s", "calyx", *POSE_COLUMNS, "state"), "track")
    T = np.full((len(rows), 4, 4), np.nan)
    known = [i for i, row in enumerate(rows) if row["x_mm"].strip() and row["state"] == TRACKING]
    if known:
        T[known] = poses_from_rows([rows[i] for i in known])
    frame, t_s = np.array([whole_number(row, "frame") for row in rows]), np.array([number(row, "t_s") for row in rows])
    return TrackFile(frame, t_s, T, [r["calyx"] for r in rows], [r["state"] for r in rows])


@dataclass(frozen=True, slots=True)
class Truth:
    """The true poses (N, 4, 4) of pictures 0 to N - 1, and their calyces (N), blank for none; None: not told."""

    T_kidney_camera: Array
    calyx: list[str] | None


def read_truth(path: Path, box_mm: Array | None = None) -> Truth:
    """A CSV file with the seven pose columns and perhaps ``calyx``, a row a picture from the first on.

    Raises:
        InputError: it cannot be read, or lies in the kidney's box (2, 3) in another unit than mm alone.
    """
    rows = read_csv(path, POSE_COLUMNS, "truth")
    calyx = [row["calyx"] for row in rows] if "calyx" in rows[0] else None
    T = poses_from_rows(rows)
    if box_mm is not None:
        check_in_box(T[:, :3, 3], box_mm, f"The {len(T)} poses of {path}")
    return Truth(T, calyx)


def score_track(track: TrackFile, truth: Truth) -> dict[str, float | int | None]:
    """A track beside the true poses: plain numbers by name, None where nothing is known.

    Raises:
        InputError: a picture has no true pose.
    """
    known = len(truth.T_kidney_camera)
    if track.frame.max() >= known:
        raise InputError(
            f"The track goes to picture {track.frame.max()}, but the truth has {known} rows; it needs one for every "
            "picture, from picture 0 on."
        )
    T_true = truth.T_kidney_camera[track.frame]
    errors = pose_errors(track.T_kidney_camera, T_true)
    named = ["" if truth.calyx is None else truth.calyx[i] for i in track.frame.tolist()]
    right = [ours == theirs for ours, theirs in zip(track.calyx, named, strict=True) if theirs]
    found = {
        "right_calyx": np.mean(right) if right else np.nan,
        "not_tracking": np.mean([state != TRACKING for state in track.state]),
        "position_mm": _quantile(errors.position_mm, 0.5),
        "position_90_mm": _quantile(errors.position_mm, 0.9),
        "direction_deg": np.degrees(_quantile(errors.direction, 0.5)),
        "roll_deg": np.degrees(_quantile(errors.roll, 0.5)),
        "needle_mm": _quantile(errors.needle_mm, 0.5),
        "trajectory_error_mm": trajectory_error_mm(errors),
        "jitter_mm": jitter_mm(track.T_kidney_camera, T_true),
        "within_5_mm": success(errors, 5.0),
        "within_10_mm": success(errors, 10.0),
        "frames_to_loss": frames_to_loss(errors),
    }
    numbers = {name: round(float(value), 4) if np.isfinite(value) else None for name, value in found.items()}
    return {"pictures": len(track.frame)} | numbers


@dataclass(frozen=True, slots=True)
class Besides:
    """What is made of a track's rows, beside them: ``.score.json`` where the truth is known, and ``.tum``.

    Attributes:
        truth: the true poses, or None.
        tum: whether ``.tum`` is asked for.
        inputs: files and folders that the track is made from; they tell it from another track of the same name.
        exploration: when wall counts as seen, what the scope can do, how stones are told.
        known_stones: those of a scan.
    """

    truth: Truth | None = None
    tum: bool = False
    inputs: tuple[Path, ...] = ()
    exploration: ExplorationSettings = field(default_factory=ExplorationSettings)
    known_stones: tuple[KnownStone, ...] = ()

    def paths(self, out: Path) -> tuple[Path, ...]:
        """The files to be made beside the rows in ``out``."""
        wanted = ((self.truth is not None, ".score.json"), (self.tum, ".tum"))
        return tuple(out.with_suffix(ending) for is_wanted, ending in wanted if is_wanted)

    def fingerprints(self) -> list[list[Any]]:
        """Name, size and sha256 of every input, and of every file in a folder among them."""
        files = [f for path in self.inputs for f in (sorted(path.rglob("*")) if path.is_dir() else [path])]
        return [[str(file), *fingerprint(file)] for file in files if not file.is_dir()]

    def write(self, whole: WholeSet) -> tuple[str, bool]:
        """Write what is asked for into the set; the score for people to read, and whether all of that could be done.

        A truth that does not reach to the track's end costs the score, not the track.
        """
        out = whole.paths[0]
        track = read_track(whole.staged(out)) if self.paths(out) else None
        if self.tum and track is not None:
            write_tum(whole.staged(out.with_suffix(".tum")), track.t_s, track.T_kidney_camera)
        if self.truth is None or track is None:
            return "", True
        path = whole.staged(out.with_suffix(".score.json"))
        try:
            found = score_track(track, self.truth)
        except InputError as error:
            write_json(path, {"error": str(error)})
            return f"\nnot scored: {error}", False
        write_json(path, found)
        told = (f"{name} {'-' if value is None else f'{value:g}'}" for name, value in found.items())
        return f"\nagainst the truth: {', '.join(told)}", True


NOTHING_BESIDES = Besides()


def _quantile(errors: Array, share: float) -> float:
    known = errors[np.isfinite(errors)]
    return float(np.quantile(known, share)) if len(known) else np.nan
