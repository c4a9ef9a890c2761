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
from ursnav_torch.tracking.settings import TrackSettings
from ursnav_torch.tracking.tracker import Tracked, Tracker
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
#: The settings classes of a `Tracker` by their names in `TrackSettings`.
SETTINGS_GROUPS: dict[str, Any] = {f.name: f.default_factory for f in fields(TrackSettings)}
_ROOMS = ("features", "matching", "search", "alignment", "localization", "tracking")


@dataclass(frozen=True, slots=True)
class Choice:
    """Settings of a track: overrides of the `Tracker`'s groups by name, as ``(group, name, value)``.

    ``other`` says that the VID is another kidney's.
    """

    overrides: tuple[tuple[str, str, float], ...] = ()
    other: bool = False

    @classmethod
    def varied(cls, text: str) -> list["Choice"]:
        """``group.name=value,value`` as one choice a value; none of an empty text."""
        if not text:
            return []
        name, _, values = text.partition("=")
        group, _, name = name.partition(".")
        return [cls(((group, name, float(v)),)) for v in values.split(",")]

    def groups(self) -> dict[str, Any]:
        """Arguments for the `Tracker`."""
        found: dict[str, Any] = {}
        kinds = SETTINGS_GROUPS
        for group, name, value in self.overrides:
            if group not in kinds or name not in {f.name for f in fields(kinds[group])}:
                raise InputError(f"{group}.{name} is no setting of tracking; groups are {', '.join(kinds)}.")
            base = found.get(group, kinds[group]())
            found[group] = replace(base, **{name: type(getattr(base, name))(value)})
        return {"settings": TrackSettings(**found)}

    def __str__(self) -> str:
        parts = [f"{g}.{n}={v:g}" for g, n, v in self.overrides] or ["as set"]
        parts += ["in another kidney's VID"] * self.other
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
        extra: (N, K) diagnostics: fit, score, confidence.
    """

    flown: Flown
    state: NDArray[np.str_]
    T: Array
    calyx: NDArray[np.int64]
    true_calyx: NDArray[np.int64]
    extra: Array

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
        answers = list(_answers(seen, Tracker(vid, **choice.groups()), choice))
        np.savez(path, **_arrays(answers))
    with np.load(path) as kept:
        true = observed_calyx(seen.flight.T_kidney_camera, vid.kidney, lumen)
        return Record(seen, true_calyx=true, **{name: kept[name] for name in kept.files})


def _answers(seen: Flown, tracker: Tracker, choice: Choice) -> Iterator[Tracked]:
    for i, features in enumerate(features_of(seen, tracker)):
        yield tracker.follow(features, float(seen.flight.t_s[i]))


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
        "extra": np.array([[a.fit, a.score, a.confidence] for a in answers]),
    }


def _sources(rooms: tuple[str, ...]) -> str:
    """A fingerprint of the code of some rooms."""
    root = Path(ursnav_torch.__file__).parent
    files = sorted(p for room in rooms for p in (root / room).rglob("*.py"))
    return hashlib.sha256(b"".join(p.read_bytes() for p in files)).hexdigest()
