"""Procedural collecting systems: planned after published anatomy, meshed from one implicit function, labeled."""

from ursnav_torch.kidney.phantom.make import make_phantom_kidney

__all__ = ["make_phantom_kidney"]
