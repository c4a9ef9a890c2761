"""Tracks of the flights, as they lie on disk: run once for a choice of settings and a state of the code."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

import ursnav_torch
from benchmarks.shared.flights import Flown
from ursnav_torch.errors import InputError
from ursnav_torch.features import Features
from ursnav_torch.geometry import angle_between
from ursnav_torch.kidney import LumenDistance, observed_calyx
from ursnav_torch.tracking.odometry import OdometryReading
from ursnav_torch.tracking.settings import TrackSettings
from ursnav_torch.tracking.tracker import Tracked, Tracker
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
_ROOMS = ("features", "matching", "search", "alignment", "localization", "tracking")


@dataclass(frozen=True, slots=True)
class Choice:
    """Settings of a track: overrides of the `Tracker`'s groups by name, as ``(group, name, value)``.

    ``other`` says that the VID is another kidney's.
    """

    overrides: tuple[tuple[str, str, float], ...] = ()
    odometry: bool = False
    other: bool = False

    @classmethod
    def varied(cls, text: str, odometry: bool) -> list["Choice"]:
        """``group.name=value,value`` as one choice a value; none of an empty text."""
        if not text:
            return []
        name, _, values = text.partition("=")
        group, _, name = name.partition(".")
        return [cls(((group, name, float(v)),), odometry) for v in values.split(",")]

    def settings(self) -> TrackSettings:
        """The settings of a `Tracker`.

        Raises:
            InputError: there is no such setting.
        """
        found = TrackSettings()
        for group, name, value in self.overrides:
            part = getattr(found, group, None)
            if part is None or not hasattr(part, name):
                raise InputError(
                    f"{group}.{name} is no setting of tracking; groups are {', '.join(f.name for f in fields(found))}."
                )
            changed = replace(part, **{name: type(getattr(part, name))(value)})
            found = replace(found, **{group: changed})
        return found

    def __str__(self) -> str:
        parts = [f"{g}.{n}={v:g}" for g, n, v in self.overrides] or ["as set"]
        parts += ["odometry"] * self.odometry + ["in another kidney's VID"] * self.other
        return ", ".join(parts)


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """What a tracker said of a flight of N pictures, beside the truth.

    Attributes:
        flown: the flight.
        state: (N,) names.
        T: (N, 4, 4) nan where there is none.
        calyx, true_calyx: (N,) indices, -1 for none.
        position_sd_mm, direction_sd_deg: (N,) nan where not told.
        off_mm, turned_deg: (N,) errors, nan without a pose.
        aligned: (N, 4, 4) poses before the filter, nan where a picture showed nothing.
        evidence: (N, 4) score, and the three numbers of an `Evidence`.
        right: (N,) probability that the place is the right one.
    """

    flown: Flown
    state: NDArray[np.str_]
    T: Array
    calyx: NDArray[np.int64]
    true_calyx: NDArray[np.int64]
    position_sd_mm: Array
    direction_sd_deg: Array
    aligned: Array
    evidence: Array
    right: Array

    @property
    def off_mm(self) -> Array:
        return np.linalg.norm(self.T[:, :3, 3] - self.flown.flight.T_kidney_camera[:, :3, 3], axis=1)

    @property
    def turned_deg(self) -> Array:
        return np.degrees(angle_between(self.T[:, :3, 2], self.flown.flight.T_kidney_camera[:, :3, 2]))


def tracked(seen: Flown, vid: Vid, lumen: LumenDistance, choice: Choice) -> Record:
    """The track of a flight; from disk where the same code with the same settings made it before."""
    key = hashlib.sha256((_sources(_ROOMS) + repr(choice)).encode()).hexdigest()[:10]
    path = seen.folder / f"{'refused' if choice.other else 'track'}_{key}.npz"
    if not path.exists():
        answers = list(_answers(seen, Tracker(vid, choice.settings()), choice))
        np.savez(path, **_arrays(answers))
    with np.load(path) as kept:
        true = observed_calyx(seen.flight.T_kidney_camera, vid.kidney, lumen)
        return Record(seen, true_calyx=true, **{name: kept[name] for name in kept.files})


def _answers(seen: Flown, tracker: Tracker, choice: Choice) -> Iterator[Tracked]:
    for i, features in enumerate(features_of(seen, tracker)):
        told = OdometryReading(*seen.flight.odometry[i].tolist()) if choice.odometry else None
        yield tracker.follow(features, float(seen.flight.t_s[i]), odometry=told)


def features_of(seen: Flown, tracker: Tracker) -> Iterator[Features | None]:
    """The pictures' features, kept as reliefs beside the pictures until the extractor changes."""
    path = seen.folder / f"relief_{hashlib.sha256(_sources(('features',)).encode()).hexdigest()[:10]}.npy"
    if not path.exists():
        found = [tracker.extract(image) for image in seen.images()]
        camera = tracker.working_camera
        nothing = np.full((camera.height, camera.width), np.nan, np.float16)
        np.save(path, np.array([nothing if f is None else f.fields[0].numpy().astype(np.float16) for f in found]))
    for relief in np.load(path, mmap_mode="r"):
        gone = bool(np.isnan(relief).all())
        yield None if gone else tracker.recall(torch.from_numpy(relief.astype(np.float32)))


def _arrays(answers: list[Tracked]) -> dict[str, NDArray[Any]]:
    nowhere = np.full((4, 4), np.nan)
    return {
        "state": np.array([a.state for a in answers]),
        "T": np.array([nowhere if a.T_kidney_camera is None else a.T_kidney_camera for a in answers]),
        "calyx": np.array([a.calyx for a in answers]),
        "position_sd_mm": np.array([a.position_sd_mm for a in answers]),
        "direction_sd_deg": np.array([a.direction_sd_deg for a in answers]),
        "aligned": np.array([nowhere if a.T_aligned is None else a.T_aligned for a in answers]),
        "evidence": np.array([
            [np.nan] * 4 if a.evidence is None else [a.score, a.evidence.score, a.evidence.lead, a.evidence.fit]
            for a in answers
        ]),
        "right": np.array([a.right for a in answers]),
    }  # fmt: skip


def _sources(rooms: tuple[str, ...]) -> str:
    """A fingerprint of the code of some rooms."""
    root = Path(ursnav_torch.__file__).parent
    files = sorted(p for room in rooms for p in (root / room).rglob("*.py"))
    return hashlib.sha256(b"".join(p.read_bytes() for p in files)).hexdigest()
