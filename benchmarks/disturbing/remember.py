"""What only computes is done once and remembered: moments of death then fall where files change, and take little time.

A run is most of its time busy with what changes no file: a kill there is like one at the change before. So functions
that only compute give, the second time, what they gave the first for the same arguments.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh

#: Functions that compute for long and change no file, where they are looked up.
COMPUTING = (
    "kidney.make_phantom_kidney", "kidney.load_mesh_kidney", "kidney.LumenDistance.from_kidney", "vid.build.plan_views",
    "rendering.RaycastRenderer.render", "features.default.DefaultExtractor.extract",
    "localization.Localizer.locate", "reports.matches.draw_overview", "runs.track.draw_coverage",
    "calibration.calibrate_camera", "segmentation.write.scan_lumen", "segmentation.write.name_kidney",
    "segmentation.write.preview", "printing.make_printed_phantom", "printing.write.check_print",
    "printing.write.print_picture", "thesis.run.drive_robot",
)  # fmt: skip


def remember() -> None:
    """Make the functions of `COMPUTING` remember, in this process and in those that it forks."""
    for place in COMPUTING:
        *holder, name = place.split(".")
        owner: Any = import_module("ursnav_torch." + ".".join(part for part in holder if part.islower()))
        for part in holder:
            owner = owner if part.islower() else getattr(owner, part)
        kept = vars(owner)[name]
        found = _remembering(kept.__func__ if isinstance(kept, classmethod) else kept)
        setattr(owner, name, classmethod(found) if isinstance(kept, classmethod) else found)


def _remembering(compute: Callable[..., Any]) -> Callable[..., Any]:
    known: dict[bytes, Any] = {}

    def remembered(*arguments: Any, **named: Any) -> Any:
        digest = hashlib.sha256()
        _add(digest, [arguments, named])
        key = digest.digest()
        if key not in known:
            known[key] = compute(*arguments, **named)
        return known[key]

    return remembered


def _add(digest: Any, value: Any) -> None:
    """Add what a value says to a digest: of a path the last part, of what is no plain data its kind and its lens."""
    digest.update(type(value).__name__.encode())
    if isinstance(value, torch.Tensor):
        value = value.numpy()
    if isinstance(value, np.ndarray):
        digest.update(repr(value.shape).encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, trimesh.Trimesh):
        digest.update(value.vertices.tobytes() + value.faces.tobytes())
    elif isinstance(value, Path):
        digest.update(value.name.encode())
    elif isinstance(value, (str, int, float, bool, bytes, type(None))):
        digest.update(repr(value).encode())
    elif isinstance(value, Mapping):
        _add(digest, list(value.items()))
    elif isinstance(value, (list, tuple)):
        for item in value:
            _add(digest, item)
    elif is_dataclass(value) and not isinstance(value, type):
        _add(digest, [getattr(value, field.name) for field in fields(value)])
    else:  # a renderer or an extractor is told by its lens and its settings
        _add(digest, [getattr(value, name) for name in ("camera", "settings") if hasattr(value, name)])
