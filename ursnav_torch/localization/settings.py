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
        risk: of the answers that are accepted at most this share is wrong; the others are "unsure".
        set_probability: with which the set of calyces holds the right one.
        pnp_starts: of so many of the best hypotheses, robust PnP on the correspondences of their edge points gives one
            more pose to refine each, beside the view's own; see `alignment.pnp`.

    The scores were chosen on simulated pictures of phantoms by ``python -m benchmarks.refinement``.
    """

    keep: int = 5
    refine: bool = True
    min_score_to_override_calyx: float = 0.6
    override_margin: float = 0.1
    min_score_to_replace_mean: float = 0.65
    risk: float = 0.01
    set_probability: float = 0.95
    pnp_starts: int = 0

    def __post_init__(self) -> None:
        if self.pnp_starts < 0:
            raise InputError(f"pnp_starts is a number of hypotheses, 0 or more; got {self.pnp_starts}.")
        if self.keep < 1 or not 0 < self.risk < 1 or not 0 < self.set_probability < 1:
            raise InputError(
                "Expected keep >= 1, 0 < risk < 1 and 0 < set_probability < 1, got "
                f"keep={self.keep}, risk={self.risk}, set_probability={self.set_probability}."
            )
