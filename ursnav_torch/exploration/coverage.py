"""Which calyces were seen, and how much of each: the wall painted patch by patch from the scope's poses."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ursnav_torch.camera import Camera
from ursnav_torch.errors import InputError
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.kidney import Kidney, LumenDistance, branch_calyx
from ursnav_torch.rendering import RayScene
from ursnav_torch.scaling import scaled

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

UNSEEN, GLIMPSED, INSPECTED, OUT_OF_REACH = "unseen", "glimpsed", "inspected", "out of reach"
#: A place that may be off is thought to be so far to the side, but no farther than this share of its way to the wall.
_ROOM_SHARE = 0.5
#: Every so many views of a VID are asked what a scope can see at all; neighbors see the same.
REACH_STRIDE = 4


@dataclass(frozen=True, slots=True)
class CoverageSettings:
    """When wall counts as seen; mm at the kidney's scale 1.

    Attributes:
        patch_mm: side of the patches that the wall is divided into.
        calyx_mm: wall of a calyx's own branch within this distance of its tip, along the lumen, is the calyx's.
        nearest_mm, farthest_mm: distances from which a patch is seen sharp and large enough.
        incidence_deg: a patch seen at a greater slant is not seen.
        edge_share: part of the lens's half field within which a patch must lie.
        dwell_s: a patch is seen when it was in view for this long altogether.
        longest_gap_s: a picture counts for the time until the next, but for no longer than this.
        largest_sd_mm: a picture does not count whose place may be off by more (standard deviation). Of the choosing
            flights' 2,669 pictures with a place 89 % are within it and none of these is more than 3 mm off, 94 % of
            2,721 and none with odometry; up to 1.5 mm three are, up to 2 mm ten and three, of all 19 and nine
            (`benchmarks.flights half=choosing phantoms=16`, and with `odometry=true`).
        glimpsed, inspected: shares of a calyx's wall, of what the scope can see of it at all, from which on it is
            glimpsed and inspected.
    """

    patch_mm: float = 1.0
    calyx_mm: float = 10.0
    nearest_mm: float = 1.0
    farthest_mm: float = 10.0
    incidence_deg: float = 70.0
    edge_share: float = 0.95
    dwell_s: float = 0.3
    longest_gap_s: float = 0.25
    largest_sd_mm: float = 0.9
    glimpsed: float = 0.1
    inspected: float = 0.7

    def __post_init__(self) -> None:
        if not 0 < self.nearest_mm < self.farthest_mm or not 0 < self.incidence_deg < 90 or self.patch_mm <= 0:
            raise InputError(
                "Coverage needs 0 < nearest_mm < farthest_mm, 0 < incidence_deg < 90 and patch_mm > 0, got "
                f"{self.nearest_mm}, {self.farthest_mm}, {self.incidence_deg} and {self.patch_mm}."
            )
        if not self.largest_sd_mm > 0:
            raise InputError(f"Coverage needs largest_sd_mm > 0, got {self.largest_sd_mm}.")
        if not 0 < self.glimpsed <= self.inspected <= 1:
            raise InputError(f"Expected 0 < glimpsed <= inspected <= 1, got {self.glimpsed} and {self.inspected}.")


@dataclass(frozen=True, slots=True)
class Patches:
    """The wall in pieces of about ``patch_mm``.

    Attributes:
        center_mm: (P, 3) area-weighted middle of each, kidney frame.
        normal: (P, 3) unit, out of the lumen.
        area_mm2: (P,).
        calyx: (P,) the calyx that a patch belongs to, -1 for none.
        of_face: (F,) the patch of each triangle.
    """

    center_mm: Array
    normal: Array
    area_mm2: Array
    calyx: IntArray
    of_face: IntArray


@dataclass(frozen=True, slots=True)
class CalyxCoverage:
    """How far one calyx has been seen.

    Attributes:
        calyx: its name.
        pole: its pole, blank where not known.
        verdict: ``unseen``, ``glimpsed``, ``inspected``, or ``out of reach`` where no view shows any of it.
        share: part of its wall that was seen, of what the scope can see.
        reachable: part of its wall that the scope can see at all.
        area_mm2: of its wall.
    """

    calyx: str
    pole: str
    verdict: str
    share: float
    reachable: float
    area_mm2: float


class Coverage:
    """Paints the wall as poses come in.

    Args:
        kidney, camera: whose wall, through which lens.
        lumen: distances along the lumen.
        T_reachable: (V, 4, 4) poses that the scope can take; what none of them sees is out of reach. The views of a
            VID were planned as such. None takes all wall as in reach.
        settings: what counts as seen.

    Attributes:
        settings: as given.
        of_kidney: the same, lengths in mm of this kidney.
        rules_out: says of a pose (4, 4) that the scope cannot be there; such a picture does not count. None: of none.
    """

    def __init__(
        self,
        kidney: Kidney,
        camera: Camera,
        lumen: LumenDistance,
        T_reachable: Array | None = None,
        settings: CoverageSettings | None = None,
    ) -> None:
        self.kidney, self.camera, self.settings = kidney, camera, settings or CoverageSettings()
        self.of_kidney = scaled(self.settings, kidney.scale)
        self.patches = divide_wall(kidney, lumen, self.settings)
        self._lumen, self._scene, self._tree = lumen, RayScene(kidney.mesh), cKDTree(self.patches.center_mm)
        self._half_field = _half_field(camera)
        self._shown = self._lens_shows = None if camera.mask is None else camera.pixel_rays()[1]
        self.seen_s = np.zeros(len(self.patches.area_mm2))
        self.in_reach = np.ones(len(self.seen_s), bool)
        self.rules_out: Callable[[Array], bool] | None = None
        if T_reachable is not None:
            self.in_reach[:] = False
            for T in T_reachable:
                self.in_reach[self.in_view(T)] = True

    def look_through(self, scene: NDArray[np.bool_] | None) -> None:
        """From now on pictures show the scene in a part (H, W) of the lens's picture alone; in all of it when None."""
        self._shown = self._lens_shows if scene is None else scene

    def add(
        self,
        T_kidney_camera: Array,
        seconds: float,
        bodies: Sequence[ForegroundBody] = (),
        position_sd_mm: float | None = None,
    ) -> None:
        """Count a picture from a pose (4, 4) that stood for some seconds, but for the wall behind what lies before it.

        Args:
            T_kidney_camera: where it was taken.
            seconds: how long it stood.
            bodies: stones and instruments in the picture.
            position_sd_mm: how far off the place may be, two of three times; wall counts that is in view all the same,
                and none where it may be off by more than `CoverageSettings.largest_sd_mm`. None where it is known.
        """
        if position_sd_mm is not None and not position_sd_mm <= self.of_kidney.largest_sd_mm:
            return
        if self.rules_out is not None and self.rules_out(T_kidney_camera):
            return
        seen = self.surely_in_view(T_kidney_camera, position_sd_mm or 0.0, ~self.seen())
        if bodies and len(seen):
            before = np.logical_or.reduce([body.mask for body in bodies])
            seen = seen[~self._covered(T_kidney_camera, seen, before)]
        self.seen_s[seen] += min(max(seconds, 0.0), self.settings.longest_gap_s)

    def seen(self) -> NDArray[np.bool_]:
        """(P,) which patches were in view long enough."""
        return self.seen_s >= self.settings.dwell_s - 1e-9

    def in_view(self, T_kidney_camera: Array, among: NDArray[np.bool_] | None = None) -> IntArray:
        """Indices of the patches seen from a pose: near enough, not at a slant, in the picture, and not hidden.

        Args:
            T_kidney_camera: (4, 4).
            among: (P,) the patches that are asked for, of which fewer cost less; all without it.
        """
        position = np.asarray(T_kidney_camera, float)[:3, 3]
        near = np.array(self._tree.query_ball_point(position, self.of_kidney.farthest_mm), int)
        return self._of_these(near if among is None else near[among[near]], T_kidney_camera)

    def surely_in_view(
        self, T_kidney_camera: Array, position_sd_mm: float, among: NDArray[np.bool_] | None = None
    ) -> IntArray:
        """Indices of the patches seen from a pose (4, 4), and from as far beside it as it may be off, see `in_view`.

        At the edge of what hides wall, a place off by little shows what the true one does not.
        """
        seen = self.in_view(T_kidney_camera, among)
        if position_sd_mm <= 0 or not len(seen):
            return seen
        room = float(self._lumen.clearance_mm(T_kidney_camera[None, :3, 3])[0])
        off_mm = min(position_sd_mm / 3**0.5, _ROOM_SHARE * max(room, 0.0))  # along one axis of three
        for aside in (*T_kidney_camera[:3, :2].T, *-T_kidney_camera[:3, :2].T):
            T = T_kidney_camera.copy()
            T[:3, 3] += off_mm * aside
            seen = self._of_these(seen, T)
        return seen

    def _of_these(self, near: IntArray, T_kidney_camera: Array) -> IntArray:
        """Those of some patches (N,) that are seen from a pose (4, 4)."""
        s, position = self.of_kidney, T_kidney_camera[:3, 3]
        way = self.patches.center_mm[near] - position
        distance = np.linalg.norm(way, axis=1)
        ray = way / np.maximum(distance, 1e-9)[:, None]
        keep = (
            (distance >= s.nearest_mm)
            & (distance <= s.farthest_mm)
            & (ray @ T_kidney_camera[:3, 2] > np.cos(s.edge_share * self._half_field))
        )
        keep &= np.sum(ray * self.patches.normal[near], axis=1) > np.cos(np.radians(s.incidence_deg))
        keep[keep] = self._in_picture(ray[keep] @ T_kidney_camera[:3, :3])
        near, distance, ray = near[keep], distance[keep], ray[keep]
        if not len(near):
            return near
        return near[self._scene.depth_mm(position, ray) >= distance - s.patch_mm]

    def _in_picture(self, rays: Array) -> NDArray[np.bool_]:
        """Which rays (N, 3), camera frame, the picture shows (N,): within the lens's field, where it has a scene."""
        pixels, inside = self.camera.project(rays)
        if self._shown is None:
            return inside
        column, row = np.clip(np.rint(pixels).astype(int), 0, np.array(self._shown.shape[::-1]) - 1).T
        return np.asarray(inside & self._shown[row, column])

    def _covered(self, T_kidney_camera: Array, patches: IntArray, before: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which patches (N,) of those in view lie where something is before them, by its mask (h, w)."""
        way = (self.patches.center_mm[patches] - T_kidney_camera[:3, 3]) @ T_kidney_camera[:3, :3]
        pixels, _ = self.camera.project(way)
        size = np.array([self.camera.width, self.camera.height])
        small = np.array(before.shape[::-1])
        column, row = np.clip(((pixels + 0.5) * small / size).astype(int), 0, small - 1).T
        return np.asarray(before[row, column], bool)

    def share(self, calyx: int, patches: NDArray[np.bool_] | IntArray) -> float:
        """Part of a calyx's wall, of what the scope can see of it at all, that some patches make, by a mask (P,) or
        their numbers; 0 where the scope can see none of it."""
        area = self.patches.area_mm2 * ((self.patches.calyx == calyx) & self.in_reach)
        total = float(area.sum())
        return float(area[patches].sum()) / total if total > 0 else 0.0

    def calyces(self) -> list[CalyxCoverage]:
        """The verdict on every calyx."""
        seen, s, found = self.seen(), self.settings, []
        for index, calyx in enumerate(self.kidney.calyces):
            area = self.patches.area_mm2 * (self.patches.calyx == index)
            total, reachable = float(area.sum()), float(area[self.in_reach].sum())
            share = self.share(index, seen)
            verdict = INSPECTED if share >= s.inspected else GLIMPSED if share >= s.glimpsed else UNSEEN
            if reachable <= 0:
                verdict = OUT_OF_REACH
            found.append(
                CalyxCoverage(calyx.name, calyx.pole, verdict, share, reachable / total if total else 0.0, total)
            )
        return found

    def to_dict(self) -> dict[str, Any]:
        """The content of ``FILE.coverage.json``."""
        area, seen = self.patches.area_mm2, self.seen()
        reachable = float(area[self.in_reach].sum())
        return {
            "calyces": {
                c.calyx: {k: v for k, v in _rounded(asdict(c)).items() if k != "calyx"} for c in self.calyces()
            },
            "share": round(float(area[seen & self.in_reach].sum()) / reachable, 4) if reachable else 0.0,
            "reachable": round(reachable / float(area.sum()), 4),
            "area_mm2": round(float(area.sum()), 1),
            "patches": len(seen),
            "seen_patches": np.flatnonzero(seen).tolist(),
            "settings": asdict(self.settings),
        }


def divide_wall(kidney: Kidney, lumen: LumenDistance, settings: CoverageSettings) -> Patches:
    """Patches of a kidney's wall: triangles joined that lie in one cube of the patches' side and face alike."""
    mesh, side = kidney.mesh, scaled(settings, kidney.scale).patch_mm
    fine = mesh.area_faces > 1e-12
    centers, normals = np.asarray(mesh.triangles_center), np.asarray(mesh.face_normals)
    cell = np.column_stack([np.floor(centers / side), np.abs(normals).argmax(1), normals.max(1) > 1e-9])
    of_face: IntArray = np.unique(cell.astype(np.int64), axis=0, return_inverse=True)[1].ravel().astype(np.int64)
    area = np.where(fine, mesh.area_faces, 0.0)
    total = np.bincount(of_face, area).astype(float)

    def mean(values: Array) -> Array:
        return np.stack([np.bincount(of_face, area * values[:, i]) for i in range(3)], 1) / np.maximum(
            total, 1e-12
        )[:, None]  # fmt: skip

    center, normal = mean(centers), mean(normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    within = scaled(settings, kidney.scale).calyx_mm
    calyx = branch_calyx(center - 0.25 * normal, kidney, lumen, within)
    return Patches(center, normal, total, calyx, of_face)


def _half_field(camera: Camera) -> float:
    """Angle from the optical axis to the middle of the picture's nearest edge, or to its circle's, radians."""
    sides = np.array([[camera.cx, 0.0], [0.0, camera.cy], [camera.cx, camera.height - 1.0],
                      [camera.width - 1.0, camera.cy]])  # fmt: skip
    rays = camera.rays(sides)[0]
    angle = float(np.arccos(np.clip(rays[:, 2], -1, 1)).min())
    return min(angle, np.radians(camera.fov_deg) / 2) if camera.fov_deg else angle


def _rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    return {k: round(v, 4) if isinstance(v, float) else v for k, v in values.items()}
