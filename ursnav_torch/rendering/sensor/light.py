"""The scope's light: an LED beside the lens, inverse-square fall-off, wet highlights, murky water, exposure."""

from dataclasses import dataclass

import numpy as np

from ursnav_torch.rendering.sensor.bounce import bounced
from ursnav_torch.rendering.sensor.settings import check_settings, choice, setting
from ursnav_torch.rendering.sensor.surface import Floats, Surface
from ursnav_torch.rendering.sensor.wall import PaintedWall

#: The LED sits within this part of the room that the tip has; a light inside the wall would leave the wall dark.
_ROOM_USED = 0.7
#: What of the picture's radius, as sines of the angle from the axis, counts as its rim.
_RIM = 0.9


@dataclass(frozen=True, slots=True)
class LightFaults:
    """Where the light sits, how it falls off, shines and is exposed.

    The clean values are those of `ursnav_torch.rendering.HeadLight`.
    """

    offset_mm: float = setting(
        0.0, 0, 3.5, "from the lens to the LED, where there is room; thesis 4.3.1: 1 mm camera, larger LED, 5 mm tip"
    )
    angle_rad: float = choice(0.0, "around the optical axis, from the camera's x towards y, where the LED sits")
    reach_mm: float = choice(4.0, "extent of the light: radiance falls as 1 / (distance² + reach²); 1-8 mm")
    beam: float = setting(0.0, 0, 4, "exponent of the cosine of the LED's beam; 1 is an ideal (Lambertian) LED die")
    ambient: float = choice(0.02, "light scattered by the wall all around, relative; 0-0.3 for pale walls")
    wrap: float = setting(0.0, 0, 0.5, "light that seeps past the terminator under the mucosa")
    gloss: float = setting(0.0, 0, 3, "strength of highlights on the wet wall, relative to its reflectance")
    shininess: float = choice(40.0, "Blinn exponent of the highlights; 5 (matt print) to 200 (wet mucosa)")
    bounce: float = setting(
        0.0, 0, 1.5, "light between the walls: 1 gathers one diffuse bounce; more stands for further ones"
    )
    turbidity_per_mm: float = setting(0.0, 0, 0.12, "light lost a mm of murky irrigation, there and back")
    gamma: float = choice(2.2, "picture value = radiance ** (1 / gamma); 1.4-2.8")
    exposure_level: float = choice(0.8, "picture value of the 90th percentile of the wall; 0.3-0.95")

    def __post_init__(self) -> None:
        check_settings(self)


def lamp_place(surface: Surface, faults: LightFaults) -> Floats:
    """Where the LED is, (3,) mm in the camera frame: beside the lens as far as there is room."""
    beside = np.array([np.cos(faults.angle_rad), np.sin(faults.angle_rad), 0], np.float32)
    return np.float32(min(faults.offset_mm, _ROOM_USED * room_beside(surface, beside))) * beside


def shade(surface: Surface, wall: PaintedWall, faults: LightFaults, led: Floats, lit: Floats | None = None) -> Floats:
    """Picture values (N, 3), blue green red, of the lit wall; 1 is the sensor's white, brighter spots exceed it.

    Args:
        surface: N points.
        wall: their paint.
        faults: the light.
        led: (3,) see `lamp_place`.
        lit: (N,) share of its direct light that reaches each point; all where left out.
    """
    to_light = led - surface.rays * surface.distance_mm[:, None]
    square = np.einsum("ij,ij->i", to_light, to_light)
    to_light /= np.sqrt(np.maximum(square, 1e-6))[:, None]
    cosine = np.einsum("ij,ij->i", to_light, wall.normals)
    diffuse = np.clip((cosine + faults.wrap) / (1 + faults.wrap), 0, 1) + faults.ambient
    falloff = 1 / (square + np.float32(faults.reach_mm**2))
    if faults.beam > 0:
        falloff *= np.clip(-to_light[:, 2], 0.02, 1) ** faults.beam  # the LED looks along the optical axis
    if lit is not None:
        falloff = falloff * lit
    reflectance = np.minimum(np.maximum(wall.color, 1e-3) ** faults.gamma, 1.2)
    radiance = reflectance * (diffuse * falloff)[:, None]
    if faults.bounce > 0:
        direct = np.maximum(cosine, 0) * falloff
        radiance += reflectance * np.float32(faults.bounce) * bounced(surface, wall.normals, reflectance, direct)
    if faults.gloss > 0:
        radiance += (_highlights(surface, wall, to_light, faults) * falloff)[:, None]
    if faults.turbidity_per_mm > 0:
        radiance = _through_water(radiance, surface.distance_mm, falloff, faults)
    return _expose(radiance, faults)


def room_beside(surface: Surface, beside: Floats) -> float:
    """How far, in mm, the wall is from the optical axis towards ``beside`` (3,): a tip fits there, and so must its LED.

    It is measured at the rim of what the lens sees, within 60 degrees of that direction; inf where no wall is seen.
    """
    sine = np.hypot(surface.rays[:, 0], surface.rays[:, 1])
    if not len(sine):
        return float(np.inf)
    rim = (sine > _RIM * sine.max()) & (surface.rays @ beside > 0.5 * sine)
    return float((sine * surface.distance_mm)[rim].min(initial=np.inf))


def _highlights(surface: Surface, wall: PaintedWall, to_light: Floats, faults: LightFaults) -> Floats:
    half = to_light - surface.rays
    half /= np.sqrt(np.maximum(np.einsum("ij,ij->i", half, half), 1e-9))[:, None]
    aligned = np.clip(np.einsum("ij,ij->i", half, wall.normals), 0, 1)
    return faults.gloss * wall.wetness * aligned**faults.shininess


def _through_water(radiance: Floats, distance_mm: Floats, falloff: Floats, faults: LightFaults) -> Floats:
    """Beer-Lambert loss there and back; what is lost comes back as an even glow of the water near the light."""
    kept = np.exp(-2 * faults.turbidity_per_mm * distance_mm)[:, None]
    glow = np.float32(0.25 * np.median(falloff))
    return radiance * kept + glow * (1 - kept)


def _expose(radiance: Floats, faults: LightFaults) -> Floats:
    """Auto-exposure on the gray value's 90th percentile, then gamma."""
    if len(radiance) == 0:
        return radiance
    reference = max(float(np.percentile(radiance.mean(axis=1), 90)), 1e-12)
    return np.float32(faults.exposure_level) * (radiance / np.float32(reference)) ** np.float32(1 / faults.gamma)
