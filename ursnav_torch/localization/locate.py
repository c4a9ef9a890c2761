"""From one picture to a place: search the VID, refine the best hypotheses, weigh, decide."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ursnav_torch.alignment import PnpSettings, RefinementSettings, Refiner, starts_from
from ursnav_torch.features import DefaultExtractor, Features, Settings
from ursnav_torch.geometry import rotation_angle
from ursnav_torch.kidney import observed_calyx
from ursnav_torch.localization.answers import Candidate, Judgement, Location
from ursnav_torch.localization.certainty import Certainty
from ursnav_torch.localization.evidence import nearest_evidence, refined_evidence, vote, vote_weight
from ursnav_torch.localization.firmness import label_shares
from ursnav_torch.localization.learned import certainty_model
from ursnav_torch.localization.settings import LocalizationSettings
from ursnav_torch.matching import Matching
from ursnav_torch.search import Ranking, SearchSettings, ViewSearch, default_matching
from ursnav_torch.search.pose_mean import NEAR_MM, are_near, mean_pose
from ursnav_torch.threads import one_thread_an_operation
from ursnav_torch.vid import Vid, load_vid

Array = NDArray[np.float64]

#: Hypotheses nearer to each other than both of these are one start for refinement; mm at the kidney's scale 1, degrees.
SAME_START_MM, SAME_START_DEG = 1.5, 20.0
#: A turn by one degree moves a wall about 9 mm away by as much as this shift does, mm at the kidney's scale 1.
MM_PER_DEG = 0.15


class Localizer:
    """Locates pictures in one VID.

    Args:
        vid: the views.
        matching: how shapes are compared; `search.default_matching` when None.
        settings: how the place is decided.
        search: how the VID is searched.
        alignment: how poses are refined.

    Attributes:
        threshold: answers of at least this confidence are accepted, see `LocalizationSettings.risk`.

    Example:
        >>> un.Localizer(un.load_vid("my_vid")).locate(image).calyx_name  # doctest: +SKIP
        'C'
    """

    def __init__(
        self,
        vid: Vid,
        matching: Matching | None = None,
        settings: LocalizationSettings | None = None,
        search: SearchSettings | None = None,
        alignment: RefinementSettings | None = None,
    ) -> None:
        self.vid, self.settings = vid, settings or LocalizationSettings()
        self._choices, self._scenes = (matching, settings, search, alignment), list[NDArray[np.bool_]]()
        self._extractor = vid.extractor()
        self.search = ViewSearch(vid, search, matching, self._extractor.working_camera)
        able = self.settings.refine and vid.features.maps.shape[1] > 0
        self._refiner = Refiner(vid, alignment) if able else None
        self._certainty = certainty_model(vid.calibration, self.evidence_settings(), able)
        self.threshold = self._certainty.threshold(self.settings.risk) if self._certainty else np.inf

    @property
    def refines(self) -> bool:
        """Whether poses are refined: asked for, and possible with this VID's features."""
        return self._refiner is not None

    @property
    def knows_confidence(self) -> bool:
        """Whether confidence was learned with these settings; if not it is nan, and no answer is accepted."""
        return self._certainty is not None

    def evidence_settings(self) -> str:
        """The settings that evidence, and so confidence, depends on, in one line."""
        alignment = self._refiner.settings if self._refiner else None
        return self.settings_line(self.vid.settings, self.search.matching, self.search.settings, alignment)

    @staticmethod
    def settings_line(
        features: Settings,
        matching: Matching | None = None,
        search: SearchSettings | None = None,
        alignment: RefinementSettings | None = None,
    ) -> str:
        """`evidence_settings` of a localizer with these choices; what is None is the default."""
        chosen = (features, matching or default_matching(), search or SearchSettings())
        return " ".join(map(str, (*chosen, alignment or RefinementSettings())))

    def described(self) -> str:
        """All settings in one line: two localizers of one VID that say the same give the same answers."""
        return f"{self.evidence_settings()} {self.settings}"

    def locate(self, image: NDArray[np.uint8]) -> Location:
        """The place of a picture (H, W) or (H, W, 3) blue, green, red, uint8, taken through the VID's lens.

        Raises:
            InputError: the picture cannot be of this lens.
            FeatureError: it shows too little to be matched.
        """
        start = time.perf_counter()
        return self.locate_features(self.features(image), start)

    def locate_features(self, features: Features, start: float | None = None) -> Location:
        """`locate` from a picture's features; the answer's seconds count from ``start``, on ``time.perf_counter``."""
        start = time.perf_counter() if start is None else start
        with torch.inference_mode(), one_thread_an_operation():
            found = self.judge(features)
        sure = self._sure(found)
        rows, ranking = self._candidate_rows(found), found.ranking
        distance = ranking.distance
        candidates = tuple(
            Candidate(int(ranking.views[i]), float(distance[i]), ranking.T_kidney_camera[i]) for i in rows
        )
        best = candidates[0]
        return Location(
            found.calyx,
            self.vid.calyx_name(found.calyx),
            self.pose(found),
            best.view,
            best.distance,
            sure.confidence,
            sure.confidence >= self.threshold,
            self.vid.set_names(sure.calyces),
            sure.position_sd_mm,
            sure.direction_sd_deg,
            sure.novelty,
            candidates,
            features,
            time.perf_counter() - start,
        )

    def judge(self, features: Features) -> Judgement:
        """What a picture's features say, before anyone asks how sure that is."""
        ranking = self.search.rank(features)
        calyces = observed_calyx(ranking.T_kidney_camera, self.vid.kidney, self.vid.lumen)
        scale = self.vid.kidney.scale
        said = vote(ranking.distance, calyces, len(self.vid.kidney.calyces))
        nearest = nearest_evidence(ranking, said, features, scale)
        if self._refiner is None:
            return Judgement(ranking, calyces, said.calyx, said.calyx, nearest, nearest, None, False)
        refined = self._refiner.refine(features, self.starts(ranking, self._refiner.settings.hypotheses, features))
        poses = np.concatenate([refined.T_kidney_camera[None], refined.tried])
        observed = observed_calyx(poses, self.vid.kidney, self.vid.lumen)
        calyx = int(observed[0])
        s = self.settings
        needed = s.min_score_to_override_calyx + (s.override_margin if calyx != said.calyx else 0.0)
        believed = refined.verified or refined.score >= needed
        answer = calyx if believed else said.calyx
        stood = refined.T_kidney_camera if believed else self._mean_of_views(ranking, int((calyces == answer).argmax()))
        firm = label_shares(stood, self.vid.kidney, self.vid.lumen)
        full = refined_evidence(nearest, refined, observed, answer, firm, scale)
        return Judgement(ranking, calyces, answer, said.calyx, nearest, full, refined, believed)

    def starts(self, ranking: Ranking, most: int, features: Features | None = None) -> list[Array]:
        """Poses (4, 4) to refine, at most so many: places of a ranking, best first, none near one before.

        Where `LocalizationSettings.pnp_starts` asks for it, those that the picture's edges give come after the first.
        """
        rows = self._distinct(ranking.T_kidney_camera, most)
        means = [self._mean_of_views(ranking, i) for i in rows]
        count = self.settings.pnp_starts
        if not count or features is None:
            return means
        solved = starts_from(self.vid, features.edges, ranking, rows[:count], PnpSettings())
        return [*means[:1], *solved, *means[1:]][:most]

    def pose(self, found: Judgement) -> Array:
        """The answer's pose (4, 4)."""
        return self._fused_pose(found, self._candidate_rows(found)[0])

    def nearest_pose(self, found: Judgement) -> Array:
        """The pose (4, 4) that would be answered without refinement."""
        return self._mean_of_views(found.ranking, int((found.calyces == found.voted).argmax()))

    def _sure(self, found: Judgement) -> Certainty:
        """How sure the answer is; nan and no calyces where nothing was learned with these settings."""
        if self._certainty is None:
            return Certainty(np.nan, (), np.nan, np.nan, np.nan)
        return self._certainty.certainty(found.evidence, self.settings.set_probability, self.vid.kidney.scale)

    def features(self, image: NDArray[np.uint8]) -> Features:
        """Features of a picture (H, W) or (H, W, 3) blue, green, red, as `locate` extracts them; the same errors."""
        with torch.inference_mode(), one_thread_an_operation():
            return self._extractor.extract(image)

    def narrow(self, scene: NDArray[np.bool_]) -> None:
        """From now on pictures show the scene in a part (H, W) of the lens alone, see `features.scene_of`."""
        if isinstance(self._extractor, DefaultExtractor):
            self._extractor = self._extractor.through(scene)
            self._scenes = [*self._scenes, scene]  # a copy that is narrowed leaves the whole one as it is

    def again(self) -> "Again":
        """How another process makes the same localizer, from the folder of the VID."""
        return Again(self.vid.folder, self._choices, tuple(self._scenes))

    def _mean_of_views(self, ranking: Ranking, row: int) -> Array:
        """The weighted mean (4, 4) of the hypotheses at the place of one of them, weighted as their views vote."""
        distance = ranking.distance
        weight = vote_weight(distance, float(distance[row]))
        return mean_pose(ranking.T_kidney_camera, weight, row, NEAR_MM * self.vid.kidney.scale)[0]

    def _fused_pose(self, found: Judgement, row: int) -> Array:
        """The answer's pose (4, 4), from the refined one and the views' mean at the place of one of them."""
        views, refined = self._mean_of_views(found.ranking, row), found.refined
        if refined is None:
            return views
        if found.believed and refined.score >= self.settings.min_score_to_replace_mean:
            return refined.T_kidney_camera
        both = np.stack([views, refined.T_kidney_camera])
        return mean_pose(both, np.ones(2), int(found.believed), NEAR_MM * self.vid.kidney.scale)[0]

    def _candidate_rows(self, found: Judgement) -> list[int]:
        """Rows of the ranking to name: first the nearest to the refined pose or the best of the calyx, then by rank."""
        T = found.ranking.T_kidney_camera
        if found.refined is not None and found.believed:
            away = np.linalg.norm(T[:, :3, 3] - found.refined.T_kidney_camera[:3, 3], axis=1)
            turned = np.degrees(rotation_angle(T, found.refined.T_kidney_camera))
            first = int((away + MM_PER_DEG * self.vid.kidney.scale * turned).argmin())
        else:
            first = int((found.calyces == found.calyx).argmax())
        return [first, *[i for i in range(len(T)) if i != first]][: self.settings.keep]

    def _distinct(self, T_kidney_camera: Array, most: int) -> list[int]:
        """Rows of poses (K, 4, 4), best first, that are no one start with any before: what to refine."""
        rows: list[int] = []
        for i, T in enumerate(T_kidney_camera):
            near = are_near(T_kidney_camera[rows], T, SAME_START_MM * self.vid.kidney.scale, SAME_START_DEG)
            if not near.any():
                rows.append(i)
            if len(rows) == most:
                break
        return rows


@dataclass(frozen=True, slots=True)
class Again:
    """What a localizer was made of: its VID's folder, its choices, and the scenes it was narrowed to."""

    vid: Path
    choices: tuple[Matching | None, LocalizationSettings | None, SearchSettings | None, RefinementSettings | None]
    scenes: tuple[NDArray[np.bool_], ...]

    def localizer(self) -> Localizer:
        """The localizer, with the VID loaded again."""
        made = Localizer(load_vid(self.vid), *self.choices)
        for scene in self.scenes:
            made.narrow(scene)
        return made
