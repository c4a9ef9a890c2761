"""The exploring suite: what a stone hides in truth, and what shows it."""

import numpy as np

from benchmarks.exploring.sight import CoverageBehind, shows
from ursnav_torch.camera import Camera
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.kidney import Kidney, LumenDistance
from ursnav_torch.rendering import RayScene
from ursnav_torch.vid import Vid


def test_wall_behind_a_stone_was_not_seen_in_truth(
    phantom: Kidney, phantom_lumen: LumenDistance, lens: Camera, vid: Vid
) -> None:
    """Of two that are seen alike, the stone hides what lies in its cone of sight and farther, and shows itself."""
    T = vid.T_kidney_camera[5]
    stone = np.array([*(T[:3, 3] + 2.0 * T[:3, 2]), 0.5])
    plain, hidden = Coverage(phantom, lens, phantom_lumen), CoverageBehind(stone, phantom, lens, phantom_lumen)
    for coverage in (plain, hidden):
        coverage.add(T, 0.1)
    gone = np.flatnonzero((plain.seen_s > 0) & (hidden.seen_s == 0))
    way = plain.patches.center_mm[gone] - T[:3, 3]
    cosine = way @ T[:3, 2] / np.linalg.norm(way, axis=1)
    assert len(gone) and (cosine >= np.cos(np.arcsin(0.25)) - 1e-9).all()
    assert not (hidden.seen_s > plain.seen_s).any() and (hidden.seen_s > 0).any()
    scene = RayScene(phantom.mesh)
    assert shows(T, stone, lens, scene)
    assert not shows(T, np.array([*(T[:3, 3] - 2.0 * T[:3, 2]), 0.5]), lens, scene), "behind the lens"
