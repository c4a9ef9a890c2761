"""What the `validate` runner does: matches, EM readings and perhaps the truth in, verdicts out."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ursnav_torch.columns import POSE_COLUMNS
from ursnav_torch.em_log import EmFormat, EmJoin, join_names, join_pictures, read_em_samples
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import Array
from ursnav_torch.registration.files import read_landmarks
from ursnav_torch.registration.readings import check_em_unit
from ursnav_torch.registration.result import Registration
from ursnav_torch.registration.validation import (
    Comparison,
    Confusion,
    ErrorBudget,
    camera_errors,
    compare_poses,
    confusion,
    position_threshold,
)
from ursnav_torch.tables import Row, numbers, read_csv
from ursnav_torch.tracking.tracker import TRACKING
from ursnav_torch.vid import poses_from_rows

BoolArray = NDArray[np.bool_]

_NAME_THEM = "name the columns em_x_{unit}, em_y_{unit}, em_z_{unit}"


@dataclass(frozen=True, slots=True, eq=False)
class Verdicts:
    """Two verdicts on every match.

    Attributes:
        images: N names. calyx: N matched calyces.
        error: N sentences, "" where there is a verdict.
        comparison: of the rows without error, in their order.
        distance_mm: (N,) the distance that the position rule compares; NaN where there is none.
        threshold_mm: its threshold, and from_pairs: whether it is the thesis's, from reference pairs.
        e_cam_mm: (K,) of the reference pairs.
        least_p: a match with a smaller p-value is judged wrong.
        truth: N true calyces, "" where unknown.
        readings: how many pictures have a reading, for people to read.
    """

    images: list[str]
    calyx: list[str]
    error: list[str]
    comparison: Comparison
    distance_mm: Array
    threshold_mm: float
    from_pairs: bool
    e_cam_mm: Array
    least_p: float
    truth: list[str]
    readings: str

    @property
    def judged(self) -> BoolArray:
        """(N,) which rows have a verdict."""
        return np.array([not e for e in self.error], bool)

    @property
    def right_by_position(self) -> BoolArray:
        """(N,) judged right by distance alone."""
        return self.distance_mm <= self.threshold_mm

    @property
    def right(self) -> BoolArray:
        """(N,) judged right by position and direction."""
        found = np.zeros(len(self.images), bool)
        found[self.judged] = self.comparison.p >= self.least_p
        return found

    def confusions(self) -> dict[str, Confusion]:
        """Both rules against the truth, over the rows that have a verdict and a known truth."""
        scored = self.judged & np.array([bool(t) for t in self.truth], bool)
        true = np.array([c == t for c, t in zip(self.calyx, self.truth, strict=True)], bool)
        rules = {"position": self.right_by_position, "position_and_direction": self.right}
        return {name: confusion(true[scored], rule[scored]) for name, rule in rules.items()}


def judge_matches(
    matches: str | Path,
    em: str | Path,
    registration: Registration,
    *,
    sensor_offset_mm: tuple[float, float, float] | None = None,
    reference_pairs: str | Path | None = None,
    truth: str | Path | None = None,
    budget: ErrorBudget | None = None,
    least_p: float = 0.01,
    form: EmFormat | None = None,
) -> Verdicts:
    """Judge the rows of a `match` file by EM readings.

    The position rule is the thesis's where reference pairs are given: camera and sensor closer than its threshold.
    Without them the sensor's offset is allowed for, and the threshold is the distance that a right match exceeds with
    probability ``least_p``. Without an offset but with reference pairs, their RMS is the match's position error in the
    second rule too.

    Args:
        matches: CSV of `match`.
        em: CSV of EM samples, joined by image, frame or time.
        registration: EM to kidney.
        sensor_offset_mm: sensor in the camera frame; None takes it to sit at the camera.
        reference_pairs: CSV of virtual cameras (kidney columns) and sensor positions (em columns), as in table 5.2.
        truth: CSV with `image,calyx`.
        budget: root mean square errors.
        least_p: smallest p-value of a match that is judged right.
        form: what the EM file does not tell.

    Raises:
        InputError: a file cannot be used, or no match has a reading.
    """
    if not 0 < least_p < 0.5:
        raise InputError(f"least_p={least_p} must lie between 0 and 0.5, such as 0.01.")
    budget, e_cam = budget or ErrorBudget(), np.zeros(0)
    if reference_pairs is not None:
        pairs = read_landmarks(reference_pairs)
        check_em_unit(
            pairs.em_mm, lambda p: camera_errors(registration, p, pairs.kidney_mm), str(reference_pairs), _NAME_THEM
        )
        e_cam = camera_errors(registration, pairs.em_mm, pairs.kidney_mm)
        if sensor_offset_mm is None:
            budget = replace(budget, match_mm=float(np.sqrt(np.mean(e_cam**2))))
    rows, images, joined, error = _read(Path(matches), em, form)
    usable = np.array([not e for e in error], bool)
    T = poses_from_rows([row for row, ok in zip(rows, usable, strict=True) if ok])
    sensor, axis = joined.samples.position_mm[usable], joined.samples.axis[usable]
    check_em_unit(sensor, lambda p: camera_errors(registration, p, T[:, :3, 3]), str(em))
    comparison = compare_poses(T, sensor, axis, registration, np.array(sensor_offset_mm or (0.0, 0.0, 0.0)), budget)
    distance = np.full(len(rows), np.nan)
    if len(e_cam):
        threshold = position_threshold(e_cam, registration.scale * budget.em_mm)
        distance[usable] = camera_errors(registration, sensor, T[:, :3, 3])
    else:
        threshold = float(np.median(comparison.expected_mm) * np.sqrt(chi2.isf(least_p, 3) / 3))
        distance[usable] = comparison.distance_mm
    return Verdicts(
        images=images,
        calyx=[row["calyx"] for row in rows],
        error=error,
        comparison=comparison,
        distance_mm=distance,
        threshold_mm=threshold,
        from_pairs=bool(len(e_cam)),
        e_cam_mm=e_cam,
        least_p=least_p,
        truth=_truth(images, truth),
        readings=joined.said(),
    )


def verdict_report(verdicts: Verdicts, scale: float) -> dict[str, Any]:
    """The `validate` JSON: threshold, a verdict an image, confusion matrices where the truth is known; plain data.

    Args:
        verdicts: what was judged.
        scale: of the kidney, for people to read: 1.0 anatomy, 1.8 the thesis's phantom.
    """
    e = verdicts.e_cam_mm
    report: dict[str, Any] = {
        "scale": scale,
        "threshold_mm": verdicts.threshold_mm,
        "threshold_from": "reference_pairs" if verdicts.from_pairs else "error_budget",
        "e_cam_mm": e.tolist(),
        "e_cam_mean_mm": float(e.mean()) if len(e) else None,
        "e_cam_std_mm": float(e.std(ddof=1)) if len(e) > 1 else None,
        "least_p": verdicts.least_p,
        "images": _image_rows(verdicts),
    }
    if any(verdicts.truth):
        report["confusion"] = {
            name: asdict(c) | {"balanced_accuracy": c.balanced_accuracy if np.isfinite(c.balanced_accuracy) else None}
            for name, c in verdicts.confusions().items()
        }
    return report


def verdict_summary(verdicts: Verdicts, scale: float) -> str:
    """A few lines for people; mm at the kidney's ``scale``."""
    judged = int(verdicts.judged.sum())
    source = "reference pairs" if verdicts.from_pairs else "error budget"
    lines = [
        verdicts.readings,
        f"{judged} of {len(verdicts.images)} matches judged; right by position and direction "
        f"{int(verdicts.right.sum())}, by position alone {int(verdicts.right_by_position.sum())}",
        f"threshold of the position rule {verdicts.threshold_mm:.2f} mm at scale {scale:g}, from {source}",
    ]
    if verdicts.from_pairs:
        e = verdicts.e_cam_mm
        lines.append(f"e_cam {' '.join(f'{x:.2f}' for x in e)}: mean {e.mean():.2f}, deviation {e.std(ddof=1):.2f} mm")
    if any(verdicts.truth):
        lines += [
            f"{name.replace('_', ' ')}: TP {c.TP} FN {c.FN} FP {c.FP} TN {c.TN}, "
            + (f"balanced accuracy {c.balanced_accuracy:.1%}" if c.balanced_accuracy >= 0 else "one kind only")
            for name, c in verdicts.confusions().items()
        ]
    return "\n".join(lines)


def _image_rows(verdicts: Verdicts) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    judged = np.cumsum(verdicts.judged) - 1
    found = verdicts.comparison
    for i, (image, calyx, error) in enumerate(zip(verdicts.images, verdicts.calyx, verdicts.error, strict=True)):
        row: dict[str, Any] = {"image": image, "calyx": calyx}
        if error:
            row |= {"verdict": None, "verdict_by_position": None, "error": error}
        else:
            angle = float(np.degrees(found.angle_rad[judged[i]]))
            row |= {
                "verdict": "right" if verdicts.right[i] else "wrong",
                "verdict_by_position": "right" if verdicts.right_by_position[i] else "wrong",
                "distance_mm": float(verdicts.distance_mm[i]),
                "angle_deg": angle if np.isfinite(angle) else None,
                "p": float(found.p[judged[i]]),
            }
        if verdicts.truth[i]:
            row["truth"] = verdicts.truth[i]
        rows.append(row)
    return rows


def _read(matches: Path, em: str | Path, form: EmFormat | None) -> tuple[list[Row], list[str], EmJoin, list[str]]:
    """Rows, their names, the reading of each, and what is missing in each ("": nothing)."""
    rows = read_csv(matches, ("calyx", *POSE_COLUMNS), "match")
    column = next((name for name in ("image", "frame") if name in rows[0]), None)
    if column is None:
        raise InputError(f"The match file {matches} lacks a column image (or frame, as `track` writes it).")
    images = [row[column] for row in rows]
    t_s = numbers(rows, ("t_s",))[:, 0] if "t_s" in rows[0] else None
    joined = join_pictures(read_em_samples(em, form), images, t_s, form)
    error = [_what_is_missing(row, seen) for row, seen in zip(rows, joined.samples.seen, strict=True)]
    if all(error):
        raise InputError(f"None of the {len(rows)} rows of {matches} can be judged; the first: {error[0]}.")
    return rows, images, joined, error


def _what_is_missing(row: Row, seen: bool) -> str:
    if row.get("error"):
        return f"no match: {row['error']}"
    if not all(row[c].strip() for c in POSE_COLUMNS):
        return "no match: the row has no pose"
    if row.get("state", TRACKING) != TRACKING:  # a track's, which it does not believe itself
        return f"no match: {row['state']}"
    return "" if seen else "no EM reading for this image"


def _truth(images: list[str], path: str | Path | None) -> list[str]:
    if path is None:
        return [""] * len(images)
    rows = read_csv(path, ("image", "calyx"), "truth")
    found = join_names([row["image"] for row in rows], images)
    if np.all(found < 0):
        raise InputError(f"The truth file {path} names none of the {len(images)} images; the first is {images[0]!r}.")
    return [rows[i]["calyx"].strip() if i >= 0 else "" for i in found]
