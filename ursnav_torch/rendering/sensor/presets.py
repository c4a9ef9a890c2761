"""Kinds of pictures: each preset draws one random set of faults from documented ranges.

A preset names the span of every fault it uses, inside the range that the setting itself allows. The spans are wider
than one scope would show; their ends are set by eye, beside the thesis's figures and pictures of another renderer.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from ursnav_torch.errors import InputError
from ursnav_torch.rendering.sensor.simulate import SensorFaults

Rng = np.random.Generator


@dataclass(frozen=True, slots=True)
class Span:
    """Values between ``low`` and ``high``, or between their logarithms; clean in all but ``share`` of draws.

    The middle is likelier than the ends (the mean of two even draws): a scope rarely has all its faults at their worst.
    """

    low: float
    high: float
    share: float = 1.0
    log: bool = False

    def draw(self, rng: Rng, clean: float) -> float:
        """One value; ``clean`` where the fault is absent."""
        u, present = (rng.random() + rng.random()) / 2, rng.random() < self.share
        if not present:
            return clean
        return (
            float(self.low * (self.high / self.low) ** u) if self.log else float(self.low + u * (self.high - self.low))
        )

    def worst(self, rng: Rng, clean: float) -> float:
        """The end farther from ``clean`` (either one where both are as far), with the span's share."""
        gap = abs(self.high - clean) - abs(self.low - clean)
        farther = self.high if gap > 1e-12 or (abs(gap) <= 1e-12 and rng.random() < 0.5) else self.low
        return farther if rng.random() < self.share else clean


@dataclass(frozen=True, slots=True)
class Color:
    """Blue, green and red, each between its ``low`` and ``high``."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def draw(self, rng: Rng) -> tuple[float, ...]:
        """One color."""
        return tuple(float(v) for v in rng.uniform(self.low, self.high))


Preset = Mapping[str, Span | Color]
_TURN = Span(0, 2 * np.pi)
_SEED = Span(0, 2**30)

#: Thesis 4.1: another wall color, a point light beside the camera, Gaussian noise.
THESIS_SIMULATION: Preset = MappingProxyType({
    "wall.color_bgr": Color((0.80, 0.85, 0.85), (1.0, 1.0, 1.1)),
    "light.offset_mm": Span(0.0, 1.5),
    "light.angle_rad": _TURN,
    "light.reach_mm": Span(2.0, 8.0),
    "light.ambient": Span(0.0, 0.15),
    "light.gloss": Span(0.0, 0.4, share=0.5),
    "light.shininess": Span(8, 60, log=True),
    "light.gamma": Span(1.6, 2.6),
    "light.exposure_level": Span(0.4, 0.85),
    "electronics.read_noise": Span(3.0, 14.0),
    "electronics.jpeg_quality": Span(70, 98),
})  # fmt: skip

#: Thesis 4.3 and 6.2.1: an LED beside a 250 x 250 px camera in a printed phantom.
THESIS_PHANTOM: Preset = MappingProxyType({
    "wall.color_bgr": Color((0.85, 0.9, 0.9), (1.0, 1.0, 1.05)),
    "wall.seed": _SEED,
    "wall.mottle": Span(0.02, 0.12, share=0.5),
    "wall.mottle_scale_mm": Span(0.5, 4.0, log=True),
    "wall.seam": Span(0.1, 0.6, share=0.25),
    "wall.seam_width_mm": Span(0.15, 0.8),
    "light.offset_mm": Span(0.5, 2.2),
    "light.angle_rad": _TURN,
    "light.reach_mm": Span(2.0, 8.0),
    "light.beam": Span(0.0, 1.0),
    "light.ambient": Span(0.0, 0.15),
    "light.wrap": Span(0.0, 0.12),
    "light.gloss": Span(0.1, 0.8),
    "light.shininess": Span(6, 80, log=True),
    "light.gamma": Span(1.6, 2.6),
    "light.exposure_level": Span(0.42, 0.75),
    "optics.lens_scale": Span(-0.01, 0.01),
    "optics.center_px": Span(0.0, 1.0),
    "optics.center_angle_rad": _TURN,
    "optics.defocus_px": Span(0.4, 2.0),
    "optics.motion_px": Span(1.0, 4.0, share=0.3),
    "optics.motion_rad": _TURN,
    "optics.vignetting": Span(0.0, 0.4),
    "optics.halo": Span(0.02, 0.3),
    "optics.halo_radius": Span(0.5, 1.2),
    "optics.halo_size": Span(0.2, 0.6),
    "optics.halo_angle_rad": _TURN,
    "optics.bloom": Span(0.0, 0.3),
    "optics.veil": Span(0.1, 0.4),
    "optics.stripes": Span(1.0, 6.0),
    "optics.stripe_period_px": Span(4.0, 16.0, log=True),
    "optics.stripe_tilt_rad": Span(-0.05, 0.05),
    "electronics.balance_bgr": Color((0.92, 0.96, 0.92), (1.04, 1.04, 1.06)),
    "electronics.bayer": Span(1, 1, share=0.5),
    "electronics.shot_noise": Span(1.0, 8.0),
    "electronics.read_noise": Span(2.0, 9.0),
    "electronics.row_noise": Span(0.2, 1.5, share=0.5),
    "electronics.jpeg_quality": Span(65, 97),
})  # fmt: skip

#: A kidney: uneven, mottled, wet, vessel-lined wall; debris, bubbles, tools; motion; a calibration a little off.
IN_VIVO_LIKE: Preset = MappingProxyType({
    "wall.color_bgr": Color((0.30, 0.32, 0.85), (0.65, 0.66, 1.0)),
    "wall.seed": _SEED,
    "wall.mottle": Span(0.05, 0.2),
    "wall.mottle_scale_mm": Span(0.8, 5.0, log=True),
    "wall.relief_mm": Span(0.0, 0.1),
    "wall.relief_scale_mm": Span(1.0, 4.0, log=True),
    "wall.vessels": Span(0.2, 0.8),
    "wall.vessel_width_mm": Span(0.1, 0.35, log=True),
    "wall.vessel_spacing_mm": Span(3.0, 9.0),
    "wall.redness": Span(0.05, 0.3, share=0.6),
    "light.offset_mm": Span(0.3, 2.0),
    "light.angle_rad": _TURN,
    "light.reach_mm": Span(2.0, 8.0),
    "light.beam": Span(0.0, 1.0),
    "light.ambient": Span(0.0, 0.12),
    "light.wrap": Span(0.0, 0.12),
    "light.gloss": Span(0.1, 0.8),
    "light.shininess": Span(20, 120, log=True),
    "light.turbidity_per_mm": Span(0.002, 0.04, share=0.5),
    "light.gamma": Span(1.6, 2.6),
    "light.exposure_level": Span(0.3, 0.7),
    "occluders.debris": Span(0, 15),
    "occluders.debris_px": Span(1.0, 4.0),
    "occluders.bubbles": Span(0, 6),
    "occluders.bubble_px": Span(3.0, 10.0),
    "occluders.blood": Span(0.05, 0.4, share=0.3),
    "occluders.fiber": Span(0.4, 1.0, share=0.2),
    "occluders.fiber_angle_rad": _TURN,
    "occluders.fiber_px": Span(7.0, 20.0),
    "occluders.fiber_bgr": Color((0.3, 0.2, 0.1), (1.0, 0.8, 0.6)),
    "occluders.fiber_rings": Span(1, 1, share=0.3),
    "occluders.stone": Span(0.1, 0.3, share=0.08),
    "occluders.stone_bgr": Color((0.25, 0.4, 0.5), (0.6, 0.75, 0.85)),
    "optics.lens_scale": Span(-0.02, 0.02),
    "optics.center_px": Span(0.0, 2.0),
    "optics.center_angle_rad": _TURN,
    "optics.defocus_px": Span(0.2, 1.6),
    "optics.motion_px": Span(1.0, 5.0, share=0.5),
    "optics.motion_rad": _TURN,
    "optics.vignetting": Span(0.0, 0.4),
    "optics.bloom": Span(0.0, 0.25),
    "optics.veil": Span(0.0, 0.25),
    "electronics.balance_bgr": Color((0.85, 0.95, 0.92), (1.1, 1.05, 1.08)),
    "electronics.bayer": Span(1, 1, share=0.5),
    "electronics.shot_noise": Span(1.0, 6.0),
    "electronics.read_noise": Span(1.0, 6.0),
    "electronics.jpeg_quality": Span(65, 97),
})  # fmt: skip

#: Wider than the world: every fault beyond what is expected, so that the expected lies inside (Tobin et al., IROS
#: 2017, domain randomization). Its ends are set by eye; certainty is learned from it besides `PRESETS`.
WIDE: Preset = MappingProxyType({
    "wall.color_bgr": Color((0.15, 0.18, 0.4), (0.95, 0.95, 1.05)),
    "wall.seed": _SEED,
    "wall.mottle": Span(0.0, 0.4),
    "wall.mottle_scale_mm": Span(0.5, 6.0, log=True),
    "wall.relief_mm": Span(0.0, 0.3, share=0.6),
    "wall.relief_scale_mm": Span(0.6, 4.0, log=True),
    "wall.vessels": Span(0.1, 1.0, share=0.7),
    "wall.vessel_width_mm": Span(0.08, 0.5, log=True),
    "wall.vessel_spacing_mm": Span(1.5, 9.0),
    "wall.redness": Span(0.0, 0.5, share=0.6),
    "light.offset_mm": Span(0.0, 3.0),
    "light.angle_rad": _TURN,
    "light.reach_mm": Span(0.5, 8.0, log=True),
    "light.beam": Span(0.0, 3.0),
    "light.ambient": Span(0.0, 0.3),
    "light.wrap": Span(0.0, 0.5),
    "light.gloss": Span(0.1, 2.5, share=0.8),
    "light.shininess": Span(8, 200, log=True),
    "light.bounce": Span(0.0, 1.5, share=0.8),
    "light.turbidity_per_mm": Span(0.002, 0.06, share=0.3),
    "light.gamma": Span(1.2, 2.8),
    "light.exposure_level": Span(0.25, 1.3),
    "bodies.stones": Span(1, 3, share=0.4),
    "bodies.stone_mm": Span(0.5, 3.5, log=True),
    "bodies.stone_bgr": Color((0.1, 0.25, 0.3), (1.0, 1.0, 1.1)),
    "bodies.stone_bumps": Span(0.0, 0.4, share=0.6),
    "bodies.stone_long": Span(1.0, 2.2),
    "bodies.instrument_mm": Span(2.0, 13.0, share=0.3),
    "bodies.instrument_radius_mm": Span(0.1, 0.6, log=True),
    "bodies.instrument_angle_rad": _TURN,
    "bodies.instrument_beside_mm": Span(0.8, 2.2),
    "bodies.instrument_lean": Span(-0.1, 0.4),
    "bodies.instrument_bgr": Color((0.1, 0.1, 0.05), (1.1, 0.95, 0.95)),
    "bodies.instrument_rings": Span(0.2, 0.7, share=0.3),
    "occluders.debris": Span(0, 25, share=0.5),
    "occluders.debris_px": Span(1.0, 5.0),
    "occluders.bubbles": Span(0, 10, share=0.4),
    "occluders.bubble_px": Span(3.0, 16.0),
    "occluders.blood": Span(0.05, 0.6, share=0.3),
    "optics.lens_scale": Span(-0.02, 0.02),
    "optics.center_px": Span(0.0, 2.0),
    "optics.center_angle_rad": _TURN,
    "optics.defocus_px": Span(0.2, 3.0),
    "optics.motion_px": Span(1.0, 7.0, share=0.4),
    "optics.motion_rad": _TURN,
    "optics.vignetting": Span(0.0, 0.6),
    "optics.halo": Span(0.02, 0.35, share=0.4),
    "optics.halo_radius": Span(0.4, 1.3),
    "optics.halo_size": Span(0.2, 0.7),
    "optics.halo_angle_rad": _TURN,
    "optics.bloom": Span(0.0, 0.4),
    "optics.veil": Span(0.0, 0.45),
    "optics.stripes": Span(1.0, 6.0, share=0.2),
    "optics.stripe_period_px": Span(4.0, 16.0, log=True),
    "electronics.balance_bgr": Color((0.85, 0.92, 0.9), (1.12, 1.06, 1.1)),
    "electronics.bayer": Span(1, 1, share=0.4),
    "electronics.shot_noise": Span(0.5, 8.0),
    "electronics.read_noise": Span(0.5, 8.0),
    "electronics.jpeg_quality": Span(55, 98),
})  # fmt: skip

PRESETS: Mapping[str, Preset] = MappingProxyType({
    "thesis_simulation": THESIS_SIMULATION, "thesis_phantom": THESIS_PHANTOM, "in_vivo_like": IN_VIVO_LIKE,
})  # fmt: skip


def thesis_simulation(rng: Rng) -> SensorFaults:
    """One random set of faults of the thesis's simulation images (4.1)."""
    return draw_faults(THESIS_SIMULATION, rng)


def thesis_phantom(rng: Rng) -> SensorFaults:
    """One random set of faults of the thesis's phantom images (4.3, 6.2.1)."""
    return draw_faults(THESIS_PHANTOM, rng)


def in_vivo_like(rng: Rng) -> SensorFaults:
    """One random set of faults of pictures from a patient."""
    return draw_faults(IN_VIVO_LIKE, rng)


def draw_faults(preset: Preset, rng: Rng) -> SensorFaults:
    """One random set of faults, each drawn from its span."""
    return _filled(preset, lambda span, clean: span.draw(rng, clean) if isinstance(span, Span) else span.draw(rng))


def severity(preset: str | Preset, s: float, rng: Rng) -> SensorFaults:
    """Faults on the way from clean (``s`` = 0) to the preset's worst (``s`` = 1), for sweeps.

    Every fault that can be better or worse lies at ``clean + s * (worst - clean)``; what has no better or worse
    (color, gamma, sizes) is drawn from the preset and approached as far; directions and seeds are drawn.

    Raises:
        InputError: an unknown preset, or ``s`` outside 0..1.
    """
    if isinstance(preset, str):
        if preset not in PRESETS:
            raise InputError(f"Unknown preset {preset!r}; known are {', '.join(PRESETS)}.")
        preset = PRESETS[preset]
    if not 0 <= s <= 1:
        raise InputError(f"severity s={s} must lie in 0..1.")
    return _filled(preset, lambda span, clean: _toward(span, clean, s, rng))


def _toward(span: Span | Color, clean: Any, s: float, rng: Rng) -> Any:
    if isinstance(span, Color):
        return tuple(c + s * (d - c) for c, d in zip(clean, span.draw(rng), strict=True))
    if span is _TURN or span is _SEED:
        return span.draw(rng, clean)
    return clean + s * (span.worst(rng, clean) - clean)


def _filled(preset: Preset, value_of: Callable[[Span | Color, Any], Any]) -> SensorFaults:
    """Faults with every setting of the preset at ``value_of(span, clean value)``; whole numbers stay whole."""
    faults = SensorFaults()
    groups: dict[str, dict[str, Any]] = {}
    for name, span in preset.items():
        group, setting_name = name.split(".")
        clean = getattr(getattr(faults, group), setting_name)
        value = value_of(span, clean)
        groups.setdefault(group, {})[setting_name] = type(clean)(round(value)) if isinstance(clean, int) else value
    return replace(faults, **{name: replace(getattr(faults, name), **values) for name, values in groups.items()})
