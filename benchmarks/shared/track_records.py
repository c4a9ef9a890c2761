"""Tracks of the flights, as they lie on disk: run once for a choice of settings and a state of the code."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.shared.fingerprints import sources
from benchmarks.shared.flights import Flown
from benchmarks.shared.vary import named_values, with_value
from ursnav_torch.errors import InputError
from ursnav_torch.features import Features
from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney import LumenDistance, observed_calyx
from ursnav_torch.tracking.reading import planes_of, recalled
from ursnav_torch.tracking.robot.odometry import OdometryReading
from ursnav_torch.tracking.settings import TrackSettings
from ursnav_torch.tracking.tracker import Tracked, Tracker, video_refinement
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
#: The settings classes of a `Tracker` by their names in `TrackSettings`.
SETTINGS_GROUPS: dict[str, Any] = {f.name: f.default_factory for f in fields(TrackSettings)}
#: And how poses are aligned in a video.
ALIGNMENT = "alignment"
#: Columns of `Record.told`: score of the alignment; score as taken and fit of the evidence; standard deviation of
#: the position, spread of the hypotheses in mm and degrees, their share for the calyx; way from aligned to smoothed;
#: score of the evidence's decoy; radius of the region that holds the position with 90 %.
TOLD = (
    "score",
    "plain",
    "fit",
    "sd_mm",
    "spread_mm",
    "spread_deg",
    "share",
    "smoothed_mm",
    "decoy",
    "region_mm",
)
_ROOMS = ("features", "matching", "search", "alignment", "localization", "tracking")


@dataclass(frozen=True, slots=True)
class Choice:
    """Settings of a track: overrides of the `Tracker`'s groups by name, as ``(group, name, value)``.

    ``other`` says that the VID is another kidney's, ``odometry`` that the robot is heard, ``breathless`` that the lumen
    does not slide past the scope as the patient breathes.
    """

    overrides: tuple[tuple[str, str, str], ...] = ()
    other: bool = False
    odometry: bool = False
    breathless: bool = False

    def varied(self, text: str) -> list["Choice"]:
        """This with ``group.name=value,value`` as one choice a value; none of an empty text."""
        if not text:
            return []
        path, values = named_values(text)
        group, _, name = path.partition(".")
        return [replace(self, overrides=((group, name, value),)) for value in values]

    def groups(self) -> dict[str, Any]:
        """Arguments for the `Tracker`."""
        found: dict[str, Any] = {}
        kinds = SETTINGS_GROUPS | {ALIGNMENT: video_refinement}
        for group, name, value in self.overrides:
            base = found[group] if group in found else kinds[group]() if group in kinds else None
            if base is None:
                raise InputError(f"{group}.{name} is no setting of tracking; groups are {', '.join(kinds)}.")
            found[group] = with_value(base, name, value)
        refinement = found.pop(ALIGNMENT, None)
        return {"settings": TrackSettings(**found), "refinement": refinement}

    def __str__(self) -> str:
        parts = [f"{g}.{n}={v}" for g, n, v in self.overrides] or ["as set"]
        parts += ["in another kidney's VID"] * self.other + ["with odometry"] * self.odometry
        parts += ["without breathing"] * self.breathless
        return ", ".join(parts)


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """What a tracker said of a flight of N pictures, beside the truth.

    Attributes:
        flown: the flight.
        state: (N,) names.
        T: (N, 4, 4) nan where there is none.
        calyx, true_calyx: (N,) indices, -1 for none.
        off_mm, turned_deg: (N,) errors, nan without a pose.
        told: (N, 10) what the answers say of themselves, see `TOLD`; nan where they say nothing.
    """

    flown: Flown
    state: NDArray[np.str_]
    T: Array
    calyx: NDArray[np.int64]
    true_calyx: NDArray[np.int64]
    told: Array

    @property
    def off_mm(self) -> Array:
        return np.linalg.norm(self.T[:, :3, 3] - self.flown.flight.T_kidney_camera[:, :3, 3], axis=1)

    @property
    def turned_deg(self) -> Array:
        return np.degrees(angle_between(self.T[:, :3, 2], self.flown.flight.T_kidney_camera[:, :3, 2]))


def tracked(seen: Flown, vid: Vid, lumen: LumenDistance, choice: Choice) -> Record:
    """The track of a flight; from disk where the same code with the same settings and VID made it before."""
    key = hashlib.sha256((sources(_ROOMS) + repr(choice) + vid.folder.name).encode()).hexdigest()[:10]
    path = seen.folder / f"{'refused' if choice.other else 'track'}_{key}.npz"
    if not path.exists():
        answers = list(_answers(seen, Tracker(vid, **choice.groups()), choice))
        np.savez(path, **_arrays(answers))
    with np.load(path) as kept:
        true = observed_calyx(seen.flight.T_kidney_camera, vid.kidney, lumen)
        return Record(seen, true_calyx=true, **{name: kept[name] for name in kept.files})


def _answers(seen: Flown, tracker: Tracker, choice: Choice) -> Iterator[Tracked]:
    for i, (features, image) in enumerate(zip(features_of(seen, tracker), seen.images(), strict=True)):
        joints = OdometryReading(*seen.flight.odometry[i].tolist()) if choice.odometry else None
        yield tracker.follow(features, float(seen.flight.t_s[i]), odometry=joints, image=image)


def features_of(seen: Flown, tracker: Tracker) -> Iterator[Features | None]:
    """The pictures' features, kept as `Tracker.planes` beside the pictures until the extractor changes."""
    key = hashlib.sha256((sources(("features",)) + repr(tracker.settings.reading)).encode()).hexdigest()[:10]
    path = seen.folder / f"planes_{key}.npz"
    if not path.exists():
        found = [tracker.extract(image) for image in seen.images()]
        planes = {str(i): planes_of(f).numpy().astype(np.float16) for i, f in enumerate(found) if f is not None}
        np.savez_compressed(path, **planes)
    with np.load(path) as kept:
        for i in range(len(seen.flight.t_s)):
            known = str(i) in kept.files
            yield recalled(torch.from_numpy(kept[str(i)].astype(np.float32))) if known else None


def _arrays(answers: list[Tracked]) -> dict[str, NDArray[Any]]:
    nowhere = np.full((4, 4), np.nan)
    return {
        "state": np.array([a.state for a in answers]),
        "T": np.array([nowhere if a.T_kidney_camera is None else a.T_kidney_camera for a in answers]),
        "calyx": np.array([a.calyx for a in answers]),
        "told": np.array([_told(a) for a in answers]),
    }


def _told(answer: Tracked) -> list[float]:
    """What an answer says of itself, see `TOLD`."""
    found, sure, T, aligned = answer.evidence, answer.certainty, answer.T_kidney_camera, answer.T_aligned
    seen = [np.nan] * 2 if found is None else [found.score, found.fit]
    known, region = [np.nan] * 4, np.nan
    if sure is not None:
        e = sure.evidence
        known = [sure.position_sd_mm, e.spread_mm, e.spread_deg, float(e.share[e.calyx])]
        region = sure.region_mm
    off = np.nan if T is None or aligned is None else float(np.linalg.norm(T[:3, 3] - aligned[:3, 3]))
    decoy = np.nan if found is None or found.decoy is None else found.decoy
    return [answer.score, *seen, *known, off, decoy, region]
