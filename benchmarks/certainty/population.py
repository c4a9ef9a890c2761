"""Pictures of a population of phantoms, of every kind, and what was known of each; kept in a folder from run to run."""

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.shared.fingerprints import sources
from benchmarks.shared.kidneys import Still
from benchmarks.shared.phantoms import phantom_vid
from ursnav_torch.features import DefaultSettings
from ursnav_torch.files import write_json
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.localization import Localizer
from ursnav_torch.localization.fitting import Asked
from ursnav_torch.localization.learn import Query, ask, nothing_queries, simulated_queries
from ursnav_torch.localization.learned import asked_from_table, evidence_table
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.rendering.sensor import PRESETS, WIDE, Preset
from ursnav_torch.rendering.sensor.presets import IN_VIVO_LIKE
from ursnav_torch.vid import PlanSettings, Vid

#: Groups of faults that are widened alone.
GROUPS = ("wall", "light", "bodies", "occluders", "optics")
FIRST_SEED = 2000
#: Where evidence comes from: `sources` of these rooms. What was learned from it is in none of them.
ROOMS = ("rendering", "features", "vid", "matching", "search", "alignment")
#: Calyces of the phantoms, in turn.
CALYCES = (7, 9, 6, 8, 10, 7)


def kinds() -> dict[str, Preset]:
    """The presets, everything widened at once, and one group of faults widened in pictures that are in-vivo-like."""
    alone = {
        f"wide {group}": {
            **{k: v for k, v in IN_VIVO_LIKE.items() if not k.startswith(f"{group}.")},
            **{k: v for k, v in WIDE.items() if k.startswith(f"{group}.")},
        }
        for group in GROUPS
    }
    return {**PRESETS, **alone, "wide": WIDE}


def kinds_without(kind: str) -> Sequence[str]:
    """What must not be learned from for ``kind`` to be one never seen: itself, and all that holds its faults."""
    return (kind, "wide") if kind.startswith("wide ") else (kind,)


def asked_of(seeds: Sequence[int], pictures: int, views: int, work: Path, refined: bool) -> Asked:
    """What was known of all pictures of some phantoms."""
    rows = list(chain.from_iterable(phantom_rows(seed, pictures, views, work) for seed in seeds))
    return asked_from_table(rows, refined)


def phantom_rows(seed: int, pictures: int, views: int, work: Path) -> list[dict[str, Any]]:
    """Plain rows of one phantom's pictures, from the work folder where they lie there already."""
    path = work / f"certainty_{seed:03d}_{views}_{pictures}.json"
    came_from = current_settings() + sources(ROOMS)
    if path.exists():
        kept = json.loads(path.read_text(encoding="utf-8"))
        if kept.get("came_from") == came_from:
            return list(kept["rows"])
    rows = _asked(vid_of_phantom(seed, views, work), pictures, views, seed)
    write_json(path, {"came_from": came_from, "rows": rows})
    print(f"phantom {seed}: {len(rows)} pictures asked", file=sys.stderr, flush=True)
    return rows


def current_settings() -> str:
    """`Localizer.evidence_settings` of a VID with the default features, without one."""
    return Localizer.settings_line(DefaultSettings())


def vid_of_phantom(seed: int, views: int, work: Path) -> Vid:
    """The VID of one phantom of the population."""
    kidney = make_phantom_kidney(seed=FIRST_SEED + seed, calyces=CALYCES[seed % len(CALYCES)])
    plan = PlanSettings(views_per_calyx=views, passage_views=views)
    return phantom_vid(kidney, plan, work / f"certainty_vid_{seed:03d}_{views}")


def _asked(vid: Vid, pictures: int, views: int, seed: int) -> list[dict[str, Any]]:
    """``pictures`` of every kind, and twice as many of nothing."""
    rng = np.random.default_rng(70_000 + seed)
    queries = chain(
        _drawn(vid, pictures, seed, rng),
        nothing_queries(vid, RaycastRenderer, rng, 2 * pictures),
    )
    asked = ask(Localizer(vid), queries, lambda n: None)
    table = evidence_table(asked)
    return [row | {"kidney": seed, "kind": a["kind"]} for row, a in zip(table, asked, strict=True)]


def _drawn(vid: Vid, pictures: int, seed: int, rng: np.random.Generator) -> Iterator[Query]:
    """``pictures`` of every kind."""
    presets = kinds()
    each = round(pictures * len(presets) / (len(vid.kidney.calyces) + 1)) + 1
    plan = replace(
        PlanSettings(), views_per_calyx=each, passage_views=each, around=0.0, roll_deg=180.0, seed=501 + seed
    )
    return simulated_queries(vid, RaycastRenderer, plan, rng, _shuffled(presets, rng))


def phantom_stills(vid: Vid, pictures: int, seed: int) -> Iterator[Still]:
    """The same pictures of a phantom's calyces, ``pictures`` of every kind, which is their style."""
    for n, query in enumerate(_drawn(vid, pictures, seed, np.random.default_rng(70_000 + seed))):
        if query.calyx >= 0:
            calyx = vid.calyx_name(query.calyx)
            yield Still(f"phantom {seed}", query.preset, str(n), query.image, calyx, query.T_kidney_camera)


def _shuffled(presets: Mapping[str, Preset], rng: np.random.Generator) -> dict[str, Preset]:
    names = list(presets)
    return {names[i]: presets[names[i]] for i in rng.permutation(len(names))}
