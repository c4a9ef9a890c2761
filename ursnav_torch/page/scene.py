"""The kidney in the page: translucent, painted where it was seen, with the scope in it."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.exploration.coverage import GLIMPSED, INSPECTED, OUT_OF_REACH, UNSEEN, CalyxCoverage
from ursnav_torch.kidney import Kidney
from ursnav_torch.reports.overview import standpoint

if TYPE_CHECKING:
    import viser

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Color = tuple[int, int, int]

#: Red, green, blue.
TISSUE, SEEN, PATH, ROUTE = (224, 150, 150), (60, 160, 90), (40, 60, 90), (20, 110, 230)
VERDICTS: dict[str, Color] = {
    INSPECTED: (40, 140, 60),
    GLIMPSED: (230, 140, 0),
    UNSEEN: (200, 40, 40),
    OUT_OF_REACH: (140, 140, 140),
}
#: Light from everywhere.
AMBIENT = 1.8
#: Field of view of the frustum that stands for the camera, however wide the lens; and its length, mm at scale 1.
FRUSTUM_RAD, FRUSTUM_MM = np.radians(70.0), 3.5
#: Steps of the path longer than this are jumps of the track, mm at scale 1; they are not drawn.
JUMP_MM = 4.0


class KidneyScene:
    """Draws into a server's 3-D scene.

    Args:
        server: where.
        kidney: what.
        on_calyx: called with a calyx's name when its ball is clicked.
    """

    def __init__(self, server: "viser.ViserServer", kidney: Kidney, on_calyx: Callable[[str], None]) -> None:
        self._scene, self.kidney, self._unit = server.scene, kidney, kidney.scale
        T = standpoint(kidney.mesh, from_side=False)
        up, away = -T[1, :3], T[2, :3]
        center = np.asarray(kidney.mesh.vertices).mean(axis=0)
        extent = float(np.abs(np.asarray(kidney.mesh.vertices) - center).max())
        self._scene.set_up_direction(up)
        server.initial_camera.position = center - 2.7 * extent * away
        server.initial_camera.look_at = center
        server.initial_camera.up = up
        self._light()
        everywhere = np.ones(len(kidney.mesh.faces), bool)
        self._tissue = self._mesh("tissue", kidney.mesh, everywhere, TISSUE, 0.42, "front")
        self._balls: dict[str, Any] = {}
        self._labels: dict[str, Any] = {}
        self._colors: dict[str, Color] = {}
        for calyx in kidney.calyces:
            self._add_calyx(calyx.name, calyx.tip_mm, on_calyx)
        self._camera: Any = None
        self._axes: Any = None
        self._placed: Array | None = None
        self._painted, self._drawn = -1, dict[str, Array]()

    def _light(self) -> None:
        """Plain light: reflections and shadows take a browser without a graphics card ten seconds to prepare."""
        self._scene.configure_environment_map(None)
        self._scene.configure_default_lights(cast_shadow=False)
        self._scene.add_light_ambient("/light", intensity=AMBIENT)

    def paint(self, of_face: NDArray[np.int64], seen: NDArray[np.bool_]) -> None:
        """Color the wall that was seen; costs as much as there is of it, so it is done when there is more."""
        count = int(seen.sum())
        if count == self._painted:
            return
        self._painted = count
        self._mesh("seen", self.kidney.mesh, seen[of_face], SEEN, 0.5, "double")

    def verdicts(self, coverage: Sequence[CalyxCoverage]) -> None:
        """Color the calyces' balls."""
        for c in coverage:
            color = VERDICTS[c.verdict]
            if c.calyx in self._balls and self._colors.get(c.calyx) != color:
                self._balls[c.calyx].color = self._colors[c.calyx] = color

    def show_camera(self, T_kidney_camera: Array | None) -> None:
        """The scope's camera with its axes; None hides it."""
        if T_kidney_camera is self._placed:
            return
        self._placed = T_kidney_camera
        if T_kidney_camera is None:
            if self._camera is not None:
                self._camera.visible = self._axes.visible = False
            return
        wxyz = Rotation.from_matrix(T_kidney_camera[:3, :3]).as_quat()[[3, 0, 1, 2]]
        position = T_kidney_camera[:3, 3]
        if self._camera is None:
            size = FRUSTUM_MM * self._unit
            self._camera = self._scene.add_camera_frustum(
                "/scope/field", FRUSTUM_RAD, 1.0, scale=size, thickness=2.0, thickness_units="screen",
                color=(30, 30, 30), cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            self._axes = self._scene.add_frame("/scope/axes", axes_length=1.6 * size, axes_radius=0.06 * size)
        for node in (self._camera, self._axes):
            node.position, node.wxyz, node.visible = position, wxyz, True

    def show_picture(self, picture: Picture) -> None:
        """What the scope sees (red, green, blue), in its field of view."""
        if self._camera is not None:
            self._camera.image = picture

    def on_wall(self, action: Callable[[Array, Array], None] | None) -> None:
        """Call ``action(origin, direction)`` with the ray of a click on the kidney, kidney frame; None for nothing.

        Meanwhile the wall takes the clicks on calyces that lie behind it.
        """
        self._tissue.remove_click_callback("all")
        if action is not None:
            self._tissue.on_click(lambda event: action(np.array(event.ray_origin), np.array(event.ray_direction)))

    def show_points(self, name: str, points_mm: Sequence[Array], color: Color, factor: float = 1.0) -> None:
        """Places, as dots."""
        points = np.array(points_mm, np.float32).reshape(-1, 3)
        visible = len(points) > 0
        self._scene.add_point_cloud(
            f"/dots/{name}", points if visible else np.zeros((1, 3), np.float32), color,
            point_size=0.5 * factor * self._unit, point_shape="circle", precision="float32", visible=visible,
        )  # fmt: skip

    def show_path(self, path_mm: Array) -> None:
        """Where the scope has been."""
        self._lines("path", path_mm, PATH, 2.0)

    def show_route(self, points_mm: Array | None) -> None:
        """The way on; None for none."""
        self._lines("route", np.zeros((0, 3)) if points_mm is None else points_mm, ROUTE, 4.0)

    def rename(self, old: str, new: str, on_calyx: Callable[[str], None]) -> None:
        """Give a calyx another name."""
        ball = self._balls.pop(old)
        tip = np.array(ball.position)
        ball.remove()
        self._labels.pop(old).remove()
        self._add_calyx(new, tip, on_calyx)

    def _add_calyx(self, name: str, tip_mm: Array, on_calyx: Callable[[str], None]) -> None:
        key = f"/calyces/{self._slot(tip_mm)}"
        ball = self._scene.add_icosphere(
            f"{key}/ball", 1.1 * self._unit, VERDICTS[UNSEEN], position=tip_mm, subdivisions=2, cast_shadow=False
        )
        ball.on_click(lambda _event: on_calyx(name))
        self._balls[name], self._colors[name] = ball, VERDICTS[UNSEEN]
        self._labels[name] = self._scene.add_label(f"{key}/name", name, position=tip_mm, anchor="bottom-left")

    def _slot(self, tip_mm: Array) -> int:
        """The calyx's number, which its nodes are called by: names may hold anything."""
        return int(np.linalg.norm(self.kidney.tips_mm - tip_mm, axis=1).argmin())

    def _mesh(
        self, name: str, mesh: trimesh.Trimesh, keep: NDArray[np.bool_], color: Color, opacity: float, side: str
    ) -> Any:
        faces = np.asarray(mesh.faces)[keep]
        used, faces = np.unique(faces, return_inverse=True)
        if not len(used):
            return None
        return self._scene.add_mesh_simple(
            f"/kidney/{name}", np.asarray(mesh.vertices, np.float32)[used], faces.reshape(-1, 3).astype(np.uint32),
            color=color, opacity=opacity, side=side, cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _lines(self, name: str, points: Array, color: Color, thickness: float) -> None:
        if np.array_equal(self._drawn.get(name, ()), points):
            return
        self._drawn[name] = points
        steps = np.stack([points[:-1], points[1:]], axis=1) if len(points) > 1 else np.zeros((0, 2, 3))
        steps = steps[np.linalg.norm(steps[:, 1] - steps[:, 0], axis=1) <= JUMP_MM * self._unit]
        if not len(steps):
            steps = np.zeros((1, 2, 3)) + self.kidney.pelvis_mm
        self._scene.add_line_segments(
            f"/way/{name}", steps.astype(np.float32), color, thickness=thickness, thickness_units="screen"
        )
