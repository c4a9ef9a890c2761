"""Learning how far answers can be trusted, from simulated pictures of the very kidney, when its VID is built."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ursnav_torch.errors import FeatureError
from ursnav_torch.files import Progress, no_progress
from ursnav_torch.geometry import angle_between
from ursnav_torch.localization.ambiguity import find_look_alikes
from ursnav_torch.localization.fitting import NOTHING
from ursnav_torch.localization.learned import evidence_table
from ursnav_torch.localization.locate import Localizer
from ursnav_torch.processes import in_order
from ursnav_torch.rendering import WarpSettings, deform_mesh
from ursnav_torch.rendering.sensor import PRESETS, WIDE, Preset, draw_faults, none_pictures, simulate
from ursnav_torch.scaling import scaled
from ursnav_torch.threads import one_thread_an_operation
from ursnav_torch.vid import MakeRenderer, PlanSettings, Vid, plan_views

Array = NDArray[np.float64]

#: Kinds of pictures that certainty is learned from.
LEARNED_FROM: Mapping[str, Preset] = MappingProxyType({**PRESETS, "wide": WIDE})
#: Share of pictures that show no calyx among those learned from.
NONE_SHARE = 0.5
#: A VID of more views is not sent to other processes: each would hold it again.
MOST_VIEWS_SENT = 20_000
#: Pictures drawn in one state of a moved and swollen kidney.
PICTURES_A_WARP = 8


@dataclass(frozen=True, slots=True)
class Query:
    """A simulated picture and what it shows.

    Attributes:
        image: (H, W, 3) uint8, blue, green, red.
        T_kidney_camera: (4, 4); nan for a picture of nothing.
        calyx: index of the calyx observed, -1 for none, `NOTHING` for a picture of nothing.
        preset: which faults it was drawn with, or "none".
    """

    image: NDArray[np.uint8]
    T_kidney_camera: NDArray[np.float64]
    calyx: int
    preset: str


def simulated_queries(
    vid: Vid,
    make_renderer: MakeRenderer,
    plan: PlanSettings,
    rng: np.random.Generator,
    presets: Mapping[str, Preset] = PRESETS,
) -> Iterator[Query]:
    """A picture from every pose of a plan, the presets of sensor faults taking turns.

    Pictures of all but the thesis's presets are drawn in a kidney that has moved and swollen since the scan; their pose
    is the one relative to the wall around.
    """
    views = plan_views(vid.kidney, vid.lumen, plan)
    yield from queries_from(vid, make_renderer, views.T_kidney_camera, views.calyx, rng, presets)


def queries_from(
    vid: Vid,
    make_renderer: MakeRenderer,
    T_kidney_camera: Array,
    calyces: NDArray[np.int64],
    rng: np.random.Generator,
    presets: Mapping[str, Preset] = PRESETS,
) -> Iterator[Query]:
    """`simulated_queries` from poses (N, 4, 4) that were planned elsewhere, which observe ``calyces`` (N,)."""
    renderer, names, moved_pictures = make_renderer(vid.kidney.mesh, vid.camera), list(presets), 0
    scale = vid.kidney.scale
    for i, (T, calyx) in enumerate(zip(T_kidney_camera, calyces, strict=True)):
        name = names[i % len(names)]
        faults = draw_faults(presets[name], rng)
        if name.startswith("thesis"):
            yield Query(simulate(renderer, T, faults, rng), T, int(calyx), name)
            continue
        if moved_pictures % PICTURES_A_WARP == 0:
            warp = WarpSettings(amplitude_mm=rng.uniform(0.5, 2.0), distension=rng.uniform(0.0, 0.1))
            moved = deform_mesh(vid.kidney.mesh, scaled(warp, scale), rng, scale)
            inside = make_renderer(moved.mesh, vid.camera)
        moved_pictures += 1
        yield Query(simulate(inside, moved.carry(T), faults, rng), T, int(calyx), name)


def learn_confidence(
    vid: Vid,
    make_renderer: MakeRenderer,
    plan: PlanSettings,
    queries_per_calyx: int = 24,
    progress: Progress = no_progress,
    make_localizer: Callable[[Vid], Localizer] = Localizer,
    children: int = 0,
) -> dict[str, object]:
    """Locate simulated pictures from poses that are no views, and keep what was known of each, to fit certainty to.

    Args:
        vid: the views, already with features.
        make_renderer: called as ``make_renderer(mesh, camera)``.
        plan: how the VID's views were planned; the queries are planned alike, with a seed of their own.
        queries_per_calyx: pictures of each calyx.
        progress: ``progress(total, what)`` gives a context with ``advance(n)``.
        make_localizer: with the settings that pictures will be located with; confidence holds for them alone.
        children: processes that locate while this one draws; the result is the same with any number.

    Returns:
        Plain data for `certainty_model`.
    """
    rng = np.random.default_rng(plan.seed + 1)
    alike = replace(
        plan, views_per_calyx=queries_per_calyx, passage_views=queries_per_calyx, around=0.0, seed=plan.seed + 1
    )
    total = round((1 + NONE_SHARE) * queries_per_calyx * (len(vid.kidney.calyces) + 1))
    asker, pictures = partial(_Asker, vid, make_localizer), _pictures(vid, make_renderer, alike, rng)
    rows = []
    with progress(total, "pictures to learn from") as advance:
        for row in in_order(asker, pictures, children if len(vid) <= MOST_VIEWS_SENT else 0):
            rows += [] if row is None else [row]
            advance(1)
    shown, answered = (np.array([row[key] for row in rows], np.int64) for key in ("shown", "answered"))
    far = np.array([row["far"] for row in rows])
    look_alikes = find_look_alikes(shown, answered, far, len(vid.kidney.calyces))
    return {
        "confidence": {"settings": make_localizer(vid).evidence_settings(), "pictures": evidence_table(rows)},
        "queries": len(rows),
        "right": int((shown == answered).sum()),
        "look_alikes": look_alikes.to_dict(),
    }


class _Asker:
    """Called with a query: its row, see `answer_row`."""

    def __init__(self, vid: Vid, make_localizer: Callable[[Vid], Localizer]) -> None:
        self.localizer = make_localizer(vid)

    def __call__(self, query: Query) -> dict[str, Any] | None:
        return answer_row(self.localizer, query)


def ask(localizer: Localizer, queries: Iterable[Query], advance: Callable[[int], None]) -> list[dict[str, Any]]:
    """`answer_row` of every picture that can be located; ``advance`` is called with 1 after each."""
    rows = []
    for query in queries:
        advance(1)
        row = answer_row(localizer, query)
        rows += [] if row is None else [row]
    return rows


def answer_row(localizer: Localizer, query: Query) -> dict[str, Any] | None:
    """A row for `evidence_table`, and ``answered``, ``kind`` and ``far``, the way in mm from the shown calyx's tip.

    None for a picture that shows too little.
    """
    vid, T = localizer.vid, query.T_kidney_camera
    with torch.inference_mode(), one_thread_an_operation():
        try:
            found = localizer.judge(localizer.features(query.image))
        except FeatureError:
            return None
        scale = vid.kidney.scale
        ways = {
            "refined": (found.evidence, *_errors(localizer.pose(found), T, scale)),
            "nearest": (found.nearest, *_errors(localizer.nearest_pose(found), T, scale)),
        }
    far = float(vid.lumen.to_calyces(T[:3, 3])[0, query.calyx]) if query.calyx >= 0 else np.nan
    return ways | {"shown": query.calyx, "answered": found.calyx, "kind": query.preset, "far": far}


def _errors(T: Array, T_true: Array, scale: float) -> tuple[float | None, float | None]:
    """How far off a pose is, mm at scale 1 and degrees; None where there is no truth."""
    if not np.isfinite(T_true).all():
        return None, None
    turned = np.degrees(angle_between(T[:3, 2], T_true[:3, 2]))
    return float(np.linalg.norm(T[:3, 3] - T_true[:3, 3])) / scale, float(turned)


def _pictures(vid: Vid, make_renderer: MakeRenderer, plan: PlanSettings, rng: np.random.Generator) -> Iterator[Query]:
    """Pictures of every kind in turn, then pictures of nothing."""
    count = 0
    for query in simulated_queries(vid, make_renderer, plan, rng, LEARNED_FROM):
        count += 1
        yield query
    yield from nothing_queries(vid, make_renderer, rng, round(NONE_SHARE * count))


def nothing_queries(vid: Vid, make_renderer: MakeRenderer, rng: np.random.Generator, count: int) -> Iterator[Query]:
    """Pictures of nothing, whose calyx no answer equals."""
    renderer = make_renderer(vid.kidney.mesh, vid.camera)
    for image, _ in none_pictures(rng, count, renderer, vid.T_kidney_camera):
        yield Query(image, np.full((4, 4), np.nan), NOTHING, "none")
