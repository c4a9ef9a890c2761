"""What is collected while a kidney is explored: views, names, landmarks; kept as files that other runners read."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.columns import LANDMARK_COLUMNS, TRUTH_COLUMNS
from ursnav_torch.errors import InputError
from ursnav_torch.files import whole_folder, write_csv, write_image
from ursnav_torch.geometry import transform_from
from ursnav_torch.kidney import Kidney, LumenDistance, observed_calyx, write_calyces
from ursnav_torch.rendering import RayScene, Renderer
from ursnav_torch.vid import PlanSettings, pose_cells
from ursnav_torch.vid.plan import plan_views

Array = NDArray[np.float64]

#: The camera keeps this far from the wall, mm at scale 1.
CLEARANCE_MM = 0.6
#: Ways to fly: translation in the camera frame, and rotation about its axes; one step or one step's angle each.
FLIGHT = {
    "forward": ((0, 0, 1), (0, 0, 0)),
    "back": ((0, 0, -1), (0, 0, 0)),
    "look left": ((0, 0, 0), (0, -1, 0)),
    "look right": ((0, 0, 0), (0, 1, 0)),
    "look up": ((0, 0, 0), (1, 0, 0)),
    "look down": ((0, 0, 0), (-1, 0, 0)),
    "roll left": ((0, 0, 0), (0, 0, -1)),
    "roll right": ((0, 0, 0), (0, 0, 1)),
}


def fly(
    T_kidney_camera: Array, move: str, lumen: LumenDistance, step_mm: float, turn_rad: float, scale: float
) -> Array:
    """The pose (4, 4) after one of `FLIGHT`; a step that would touch the wall is not made.

    Raises:
        InputError: there is no such move.
    """
    if move not in FLIGHT:
        raise InputError(f"There is no move {move!r}; there are {', '.join(FLIGHT)}.")
    shift, turn = (np.array(v, float) for v in FLIGHT[move])
    R, _ = cv2.Rodrigues(turn * turn_rad)
    T = T_kidney_camera @ transform_from(R, shift * step_mm)
    here, there = lumen.clearance_mm(np.stack([T_kidney_camera[:3, 3], T[:3, 3]]))
    return T if there >= min(CLEARANCE_MM * scale, here) else T_kidney_camera


def pick_wall(scene: RayScene, origin_mm: Array, direction: Array) -> Array | None:
    """The place (3,) where a ray from outside meets the wall first; None where it passes by."""
    if not np.linalg.norm(direction) > 0:
        return None
    way = np.asarray(direction, float) / np.linalg.norm(direction)
    depth, _ = scene.cast(np.asarray(origin_mm, float)[None], way[None])
    return np.asarray(origin_mm, float) + depth[0] * way if np.isfinite(depth[0]) else None


@dataclass(slots=True)
class Collection:
    """Views, calyces' names and landmarks of one kidney.

    Attributes:
        kidney: with the names as they stand.
        T_kidney_camera: the views' poses, each (4, 4).
        landmarks_mm: places on the wall, each (3,).
    """

    kidney: Kidney
    T_kidney_camera: list[Array] = field(default_factory=list)
    landmarks_mm: list[Array] = field(default_factory=list)

    def rename(self, old: str, new: str) -> None:
        """Give a calyx another name.

        Raises:
            InputError: the name is empty, taken or reserved, or there is no such calyx.
        """
        names, new = [c.name for c in self.kidney.calyces], new.strip()
        if old not in names:
            raise InputError(f"There is no calyx {old!r}; there are {', '.join(names)}.")
        if new in names and new != old:
            raise InputError(f"A calyx cannot be called {new!r}: another one is, and names are unique.")
        calyces = tuple(replace(c, name=new) if c.name == old else c for c in self.kidney.calyces)
        self.kidney = replace(self.kidney, calyces=calyces)

    def plan(self, settings: PlanSettings, lumen: LumenDistance) -> int:
        """Replace the views by planned ones; returns how many there are."""
        self.T_kidney_camera = list(plan_views(self.kidney, lumen, settings).T_kidney_camera)
        return len(self.T_kidney_camera)

    def save(self, folder: Path, renderer: Renderer, lumen: LumenDistance, overwrite: bool) -> str:
        """Write all to a folder: ``calyces.csv``, ``poses.csv`` with ``images/`` and ``landmarks.csv``.

        ``build_vid views=imported views.path=FOLDER kidney.calyces=FOLDER/calyces.csv`` makes a VID of it;
        ``register`` takes the landmarks once their EM columns are filled in.

        Returns:
            What was written, for people to read.

        Raises:
            InputError: the folder exists and may not be replaced.
        """
        rows = [dict(zip(LANDMARK_COLUMNS, map(float, p), strict=False)) for p in self.landmarks_mm]
        with whole_folder(folder, overwrite) as work:
            (work / "images").mkdir()
            write_calyces(work / "calyces.csv", self.kidney.calyces, self.kidney.pelvis_mm)
            if self.T_kidney_camera:
                self._write_views(work, renderer, lumen)
            if rows:
                write_csv(work / "landmarks.csv", LANDMARK_COLUMNS, rows)
        return f"{len(self.T_kidney_camera)} views, {len(self.kidney.calyces)} names, {len(rows)} landmarks in {folder}"

    def _write_views(self, work: Path, renderer: Renderer, lumen: LumenDistance) -> None:
        T = np.stack(self.T_kidney_camera)
        calyx = observed_calyx(T, self.kidney, lumen)
        rows = []
        for i, cells in enumerate(pose_cells(T)):
            write_image(work / "images" / f"{i:06d}.png", renderer.render(T[i]).image)
            name = self.kidney.calyces[calyx[i]].name if calyx[i] >= 0 else ""
            rows.append({"image": f"{i:06d}.png", "calyx": name} | cells)
        write_csv(work / "poses.csv", TRUTH_COLUMNS, rows)
