"""The kidney as the page draws it: its surface as bytes, ways in pieces, what is where in the picture."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ursnav_torch.features import EdgePoints
from ursnav_torch.kidney import Kidney
from ursnav_torch.reports.overview import standpoint
from ursnav_torch.stones import StoneList, calyx_name

Array = NDArray[np.float64]

#: Steps of the path longer than this are jumps of the track, mm at scale 1; they are not drawn.
JUMP_MM = 4.0
#: Half the length of an edge's stroke, px; and how many points of the path are sent.
STROKE_PX, PATH_POINTS = 3.0, 1500


def kidney_bytes(kidney: Kidney, patch_of_face: NDArray[np.int64] | None = None) -> bytes:
    """Vertices (V, 3) float32, faces (F, 3) uint32 and each vertex's patch of wall (V,) int32, -1 for none.

    They follow a line of JSON, padded to a multiple of four bytes, that says how many there are, where the calyces are
    and from where to look, all in the kidney frame, mm.
    """
    vertices, faces = np.asarray(kidney.mesh.vertices, np.float32), np.asarray(kidney.mesh.faces, np.uint32)
    patch = np.full(len(vertices), -1, np.int32)
    if patch_of_face is not None:
        patch[faces.ravel()] = np.repeat(patch_of_face, 3)
    T, center = standpoint(kidney.mesh, from_side=False), vertices.mean(axis=0)
    about = {
        "vertices": len(vertices),
        "faces": len(faces),
        "calyces": [{"name": c.name, "tip": np.round(c.tip_mm, 3).tolist()} for c in kidney.calyces],
        "center": center.tolist(),
        "extent": float(np.abs(vertices - center).max()),
        "up": (-T[1, :3]).tolist(),
        "away": T[2, :3].tolist(),
        "scale": kidney.scale,
    }
    head = json.dumps(about).encode()
    head += b" " * (-(len(head) + 1) % 4) + b"\n"
    return head + vertices.tobytes() + faces.tobytes() + patch.tobytes()


def path_pieces(path_mm: Array, scale: float) -> list[list[list[float]]]:
    """The newest part of a path (N, 3) in pieces, parted at jumps of the track."""
    path = np.round(np.asarray(path_mm, float).reshape(-1, 3)[-PATH_POINTS:], 2)
    jumps = np.flatnonzero(np.linalg.norm(np.diff(path, axis=0), axis=1) > JUMP_MM * scale) + 1
    return [piece.tolist() for piece in np.split(path, jumps) if len(piece) > 1]


def stone_rows(stones: StoneList, kidney: Kidney) -> list[dict[str, Any]]:
    """Stones as the page lists and draws them: number, calyx, size ± sd (mm), state, name in the scan, place (mm)."""
    return [
        {
            "number": stone.number,
            "calyx": calyx_name(stone, kidney),
            "size": round(stone.size_mm, 1),
            "sd": round(stone.size_sd_mm, 1),
            "state": stone.state,
            "known": known,
            "at": stone.center_mm.round(2).tolist(),
        }
        for stone, known in zip(stones.seen, stones.known, strict=True)
    ]


def edge_strokes(edges: EdgePoints | None) -> list[list[float]]:
    """Each edge point of a picture as a stroke along the edge: x, y of both ends, px."""
    if edges is None:
        return []
    points, direction = edges.points.numpy(), edges.direction.numpy()
    along = STROKE_PX * np.stack([np.cos(direction), np.sin(direction)], axis=1)
    strokes: list[list[float]] = np.round(np.concatenate([points - along, points + along], axis=1), 1).tolist()
    return strokes
