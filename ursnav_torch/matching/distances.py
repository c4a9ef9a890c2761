"""Distances between lists of point sets, in one call."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from ursnav_torch.errors import InputError
from ursnav_torch.matching.cost import PairCost
from ursnav_torch.matching.descriptor import ShapeContext
from ursnav_torch.matching.matcher import Matcher, Matching
from ursnav_torch.matching.methods.hungarian import Hungarian
from ursnav_torch.matching.methods.nearest import Nearest
from ursnav_torch.matching.methods.opencv import OpenCV
from ursnav_torch.matching.methods.sinkhorn import Sinkhorn
from ursnav_torch.matching.point_sets import pack, pack_rows

METHODS: dict[str, type] = {"nearest": Nearest, "sinkhorn": Sinkhorn, "hungarian": Hungarian, "opencv": OpenCV}


def shape_distances(
    queries: Sequence[ArrayLike | Tensor],
    database: Sequence[ArrayLike | Tensor],
    method: str = "nearest",
    *,
    query_directions: Sequence[ArrayLike | Tensor] | None = None,
    database_directions: Sequence[ArrayLike | Tensor] | None = None,
    query_weights: Sequence[ArrayLike | Tensor] | None = None,
    **settings: Any,
) -> Tensor:
    """Shape distances between every query and every set of the database.

    Args:
        queries: Q point sets (N, 2), px.
        database: V point sets (N, 2), px.
        method: "nearest", "sinkhorn", "hungarian" or "opencv".
        query_directions: edge direction a point (N,), radians, x towards y; for `frame="tangent"` or
            `direction_weight=...`.
        database_directions: the same for the database.
        query_weights: how much a point counts (N,), >= 0.
        **settings: any field of `ShapeContext`, `PairCost` and the method's class, by its name, and `roll_deg`.

    Returns:
        (Q, V) float32, lower is nearer, inf where one of the two sets is empty. The numbers of two methods do
        not compare.

    Raises:
        InputError: an unknown method or setting, or points that are not finite.
        ShapeError: a set that is not (N, 2).
        MissingExtraError: `method="opencv"` without OpenCV's contrib modules.

    Example:
        >>> square = [(0, 0), (0, 9), (9, 9), (9, 0)]
        >>> shape_distances([square], [square, [(0, 0), (1, 9), (5, 0), (9, 9)], []])[0].argmin().item()
        0
    """
    matching = matching_from(method, settings)
    views, asked = pack(database), pack(queries)
    directions = None if database_directions is None else pack_rows(database_directions, views)
    matcher = Matcher(views.points, views.mask, directions, matching)
    turned = None if query_directions is None else pack_rows(query_directions, asked)
    weighed = None if query_weights is None else pack_rows(query_weights, asked)
    out = torch.empty(len(asked.points), len(views.points))
    for i in range(len(out)):
        out[i] = matcher.distances(
            asked.points[i],
            None if turned is None else turned[i],
            None if weighed is None else weighed[i],
            asked.mask[i],
        )
    return out


def matching_from(method: str, settings: dict[str, Any]) -> Matching:
    """`Matching` from a method's name and flat settings; see `shape_distances`."""
    if method not in METHODS:
        raise InputError(f"method is {method!r}; accepted are {', '.join(map(repr, METHODS))}.")
    rest = dict(settings)
    parts = {}
    for key, kind in (("method", METHODS[method]), ("cost", PairCost), ("descriptor", ShapeContext)):
        names = [f.name for f in dataclasses.fields(kind)]
        parts[key] = kind(**{name: rest.pop(name) for name in names if name in rest})
    if "roll_deg" in rest:
        parts["roll_deg"] = rest.pop("roll_deg")
    if rest:
        known = [f.name for k in (METHODS[method], PairCost, ShapeContext) for f in dataclasses.fields(k)]
        raise InputError(
            f"Unknown setting {', '.join(rest)} for method {method!r}; accepted are {', '.join(known)}, roll_deg."
        )
    return Matching(**parts)
