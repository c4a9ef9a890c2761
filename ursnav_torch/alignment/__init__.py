"""A pose from correspondences (PnP), and a pose refined by aligning drawings of the kidney with a picture."""

from ursnav_torch.alignment.pnp import EdgePnp, solve_pnp
from ursnav_torch.alignment.refine import Refined, RefinementSettings, Refiner

__all__ = ["EdgePnp", "Refined", "RefinementSettings", "Refiner", "solve_pnp"]
