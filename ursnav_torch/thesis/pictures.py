"""The thesis's pictures redone: what was seen beside what it was matched with, and the kidney with all poses."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.features import EdgePoints
from ursnav_torch.geometry import Array
from ursnav_torch.rendering import Renderer
from ursnav_torch.reports import draw_edges, draw_overview
from ursnav_torch.thesis.run import Outcome
from ursnav_torch.thesis.series import Matched
from ursnav_torch.vid import Vid

Picture = NDArray[np.uint8]

_TILE = 168
_GREEN, _ORANGE, _TRUE, _FOUND = (60, 230, 60), (40, 160, 255), (60, 140, 40), (30, 110, 230)


def strip(o: Outcome, series: Matched, i: int, renderer: Renderer) -> Picture:
    """A row (H, W, 3): a picture, its edges, the matched view with its edges, drawings from the pose found and true."""
    picture, location = series.pictures.read(i), series.locations[i]
    true = renderer.render(series.pictures.T_kidney_camera[i]).image
    if location is None:
        blank = np.full(picture.shape, 235, np.uint8)
        return _row([picture, blank, blank, blank, true])
    seen = draw_edges(picture, location.features.edges, _GREEN)
    found = renderer.render(location.T_kidney_camera).image
    return _row([picture, seen, view_with_edges(o.vid, location.view), found, true])


def view_with_edges(vid: Vid, view: int) -> Picture:
    """A view of the VID (H, W, 3) with its edge points."""
    f, mask = vid.features, vid.features.mask[view]
    edges = EdgePoints(f.points[view][mask], f.direction[view][mask], f.weight[view][mask])
    return draw_edges(vid.read_picture(view), edges, _ORANGE)


def reference_pairs(o: Outcome, renderer: Renderer) -> Picture:
    """Fig. 5.2 (H, W, 3): above, pictures of the phantom; below, the views that a hand found for them."""
    above = _row([o.phantom.pictures.read(int(i)) for i in o.reference])
    return np.vstack([above, _row([renderer.render(T).image for T in o.T_reference])])


def poses_overview(o: Outcome, series: Matched) -> Picture:
    """The kidney from two sides (S, 2 S, 3): where each picture was taken (green), where placed (orange), a line."""
    halves = []
    for from_side in (False, True):
        overview = draw_overview(o.vid.kidney, 480, from_side)
        canvas = overview.picture.copy()
        for T, location in zip(series.pictures.T_kidney_camera, series.locations, strict=True):
            true = _arrow(canvas, overview.project(_arrow_ends(T)), _TRUE)
            if location is not None:
                found = _arrow(canvas, overview.project(_arrow_ends(location.T_kidney_camera)), _FOUND)
                cv2.line(canvas, true, found, (170, 170, 170), 1, cv2.LINE_AA)
        halves.append(canvas)
    return np.hstack(halves)


def drive_overview(o: Outcome) -> Picture:
    """The robot's way through the kidney, from two sides (S, 2 S, 3)."""
    halves = []
    for from_side in (False, True):
        overview = draw_overview(o.vid.kidney, 480, from_side)
        canvas = overview.picture.copy()
        way = np.rint(overview.project(o.drive.T_kidney_camera[:, :3, 3])).astype(np.int32)
        cv2.polylines(canvas, [way], False, (160, 90, 30), 1, cv2.LINE_AA)
        halves.append(canvas)
    return np.hstack(halves)


def places(o: Outcome, rows: list[int]) -> Picture:
    """Fig. 5.27 (S, K S, 3): the places of K located phantom pictures as the surgeon would be shown them."""
    overview = draw_overview(o.vid.kidney, 320)
    drawn = [
        overview.with_camera(location.T_kidney_camera, reach_mm=7.0 * o.vid.kidney.scale)
        for location in (o.phantom.locations[i] for i in rows)
        if location is not None
    ]
    return np.hstack(drawn)


def jpeg(picture: Picture, quality: int = 85) -> bytes:
    """A picture (H, W) or (H, W, 3) blue, green, red as JPEG bytes."""
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def _row(pictures: list[Picture]) -> Picture:
    tiles = [p if p.ndim == 3 else cv2.cvtColor(p, cv2.COLOR_GRAY2BGR) for p in pictures]
    return np.hstack([_tile(p) for p in tiles])


def _tile(picture: Picture) -> Picture:
    height = round(_TILE * picture.shape[0] / picture.shape[1])
    return np.asarray(cv2.resize(picture, (_TILE, height), interpolation=cv2.INTER_AREA), np.uint8)


def _arrow_ends(T_kidney_camera: Array, length_mm: float = 7.0) -> Array:
    start = T_kidney_camera[:3, 3]
    return np.stack([start, start + length_mm * T_kidney_camera[:3, 2]])


def _arrow(canvas: Picture, ends_px: Array, color: tuple[int, int, int]) -> tuple[int, int]:
    (x, y), (u, v) = np.rint(ends_px).astype(int).tolist()
    cv2.arrowedLine(canvas, (x, y), (u, v), color, 2, cv2.LINE_AA, tipLength=0.3)
    cv2.circle(canvas, (x, y), 3, color, -1, cv2.LINE_AA)
    return x, y
