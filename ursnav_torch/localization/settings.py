"""How a picture's place is decided once the VID was searched."""

from dataclasses import dataclass

from ursnav_torch.errors import InputError


@dataclass(frozen=True, slots=True)
class LocalizationSettings:
    """How a picture's place is decided from ranked hypotheses.

    Attributes:
        keep: candidates named in the answer.
        refine: whether the pose is refined beyond the nearest view.
        min_score_to_override_calyx: a refined pose whose score (see `Refined`) is lower has no say which calyx it
            is: it is at times far off.
        override_margin: so much more it must score where it observes another calyx than the views vote for.
        min_score_to_replace_mean: one whose score is lower is no better than the weighted mean of the nearest views'
            poses, and errs otherwise: where both are one place, the pose between them is the answer.
        accept: a confidence below this is "unsure".

    The scores were chosen on simulated pictures of phantoms by ``python -m benchmarks.refinement``.
    """

    keep: int = 5
    refine: bool = True
    min_score_to_override_calyx: float = 0.6
    override_margin: float = 0.1
    min_score_to_replace_mean: float = 0.65
    accept: float = 0.5

    def __post_init__(self) -> None:
        if self.keep < 1 or not 0 <= self.accept <= 1:
            raise InputError(f"Expected keep >= 1 and 0 <= accept <= 1, got keep={self.keep}, accept={self.accept}.")
