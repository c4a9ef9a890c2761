"""From one picture to a place: scan at every roll, compare shapes, weigh, decide."""

import time

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ursnav_torch.alignment import Refiner
from ursnav_torch.features import Features, polar_grid, polar_maps
from ursnav_torch.geometry import angle_between, rotation_angle, transform_from
from ursnav_torch.kidney import OBSERVED_WITHIN_MM, LumenDistance, observed_calyx
from ursnav_torch.localization.answers import Candidate, Judgement, Location, Ranking
from ursnav_torch.localization.confidence import VOTE_WIDTH, Confidence, evidence
from ursnav_torch.localization.settings import LocalizationSettings, default_matching
from ursnav_torch.matching import Matching
from ursnav_torch.search.pose_mean import NEAR_MM, mean_pose
from ursnav_torch.search.scan import RollScan, tilts
from ursnav_torch.search.shape import ShapeStage
from ursnav_torch.threads import one_thread_an_operation
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]

#: A refined pose that observes another calyx than the views vote for must fit by so much better to be believed.
CONTRADICTION = 0.1


class Localizer:
    """Locates pictures in one VID.

    Args:
        vid: the views.
        matching: how shapes are compared; `default_matching` when None.
        settings: how the comparison is weighed.

    Example:
        >>> un.Localizer(un.load_vid("my_vid")).locate(image).calyx_name  # doctest: +SKIP
        'C'
    """

    def __init__(
        self, vid: Vid, matching: Matching | None = None, settings: LocalizationSettings | None = None
    ) -> None:
        self.vid, self.settings = vid, settings or LocalizationSettings()
        self._extractor = vid.extractor()
        self.matching = matching or default_matching()
        self._shape = ShapeStage(vid.features, vid.camera, self.matching)
        self._lumen = LumenDistance.from_kidney(vid.kidney)
        self._near = self._lumen.to_calyces(vid.T_kidney_camera[:, :3, 3]) <= OBSERVED_WITHIN_MM * vid.kidney.scale
        able = self.settings.refine and vid.features.maps.shape[1] > 0
        self._refiner = Refiner(vid, lumen=self._lumen) if able else None
        self._confidence = Confidence.from_calibration(vid.calibration, able)
        s, channels = self.settings, vid.features.maps.shape[1]
        self._scan: RollScan | None = None
        if channels and s.relief_weight + s.direction_weight > 0:
            weight = torch.full((channels,), s.direction_weight * 2 / max(channels - 1, 1))
            weight[0] = s.relief_weight
            self._scan = RollScan(vid.features.maps, weight)
        self._tilts = tilts(s.tilt_step_deg, s.tilt_rounds)
        self._grids = polar_grid(self._extractor.working_camera, self._tilts)

    @property
    def refines(self) -> bool:
        """Whether poses are refined: asked for, and possible with this VID's features."""
        return self._refiner is not None

    def locate(self, image: NDArray[np.uint8]) -> Location:
        """The place of a picture (H, W) or (H, W, 3) blue, green, red, uint8, taken through the VID's lens.

        Raises:
            InputError: the picture cannot be of this lens.
            FeatureError: it shows too little to be matched.
        """
        start = time.perf_counter()
        with torch.inference_mode(), one_thread_an_operation():
            features = self.features(image)
            found = self.judge(features)
        confidence = self._confidence.probability(found.numbers)
        rows = self._best(found)
        candidates = tuple(
            Candidate(int(found.ranking.views[i]), float(found.ranking.distance[i]), found.poses[i]) for i in rows
        )
        best = candidates[0]
        return Location(
            found.calyx,
            self.vid.calyx_name(found.calyx),
            self._settled(found, rows[0]),
            best.view,
            best.distance,
            confidence,
            confidence >= self.settings.accept,
            candidates,
            features,
            time.perf_counter() - start,
        )

    def judge(self, features: Features) -> Judgement:
        """What a picture's features say, before anyone asks how sure that is."""
        ranking = self.rank(features)
        poses, calyces = self._poses(ranking), self.calyces(ranking)
        seen = evidence(ranking.distance, calyces, features)
        if self._refiner is None:
            return Judgement(ranking, poses, calyces, seen.calyx, seen.calyx, seen.numbers(), None, False)
        rows = _apart(poses, self._refiner.settings.hypotheses)
        refined = self._refiner.refine(features, [self._mean(poses, ranking.distance, i) for i in rows])
        calyx = int(observed_calyx(refined.T_kidney_camera[None], self.vid.kidney, self._lumen)[0])
        numbers = np.append(seen.numbers(), [refined.score, float(calyx == seen.calyx)])
        needed = self.settings.believe_refined + (CONTRADICTION if calyx != seen.calyx else 0.0)
        believed = refined.score >= needed
        answer = calyx if believed else seen.calyx
        return Judgement(ranking, poses, calyces, answer, seen.calyx, numbers, refined, believed)

    def features(self, image: NDArray[np.uint8]) -> Features:
        """Features of a picture, as `locate` extracts them; the same errors."""
        with one_thread_an_operation():
            return self._extractor.extract(image)

    def calyces(self, ranking: Ranking) -> Tensor:
        """Calyx indices (K,) that the picture's camera observes from where each ranked view has it, -1 for none.

        The rule of `kidney.observed_calyx`, with the distances along the lumen of the views' own places.
        """
        T = self._poses(ranking)
        angle = angle_between(self.vid.kidney.tips_mm[None] - T[:, None, :3, 3], T[:, None, :3, 2])
        near = self._near[ranking.views.numpy()]
        return torch.from_numpy(np.where(near.any(1), np.where(near, angle, np.inf).argmin(1), -1))

    def rank(self, features: Features) -> Ranking:
        """The VID's nearest views to a picture's features."""
        s = self.settings
        if self._scan is None or not features.maps.numel():
            distance = self._shape.everywhere(features.edges)
            views = distance.topk(min(s.candidates, len(distance)), largest=False).indices
            return Ranking(views, distance[views], np.broadcast_to(np.eye(3), (len(views), 3, 3)))
        straight = self._scan.scan(features.maps[None])
        views = straight.score.topk(min(s.tilted, len(straight.score))).indices
        scan = self._scan.scan(polar_maps(features.fields, self._grids), views)
        best = scan.score.topk(min(s.candidates, len(views))).indices
        views, R = views[best], self._turns(scan.tilt[best], scan.roll[best])
        maps_weight = s.relief_weight + s.direction_weight
        distance = maps_weight - scan.score[best]
        if s.shape_weight > 0:
            distance = distance + s.shape_weight * self._shape.turned(features.edges, views, R)
        distance, order = (distance / (maps_weight + s.shape_weight)).sort()
        return Ranking(views[order], distance, R[order.numpy()])

    def _turns(self, tilt: Tensor, roll: Tensor) -> Array:
        """Rotations (K, 3, 3) R_view_query: how the query's camera is turned against each view's."""
        return _roll_matrices(roll.numpy()) @ np.swapaxes(self._tilts[tilt.numpy()], 1, 2)

    def _mean(self, poses: Array, distance: Tensor, row: int) -> Array:
        """The mean (4, 4) of poses (K, 4, 4) at the place of one of them, weighted as their views vote."""
        weight = np.exp((float(distance[row]) - distance.numpy().astype(float)) / VOTE_WIDTH)
        return mean_pose(poses, weight, row, NEAR_MM * self.vid.kidney.scale)[0]

    def _settled(self, found: Judgement, row: int) -> Array:
        """The answer's pose (4, 4), from the refined one and the views' mean at the place of one of them."""
        views, refined = self._mean(found.poses, found.ranking.distance, row), found.refined
        if refined is None:
            return views
        if found.believed and refined.score >= self.settings.sure_refined:
            return refined.T_kidney_camera
        both = np.stack([views, refined.T_kidney_camera])
        return mean_pose(both, np.ones(2), int(found.believed), NEAR_MM * self.vid.kidney.scale)[0]

    def _best(self, found: Judgement) -> list[int]:
        """Rows of the ranking to name: first the nearest to the refined pose or the best of the calyx, then by rank."""
        if found.refined is not None and found.believed:
            away = np.linalg.norm(found.poses[:, :3, 3] - found.refined.T_kidney_camera[:3, 3], axis=1)
            first = int((away + 0.15 * np.degrees(rotation_angle(found.poses, found.refined.T_kidney_camera))).argmin())
        else:
            first = int((found.calyces == found.calyx).nonzero()[0])
        return [first, *[i for i in range(len(found.poses)) if i != first]][: self.settings.keep]

    def _poses(self, ranking: Ranking) -> Array:
        """T_kidney_camera (K, 4, 4) of the picture, from each ranked view."""
        return self.vid.T_kidney_camera[ranking.views.numpy()] @ transform_from(ranking.R_view_query, np.zeros(3))


def _apart(poses: Array, most: int) -> list[int]:
    """Rows of poses (K, 4, 4), best first, that differ by 1.5 mm or 20 degrees from all before: what to refine."""
    rows: list[int] = []
    for i, T in enumerate(poses):
        near = [
            np.linalg.norm(poses[j, :3, 3] - T[:3, 3]) < 1.5 and rotation_angle(poses[j], T) < np.radians(20)
            for j in rows
        ]
        if not any(near):
            rows.append(i)
        if len(rows) == most:
            break
    return rows


def _roll_matrices(roll: NDArray[np.float32]) -> Array:
    """Rotations (K, 3, 3) about the optical axis by angles (K,) in radians, x towards y."""
    c, s, zero, one = np.cos(roll), np.sin(roll), np.zeros(len(roll)), np.ones(len(roll))
    rows = [np.stack(row, -1) for row in ([c, -s, zero], [s, c, zero], [zero, zero, one])]
    return np.stack(rows, axis=1).astype(float)
