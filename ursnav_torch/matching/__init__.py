"""Point sets in, distances and correspondences out: shape contexts of a whole view database as one tensor, batched
pair costs, and nearest, Sinkhorn, Hungarian or OpenCV's own way from costs to a distance."""

from ursnav_torch.matching.cost import PairCost
from ursnav_torch.matching.descriptor import ShapeContext, describe, fix_scale, mean_distances
from ursnav_torch.matching.distances import shape_distances
from ursnav_torch.matching.heights import contour_heights
from ursnav_torch.matching.matcher import Matcher, Matching
from ursnav_torch.matching.methods.base import Assignment, Correspondences
from ursnav_torch.matching.methods.hungarian import Hungarian
from ursnav_torch.matching.methods.nearest import Nearest
from ursnav_torch.matching.methods.opencv import OpenCV
from ursnav_torch.matching.methods.sinkhorn import ConvergenceWarning, Sinkhorn
from ursnav_torch.matching.ordered import Ordered, align_outlines
from ursnav_torch.matching.point_sets import PointSets, pack
from ursnav_torch.threads import one_thread_an_operation

__all__ = [
    "Assignment",
    "ConvergenceWarning",
    "Correspondences",
    "Hungarian",
    "Matcher",
    "Matching",
    "Nearest",
    "OpenCV",
    "Ordered",
    "PairCost",
    "PointSets",
    "ShapeContext",
    "Sinkhorn",
    "align_outlines",
    "contour_heights",
    "describe",
    "fix_scale",
    "mean_distances",
    "one_thread_an_operation",
    "pack",
    "shape_distances",
]
