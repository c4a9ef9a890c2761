"""One search of the VID for stills and videos: all views, finalists at every tilt, shape contexts of the finalists."""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.camera import Camera
from ursnav_torch.features import Features, PolarGrid, polar_grid, polar_maps, polar_valid
from ursnav_torch.geometry import transform_from
from ursnav_torch.matching import Matching
from ursnav_torch.search.ranking import Ranking, view_from_query
from ursnav_torch.search.scan import RollScan, tilts
from ursnav_torch.search.screening import ScreenedViews
from ursnav_torch.search.settings import SearchSettings, best_first, default_matching
from ursnav_torch.search.shape import ShapeStage
from ursnav_torch.threads import meanwhile
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


class ViewSearch:
    """The views of a VID, ready to be compared with one picture after the other.

    `rank` is the whole search. A tracker, which knows something beforehand, takes its steps apart: `everywhere`, a
    choice of its own, `at_tilts`.

    Of a VID with a screen, `rank` compares every view coarsely and the likeliest as it does all others' views.
    `everywhere` is exact with any VID, and makes ready for all views when it is first asked.

    Args:
        vid: the views.
        settings: cues, tilts and finalists.
        matching: how shapes are compared; `default_matching` when None.
        working_camera: the lens in which features give their fields, where it is known already.

    Attributes:
        scans: whether polar maps are compared: the VID has them and they have weight.
    """

    def __init__(
        self,
        vid: Vid,
        settings: SearchSettings | None = None,
        matching: Matching | None = None,
        working_camera: Camera | None = None,
    ) -> None:
        self.settings, self.matching = settings or SearchSettings(), matching or default_matching()
        self._T, self._maps, s = vid.T_kidney_camera, vid.features.maps, self.settings
        self.scans = self._maps.shape[1] > 0 and s.map_weight > 0
        self._screened = ScreenedViews(vid, s) if self.scans and vid.screen is not None else None
        self._scan = self._scan_of_all() if self.scans and self._screened is None else None
        compares = s.shape_weight > 0 or not self.scans
        self._shape = ShapeStage(vid.features, vid.camera, self.matching) if compares else None
        self._tilts = tilts(s.tilt_step_deg, s.tilt_rounds)
        lens = working_camera or vid.extractor().working_camera
        self._straight, self._grids = polar_grid(lens), polar_grid(lens, self._tilts)

    def __len__(self) -> int:
        return len(self._T)

    @property
    def reads_edges(self) -> bool:
        """Whether edge points are compared: shapes have weight, or there is nothing else to compare."""
        return self._shape is not None

    def rank(self, features: Features) -> Ranking:
        """The VID's views nearest to a picture, best first, at most `SearchSettings.finalists` of them.

        Without maps to scan, shapes are compared with every view at the rolls that the matching names.
        """
        s = self.settings
        if not self.scans or not features.maps.numel():
            found = self._by_shape(features)
            return found.at(best_first(found.score, s.finalists))
        tilted, (maps, valid) = (
            meanwhile(lambda: self._seen(features, self._grids)),
            self._seen(features, self._straight),
        )
        views = None if self._screened is None else self._screened.likeliest(maps[0])
        scan, rows = self._scan_of(views)
        straight = scan.first_look(maps, rows, valid)
        best = straight.topk(min(s.scan_finalists, len(straight))).indices
        found = self._at_tilts(tilted(), scan, best, best.numpy() if views is None else views[best.numpy()])
        found = self.with_shapes(features, found.at(best_first(found.score, s.finalists)))
        return found.at(best_first(found.score, s.finalists))

    def everywhere(self, features: Features) -> Ranking:
        """Every view of the VID, in its order, at the roll that suits it best and no tilt."""
        maps, valid = self._seen(features, self._straight)
        found = self._scan_of(None)[0].scan(maps, None, valid)
        return self._ranking(np.arange(len(self._T)), found.score.numpy(), found.roll.numpy(), np.eye(3))

    def at_tilts(self, features: Features, views: Rows) -> Ranking:
        """Views (K,), in their order, each at the tilt and roll that suit it best."""
        return self._at_tilts(self._seen(features, self._grids), *self._scan_of(views), views)

    def _at_tilts(
        self, seen: tuple[Tensor, Tensor | None], scan: RollScan, rows: Tensor | None, views: Rows
    ) -> Ranking:
        """`at_tilts` of what is `_seen` there, by a scan that has the views (K,) at rows (K,), all where None."""
        found = scan.scan(seen[0], rows, seen[1])
        return self._ranking(views, found.score.numpy(), found.roll.numpy(), self._tilts[found.tilt.numpy()])

    def with_shapes(self, features: Features, found: Ranking) -> Ranking:
        """Hypotheses of a scan, in their order, with the shapes' say in the score.

        They stay as they are where shapes have no weight, or the picture no edge points.
        """
        weight = self.settings.shape_weight
        if weight <= 0 or self._shape is None or not len(features.edges):
            return found
        assignment = self._shape.finalists(features.edges, torch.from_numpy(found.views), found.R_view_query)
        score = found.score + weight * (1 - assignment.distance.numpy().astype(float))
        return replace(found, score=score, best_score=found.best_score + weight, assignment=assignment)

    def _scan_of(self, views: Rows | None) -> tuple[RollScan, Tensor | None]:
        """The exact scan of views (K,), of all where None, and where these are in it, None for all that it has."""
        if views is not None and self._screened is not None:
            return self._screened.exactly(views), None
        if self._scan is None:
            self._scan = self._scan_of_all()
        return self._scan, None if views is None else torch.from_numpy(views)

    def _scan_of_all(self) -> RollScan:
        return RollScan(self._maps, self.settings.channel_weights(self._maps.shape[1]))

    def _seen(self, features: Features, grids: PolarGrid) -> tuple[Tensor, Tensor | None]:
        """A picture's maps (N, C, R, A) through the cameras of the grids, and where they are valid (N, R, A)."""
        if features.valid.numel():
            valid = polar_valid(features.valid, grids)
            return polar_maps(features.fields, grids, valid), valid
        return features.maps[None] if grids is self._straight else polar_maps(features.fields, grids), None

    def _by_shape(self, features: Features) -> Ranking:
        """Every view of the VID, in its order, by shape distance alone."""
        assert self._shape is not None
        distance, roll = self._shape.everywhere(features.edges)
        found = self._ranking(np.arange(len(self._T)), 1 - distance.numpy().astype(float), roll.numpy(), np.eye(3))
        return replace(found, best_score=1.0)

    def _ranking(self, views: Rows, score: NDArray[np.floating], roll: NDArray[np.floating], R_tilt: Array) -> Ranking:
        """Hypotheses from what a scan found: scores and rolls (K,), tilts (K, 3, 3) or (3, 3)."""
        R = view_from_query(roll.astype(float), R_tilt)
        T = self._T[views] @ transform_from(R, np.zeros(3))
        return Ranking(views, score.astype(float), self.settings.map_weight, R, T)
