"""Extractors by name, so that a VID can say in plain data which one made it."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from ursnav_torch.camera import Camera
from ursnav_torch.errors import InputError
from ursnav_torch.features.base import Extractor
from ursnav_torch.features.default import DefaultExtractor, DefaultSettings
from ursnav_torch.features.rims import RimExtractor, RimSettings
from ursnav_torch.features.thesis import ThesisExtractor, ThesisSettings
from ursnav_torch.records import to_record

Settings = DefaultSettings | ThesisSettings

_KINDS: dict[str, type[DefaultSettings] | type[ThesisSettings]] = {
    "default": DefaultSettings,
    "rims": RimSettings,
    "thesis": ThesisSettings,
}


def make_extractor(settings: Settings, camera: Camera) -> Extractor:
    """The extractor of these settings for one lens."""
    if isinstance(settings, ThesisSettings):
        return ThesisExtractor(settings, camera)
    return relief_extractor(settings, camera)


def relief_extractor(settings: DefaultSettings, camera: Camera, learned: float | None = None) -> DefaultExtractor:
    """The extractor of settings that make relief maps, for one lens; ``learned`` as in `DefaultExtractor`."""
    made = RimExtractor if isinstance(settings, RimSettings) else DefaultExtractor
    return made(settings, camera, learned)


def settings_to_dict(settings: Settings) -> dict[str, Any]:
    """Plain data: the kind's name and its values."""
    kind = next(name for name, kind in _KINDS.items() if type(settings) is kind)
    return {"kind": kind} | {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(settings).items()}


def settings_from_dict(data: Mapping[str, Any]) -> Settings:
    """The inverse of `settings_to_dict`.

    Raises:
        InputError: an unknown kind or setting.
    """
    values = dict(data)
    kind = values.pop("kind", None)
    if kind not in _KINDS:
        raise InputError(f"Unknown kind of features {kind!r}; known are {', '.join(_KINDS)}.")
    return to_record(values, _KINDS[kind], f"The settings of {kind} features", True)
