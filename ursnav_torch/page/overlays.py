"""What the page draws over the scope's picture, and the cloud of where the scope may be; plain numbers for JSON."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ursnav_torch.camera import Camera
from ursnav_torch.features.foreground import ForegroundBody
from ursnav_torch.geometry import apply, inverse
from ursnav_torch.kidney import OBSERVED_WITHIN_MM
from ursnav_torch.navigation import NavigationState, way_ahead
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]

#: Points of the cloud; the same draws each time, so that it does not flicker.
CLOUD_POINTS = 240
_DRAWN = np.random.default_rng(0)
_NORMAL, _CHOICE = _DRAWN.normal(size=(CLOUD_POINTS, 3)), _DRAWN.permutation(CLOUD_POINTS) / CLOUD_POINTS
#: Radius that two of three draws of a normal distribution in space are within, in standard deviations an axis.
TWO_OF_THREE = 1.85
#: Outlines are simplified to this, px.
OUTLINE_PX = 0.7


def scope_overlays(state: NavigationState, vid: Vid) -> dict[str, Any]:
    """What lies over a state's picture: ``bodies``, ``names`` and ``way``, all in px of the picture."""
    T = state.T_kidney_camera
    return {
        "bodies": body_outlines(state.bodies, vid.camera),
        "names": [] if T is None else names_in_picture(T, vid),
        "way": None if T is None else way_in_picture(T, state, vid),
    }


def body_outlines(bodies: tuple[ForegroundBody, ...], camera: Camera) -> list[list[Any]]:
    """Kind and outline (x, y pairs, px) of every region before the wall."""
    found = []
    for body in bodies:
        height, width = body.mask.shape
        scale = np.array([camera.width / width, camera.height / height])
        outlines, _ = cv2.findContours(body.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for outline in outlines:
            points = cv2.approxPolyDP(outline, OUTLINE_PX, True).reshape(-1, 2)
            found.append([body.kind, ((points + 0.5) * scale - 0.5).round(1).tolist()])
    return found


def names_in_picture(T_kidney_camera: Array, vid: Vid) -> list[list[Any]]:
    """Name and place x, y of every calyx whose tip is near along the lumen and in the picture of a pose (4, 4)."""
    near = vid.lumen.to_calyces(T_kidney_camera[None, :3, 3])[0] <= OBSERVED_WITHIN_MM * vid.kidney.scale
    pixels, inside = vid.camera.project(apply(inverse(T_kidney_camera), vid.kidney.tips_mm))
    shown = np.flatnonzero(near & inside)
    return [[vid.kidney.calyces[i].name, *pixels[i].round(1).tolist()] for i in shown]


def way_in_picture(T_kidney_camera: Array, state: NavigationState, vid: Vid) -> list[float] | None:
    """The direction x, y in which the picture of a pose (4, 4) shows the way on; None without a way.

    Its length is the angle from the axis, 1 at a right angle and beyond.
    """
    route = state.guidance.route
    if route is None:
        return None
    ahead = way_ahead(T_kidney_camera, route, vid.kidney.scale)
    across = float(np.hypot(*ahead[:2]))
    angle = np.arctan2(across, ahead[2])
    length = float(min(angle / (np.pi / 2), 1.0))
    return [round(float(v) / max(across, 1e-9) * length, 3) for v in ahead[:2]]


def cloud(state: NavigationState) -> list[list[float]]:
    """Points (x, y, z in the kidney frame, mm) that are as dense as the scope is likely to be there.

    Half of them lie around the pose, which two of three errors are from within ``position_sd_mm``; half are drawn from
    the filter's hypotheses. Without a pose all are.
    """
    T, sd, places = state.T_kidney_camera, state.position_sd_mm, state.places
    spread = 0.0 if sd is None else sd / TWO_OF_THREE
    own = 0 if T is None else CLOUD_POINTS if not len(places) else CLOUD_POINTS // 2
    points = [] if T is None else [T[:3, 3] + spread * _NORMAL[:own]]
    if len(places):
        share = np.cumsum(places[:, 3]) / max(float(places[:, 3].sum()), 1e-12)
        drawn = np.minimum(np.searchsorted(share, _CHOICE[own:]), len(places) - 1)
        points.append(places[drawn, :3] + max(spread, 0.3) * _NORMAL[own:])
    found: list[list[float]] = np.concatenate(points).round(2).tolist() if points else []
    return found
