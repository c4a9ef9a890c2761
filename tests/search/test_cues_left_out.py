"""The benchmark's ways of leaving cues out: "shapes alone" is ranked by shapes alone, turned as the scan found."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.accuracy import ShapesAlone, cues_left_out
from ursnav_torch.geometry import rotation_angle, transform_from
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.search import SearchSettings
from ursnav_torch.vid import Vid


def test_shapes_alone_rank_every_view_as_the_scan_turned_it(vid: Vid, renderer: RaycastRenderer) -> None:
    truth = vid.T_kidney_camera[3] @ transform_from(Rotation.from_rotvec([0, 0, 0.8]).as_matrix(), np.zeros(3))
    features = vid.extractor().extract(renderer.render(truth).image, virtual=True)
    found = ShapesAlone(vid, replace(SearchSettings(), finalists=len(vid), scan_finalists=len(vid))).rank(features)
    assert found.views[0] == 3 and sorted(found.views.tolist()) == list(range(len(vid)))
    assert np.degrees(rotation_angle(found.T_kidney_camera[0], truth)) < 5
    assert found.assignment is not None
    np.testing.assert_allclose(found.distance, found.assignment.distance.numpy(), atol=1e-6)


def test_the_table_has_every_cue_left_out_and_shapes_alone() -> None:
    names = set(cues_left_out())
    assert {"default", "edges and shape alone", "without shape stage", "without edge-direction maps"} <= names
    assert {"shape contexts alone, at the search's roll and tilt", "without tilts"} <= names
