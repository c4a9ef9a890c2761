"""What a kidney is to the rest of the system: its lumen, its calyces and the tree between them.

Everything is in the kidney frame: the coordinates of the mesh file as given (times the scale), in mm.
"""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from ursnav_torch.errors import InputError

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: The row `pelvis` of a calyces file is a point in the pelvis; `none` in a set of calyces is a picture without one.
RESERVED_NAMES = ("pelvis", "none")
MOST_NAME = 40
#: What parts names in a list, and folders in a path.
_SIGNS = "|/\\"


@dataclass(frozen=True, slots=True, eq=False)
class Calyx:
    """A minor calyx.

    Attributes:
        name: "A", "B", ... in order along the tree, or the name in the user's file.
        tip_mm: (3,) deepest point of its lumen, kidney frame.
        pole: "upper", "mid", "lower", or "" where the kidney's superior direction is not known.
    """

    name: str
    tip_mm: Array
    pole: str = ""

    def __post_init__(self) -> None:
        check_calyx_name(self.name)


def check_calyx_name(name: str) -> None:
    """Refuse a name that would mean something else in a file, in a list of names, or as part of a file's name.

    Raises:
        InputError: naming what is wrong.
    """
    wrong = ""
    if not name.strip() or name != name.strip() or not name.isprintable() or len(name) > MOST_NAME:
        wrong = f"it has 1 to {MOST_NAME} printable characters, without blanks at its ends"
    elif name.casefold() in RESERVED_NAMES:
        wrong = f"{' and '.join(RESERVED_NAMES)} mean something else"
    elif set(name) & set(_SIGNS) or name.startswith("."):
        wrong = f"it has none of {' '.join(_SIGNS)} and no dot in front"
    if wrong:
        raise InputError(f"A calyx cannot be called {name[:80]!r}: {wrong}.")


@dataclass(frozen=True, slots=True, eq=False)
class Centerline:
    """A tree of nodes from the pelvis to the tip of every calyx; a parent comes before its children.

    Attributes:
        points_mm: (N, 3) nodes, kidney frame.
        radius_mm: (N,) distance from each node to the wall.
        parent: (N,) index of the next node towards the pelvis; -1 at the root, node 0.
        calyx: (N,) index of the one calyx that a node leads to; -1 where it leads to several (pelvis,
            shared infundibulum).
    """

    points_mm: Array
    radius_mm: Array
    parent: IntArray
    calyx: IntArray

    def path_to(self, calyx: int) -> IntArray:
        """Indices of the nodes from the root to the tip of a calyx (index into ``Kidney.calyces``).

        Raises:
            InputError: there is no such calyx.
        """
        own = np.flatnonzero(self.calyx == calyx)
        if calyx < 0 or not len(own):
            raise InputError(f"The centerline has calyces 0 to {self.calyx.max()}, got {calyx}.")
        path = [int(own[-1])]
        while self.parent[path[-1]] >= 0:
            path.append(int(self.parent[path[-1]]))
        return np.array(path[::-1])

    def from_root_mm(self) -> Array:
        """(N,) length of the way from the root to each node."""
        step = np.linalg.norm(self.points_mm - self.points_mm[self.parent], axis=1)
        along = np.zeros(len(self.parent))
        for node in range(1, len(along)):
            along[node] = along[self.parent[node]] + step[node]
        return along

    def tangents(self, path: IntArray) -> Array:
        """(K, 3) unit directions to the tip along a path of K >= 2 nodes from `path_to`.

        Each is the chord over one radius of the lumen before and after the node: the way on, without the kinks where
        branches meet.
        """
        points, radius = self.points_mm[path], self.radius_mm[path]
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        reach = np.maximum(radius, 2 * along[-1] / len(path))
        ahead, behind = (
            np.stack([np.interp(along + side * reach, along, points[:, k]) for k in range(3)], axis=1)
            for side in (1, -1)
        )
        chord = ahead - behind
        return chord / np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-12)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Kidney:
    """A collecting system.

    Attributes:
        mesh: surface of the lumen: closed, one piece, normals outward, kidney frame, mm.
        calyces: minor calyces, in order along the tree.
        centerline: from the pelvis to the tip of every calyx.
        pelvis_mm: (3,) a point in the pelvis; the root of the centerline lies there.
        scale: how many times larger than anatomy; 1.0 is anatomy, 1.8 the thesis's printed phantom.
        source: where it came from, for people to read.
    """

    mesh: trimesh.Trimesh
    calyces: tuple[Calyx, ...]
    centerline: Centerline
    pelvis_mm: Array
    scale: float
    source: str

    def __repr__(self) -> str:
        return f"<Kidney of {len(self.calyces)} calyces, {self.source}>"

    @property
    def tips_mm(self) -> Array:
        """(C, 3) tips of the calyces."""
        return np.array([c.tip_mm for c in self.calyces]).reshape(-1, 3)

    def scaled(self, factor: float) -> "Kidney":
        """The same kidney, larger by a factor."""
        tree = self.centerline
        return Kidney(
            self.mesh.copy().apply_scale(factor),
            tuple(replace(c, tip_mm=c.tip_mm * factor) for c in self.calyces),
            replace(tree, points_mm=tree.points_mm * factor, radius_mm=tree.radius_mm * factor),
            self.pelvis_mm * factor,
            self.scale * factor,
            self.source,
        )
