"""Which calyx a place belongs to: by the branch of the centerline that it lies beside."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ursnav_torch.kidney.anatomy import Kidney
from ursnav_torch.kidney.lumen import LumenDistance

#: Nodes of the centerline that are asked for each place.
_NODES = 12


def branch_calyx(
    points_mm: NDArray[np.float64], kidney: Kidney, lumen: LumenDistance, within_mm: float
) -> NDArray[np.int64]:
    """(P,) index of the calyx that places in the lumen or on its wall (P, 3) belong to, -1 for none: the nearest tip
    along the lumen, where it is within ``within_mm`` and the nearest part of the centerline leads to that calyx alone.
    """
    tree = kidney.centerline
    away = np.maximum(tree.radius_mm, 1e-6)
    _, nodes = cKDTree(tree.points_mm).query(points_mm, k=min(_NODES, len(away)))
    nodes = np.asarray(nodes).reshape(len(points_mm), -1)
    relative = np.linalg.norm(points_mm[:, None] - tree.points_mm[nodes], axis=-1) / away[nodes]
    node = nodes[np.arange(len(nodes)), relative.argmin(1)]
    to_tip = lumen.to_calyces(points_mm)
    nearest = to_tip.argmin(1)
    return np.where((to_tip.min(1) <= within_mm) & (tree.calyx[node] == nearest), nearest, -1)
