"""A pose from correspondences (PnP), and a pose refined by aligning drawings of the kidney with a picture."""

from ursnav_torch.alignment.pnp import EdgePnp, PnpSettings, solve_pnp, starts_from
from ursnav_torch.alignment.refine import Refined, RefinementSettings, Refiner

__all__ = ["EdgePnp", "PnpSettings", "Refined", "RefinementSettings", "Refiner", "solve_pnp", "starts_from"]
