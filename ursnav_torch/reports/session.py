"""What a session was like, as one HTML file that needs nothing else: path, coverage, calyces, doubtful moments."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.columns import POSE_COLUMNS
from ursnav_torch.devices import Frame
from ursnav_torch.errors import InputError
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.files import whole_file
from ursnav_torch.geometry import transform_from_quaternion
from ursnav_torch.kidney import Kidney
from ursnav_torch.navigation import confidence_words
from ursnav_torch.reports.coverage import draw_coverage
from ursnav_torch.reports.html import inline_picture, render_page
from ursnav_torch.reports.overview import draw_overview
from ursnav_torch.reports.session_parts import files_to_keep, film, time_line
from ursnav_torch.reports.stones import NOTHING_TOLD, StonesTold
from ursnav_torch.reports.stretches import DOUBT, DOUBT_S, LONGEST_GAP_S, session_stretches
from ursnav_torch.reports.training import TrainingFigures, as_told, calyx_training, training_figures, training_rows
from ursnav_torch.session import Replay
from ursnav_torch.tracking.tracker import TRACKING
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

#: The path is measured from point to point at least so far apart; longer steps than the last are jumps of the track.
STEP_MM, JUMP_MM = 0.5, 4.0
MOMENTS_SHOWN = 12
#: For a calyx's picture a mm farther from its tip costs as much as this much confidence.
FAR_COSTS = 0.02


@dataclass(frozen=True, slots=True)
class DoubtfulMoment:
    """A doubtful stretch of time: from, to, in seconds; the number of a picture in its middle; and why."""

    from_s: float
    to_s: float
    frame: int
    why: str


@dataclass(slots=True)
class SessionFigures:
    """A session in figures.

    Attributes:
        t_s: (N,) of every picture located, from the first on.
        frame: (N,) its number.
        T_kidney_camera: (M, 4, 4) where the track was believed; ``believed`` (N,) says for which pictures.
        settled: (M,) whether the picture could be of one calyx alone.
        position_sd_mm: (M,) how far off the place may be, NaN where the record does not say.
        calyx: (M,) the calyx in it, blank for none.
        time_in_s: by calyx, and blank for none.
        best: by calyx the number of the picture that shows it surest and from near.
        path_mm, speed_mm_s: length of the way, and the median speed while moving.
        moments: doubtful ones.
        latency_ms: median and 95th percentile.
    """

    t_s: Array
    frame: NDArray[np.int64]
    believed: NDArray[np.bool_]
    T_kidney_camera: Array
    settled: NDArray[np.bool_]
    position_sd_mm: Array
    calyx: list[str]
    time_in_s: dict[str, float] = field(default_factory=dict)
    best: dict[str, int] = field(default_factory=dict)
    path_mm: float = 0.0
    speed_mm_s: float = 0.0
    moments: list[DoubtfulMoment] = field(default_factory=list)
    latency_ms: tuple[float, float] = (0.0, 0.0)


def session_figures(replay: Replay, kidney: Kidney) -> SessionFigures:
    """The figures of a session that was navigated in a kidney; the record's results are used as they are."""
    rows = [(r.frame, r.row) for r in replay.results() if "state" in r.row]
    t = np.array([row["t_s"] for _, row in rows], float)
    t -= t[0] if len(t) else 0.0
    frame = np.array([number for number, _ in rows], np.int64)
    believed = np.array([bool(row["accepted"]) for _, row in rows], bool)
    T = _poses([row for _, row in rows if row["accepted"]])
    settled = np.array(["|" not in str(row.get("calyces", "")) for _, row in rows if row["accepted"]], bool)
    sd = np.array([row.get("position_sd_mm", np.nan) for _, row in rows if row["accepted"]], float)
    calyx = [str(row["calyx"] or "") for _, row in rows if row["accepted"]]
    found = SessionFigures(t, frame, believed, T, settled, sd, calyx)
    lasted = np.minimum(np.diff(t, append=t[-1:]), LONGEST_GAP_S)
    surest: dict[str, float] = {}
    tips = {c.name: c.tip_mm for c in kidney.calyces}
    for (number, row), seconds in zip(rows, lasted, strict=True):
        if row["accepted"]:
            name, sure = str(row["calyx"]), float(row["confidence"])
            found.time_in_s[name] = found.time_in_s.get(name, 0.0) + float(seconds)
            worth = sure - FAR_COSTS * _from_tip(row, tips.get(name)) / kidney.scale
            if name and worth > surest.get(name, -np.inf):
                surest[name], found.best[name] = worth, number
    found.path_mm, found.speed_mm_s = _way(T[:, :3, 3], t[believed], kidney.scale)
    found.moments = _doubtful([row for _, row in rows], t, frame)
    latency = [1e3 * row["latency_s"] for _, row in rows if "latency_s" in row]
    if latency:
        found.latency_ms = float(np.median(latency)), float(np.percentile(latency, 95))
    return found


def write_session_report(vid: Vid, replay: Replay, path: Path, stones: StonesTold = NOTHING_TOLD) -> Path:
    """Write the report on a recorded session to an HTML file; returns its path.

    Args:
        vid: in whose kidney it was navigated.
        replay: the record, with results.
        path: of the file.
        stones: what navigation told of them.
    """
    shown = None if stones.picture is None else inline_picture(stones.picture)
    told = {"sentences": stones.sentences, "picture": shown}
    with whole_file(path) as partial:
        text = render_page("session.html.j2", title="Session", stones=told, **session_values(vid, replay))
        partial.write_text(text, encoding="utf-8")
    return path


def write_comparison(vid: Vid, first: Replay, second: Replay, path: Path) -> Path:
    """Write a page with two recorded sessions in one kidney side by side; arguments as of `write_session_report`.

    Raises:
        InputError: a record holds no results: it was never navigated.
    """
    for replay in (first, second):
        if not any("state" in r.row for r in replay.results()):
            raise InputError(
                f"The record {replay.path} holds no results; navigate it first: ursnav navigate vid=... "
                f"hardware=replay hardware.path={replay.path} viewer=none out=FOLDER."
            )
    sides = [session_values(vid, r, prefix) | {"name": r.path.name} for r, prefix in ((first, "a"), (second, "b"))]
    rows = [[side["calyces"][i] for side in sides] for i in range(len(vid.kidney.calyces))]
    with whole_file(path) as partial:
        text = render_page("comparison.html.j2", title="Two sessions", sides=sides, calyces=rows)
        partial.write_text(text, encoding="utf-8")
    return path


def session_values(vid: Vid, replay: Replay, prefix: str = "t") -> dict[str, Any]:
    """What a session's part of a page is filled with; ``prefix`` begins the names of places on the page."""
    figures = session_figures(replay, vid.kidney)
    coverage = Coverage(vid.kidney, vid.camera, vid.lumen, vid.T_kidney_camera[::4])
    passed = np.diff(figures.t_s, prepend=figures.t_s[:1])[figures.believed]
    counts = np.where(figures.settled[:, None, None], figures.T_kidney_camera, np.nan)
    t_s, sd = figures.t_s[figures.believed], figures.position_sd_mm
    training = training_figures(coverage, t_s, figures.calyx, counts, passed, sd)
    training = as_told(training, _told_coverage(replay))
    details = _details(figures, training, replay)
    stretches, pictures = session_stretches(replay), film(replay, prefix)
    return {
        "summary": _summary(figures, len(vid.kidney.calyces)),
        "training": training_rows(training, figures.path_mm, figures.speed_mm_s, vid.kidney.scale),
        "path": [inline_picture(_path_picture(vid, figures, side)) for side in (False, True)],
        "coverage": inline_picture(draw_coverage(coverage, calyces=training.calyces)),
        "pictures": pictures,
        "boxes": time_line(stretches, pictures, replay.duration_s()),
        "files": files_to_keep(stretches, details["calyces"], replay),
        **details,
    }


def _details(figures: SessionFigures, training: TrainingFigures, replay: Replay) -> dict[str, Any]:
    """What the page says and shows of every calyx and of the doubtful moments."""
    shown = figures.moments[:MOMENTS_SHOWN]
    frames = _frames(replay, {*figures.best.values(), *(m.frame for m in shown)})
    pictures = {number: inline_picture(picture) for number, picture in frames.items()}
    calyces = [
        {
            "name": c.calyx,
            "pole": c.pole,
            "verdict": c.verdict,
            "share": f"{c.share:.0%}",
            "time": f"{figures.time_in_s.get(c.calyx, 0.0):.1f} s",
            "frame": figures.best.get(c.calyx, -1),
            "picture": pictures.get(figures.best.get(c.calyx, -1)),
        }
        | calyx_training(training, c.calyx)
        for c in training.calyces
    ]
    moments = [{"words": f"{m.from_s:.1f} to {m.to_s:.1f} s: {m.why}", "picture": pictures.get(m.frame)} for m in shown]
    more = len(figures.moments) - len(shown)
    doubt = {"doubt": confidence_words(DOUBT), "doubt_s": DOUBT_S}
    return {"calyces": calyces, "moments": moments, "more": more, **doubt}


def _told_coverage(replay: Replay) -> list[tuple[float, dict[str, list[Any]]]]:
    """When navigation told anew of coverage, s, and what: verdict and share by the calyx."""
    rows = [result.row for result in replay.results()]
    return [(float(row["t_s"]), json.loads(row["coverage"])) for row in rows if row.get("coverage")]


def _poses(rows: list[dict[str, Any]]) -> Array:
    """T_kidney_camera (N, 4, 4) of results' rows."""
    values = [[r[c] for c in POSE_COLUMNS] for r in rows]
    found = [transform_from_quaternion(v[:3], v[3:]) for v in values]
    return np.array(found, float).reshape(-1, 4, 4)


def _way(positions: Array, t: Array, scale: float) -> tuple[float, float]:
    """Length of a path (N, 3) and the median speed over its steps of `STEP_MM`, jumps left out."""
    kept = [0] if len(positions) else []
    for i in range(1, len(positions)):
        if np.linalg.norm(positions[i] - positions[kept[-1]]) >= STEP_MM * scale:
            kept.append(i)
    if len(kept) < 2:
        return 0.0, 0.0
    step = np.linalg.norm(np.diff(positions[kept], axis=0), axis=1)
    seconds = np.diff(t[kept])
    fine = (step <= JUMP_MM * scale) & (seconds > 0)
    return float(step[fine].sum()), float(np.median(step[fine] / seconds[fine])) if fine.any() else 0.0


def _from_tip(row: dict[str, Any], tip_mm: Array | None) -> float:
    """Distance of a row's camera from a calyx's tip, mm."""
    return 0.0 if tip_mm is None else float(np.linalg.norm(tip_mm - [row[c] for c in POSE_COLUMNS[:3]]))


def _doubtful(rows: list[dict[str, Any]], t: Array, frame: NDArray[np.int64]) -> list[DoubtfulMoment]:
    """Stretches without a place, or with one that is not sure."""
    why = [_doubt(row) for row in rows]
    moments, begun = [], 0
    for i in range(1, len(rows) + 1):
        if i == len(rows) or why[i] != why[begun]:
            if why[begun] and t[i - 1] - t[begun] >= DOUBT_S:
                moments.append(
                    DoubtfulMoment(float(t[begun]), float(t[i - 1]), int(frame[(begun + i - 1) // 2]), why[begun])
                )
            begun = i
    return moments


def _doubt(row: dict[str, Any]) -> str:
    """Why a picture's answer is doubtful; blank where it is not."""
    if row["accepted"]:
        return "unsure" if row["confidence"] < DOUBT else ""
    return "the picture shows too little" if row["state"] == TRACKING else str(row["state"])


def _frames(replay: Replay, numbers: set[int]) -> dict[int, Picture]:
    found: dict[int, Picture] = {}
    for event in replay.events():
        if isinstance(event, Frame) and event.stamp.sequence in numbers:
            found[event.stamp.sequence] = event.image
        if len(found) == len(numbers):
            break
    return found


def _summary(figures: SessionFigures, calyces: int) -> dict[str, str]:
    seconds = float(figures.t_s[-1]) if len(figures.t_s) else 0.0
    tracked = figures.believed.mean() if len(figures.believed) else 0.0
    return {
        "duration": f"{seconds:.0f} s",
        "pictures located": f"{len(figures.t_s)}, {tracked:.0%} of them with a place that was believed",
        "calyces looked into": f"{sum(1 for name in figures.time_in_s if name)} of {calyces}",
        "picture to pose": f"{figures.latency_ms[0]:.0f} ms median, {figures.latency_ms[1]:.0f} ms 95th percentile",
        "doubtful moments": f"{len(figures.moments)}, {sum(m.to_s - m.from_s for m in figures.moments):.0f} s in all",
    }


def _path_picture(vid: Vid, figures: SessionFigures, from_side: bool) -> Picture:
    """The kidney with the path, blue at its beginning and red at its end."""
    overview = draw_overview(vid.kidney, 480, from_side)
    picture, points = overview.picture.copy(), figures.T_kidney_camera[:, :3, 3]
    at = np.rint(8 * overview.project(points)).astype(int) if len(points) else np.zeros((0, 2), int)
    hues = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0]
    for i in range(1, len(at)):
        if np.linalg.norm(points[i] - points[i - 1]) <= JUMP_MM * vid.kidney.scale:
            color = hues[20 + 215 * i // len(at)].tolist()
            cv2.line(picture, at[i - 1].tolist(), at[i].tolist(), color, 1, cv2.LINE_AA, 3)
    return np.asarray(picture, np.uint8)
