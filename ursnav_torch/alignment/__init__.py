"""A pose from correspondences (PnP), and a pose refined by aligning drawings of the kidney with a picture."""

from ursnav_torch.alignment.pnp import EdgePnp, PnpSettings, solve_pnp, starts_from
from ursnav_torch.alignment.refine import Expectation, Refined, RefinementSettings, Refiner

__all__ = [
    "EdgePnp", "Expectation", "PnpSettings", "Refined", "RefinementSettings", "Refiner", "solve_pnp", "starts_from",
]  # fmt: skip
