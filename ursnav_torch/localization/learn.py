"""Learning how far answers can be trusted, from simulated pictures of the very kidney, when its VID is built."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ursnav_torch.errors import FeatureError
from ursnav_torch.files import Progress, no_progress
from ursnav_torch.localization.ambiguity import find_look_alikes
from ursnav_torch.localization.confidence import REFINED_NUMBERS, fit
from ursnav_torch.localization.locate import Localizer
from ursnav_torch.rendering import WarpSettings, deform_mesh
from ursnav_torch.rendering.sensor import PRESETS, draw_faults, none_pictures, simulate
from ursnav_torch.threads import one_thread_an_operation
from ursnav_torch.vid import MakeRenderer, PlanSettings, Vid, plan_views

#: Share of pictures that show no calyx among those learned from.
NONE_SHARE = 0.5
#: Pictures drawn in one state of a moved and swollen kidney.
PICTURES_A_WARP = 8


@dataclass(frozen=True, slots=True)
class Query:
    """A simulated picture and what it shows.

    Attributes:
        image: (H, W, 3) uint8, blue, green, red.
        T_kidney_camera: (4, 4); nan for a picture of nothing.
        calyx: index of the calyx observed, -1 for none.
        preset: which faults it was drawn with, or "none".
    """

    image: NDArray[np.uint8]
    T_kidney_camera: NDArray[np.float64]
    calyx: int
    preset: str


def simulated_queries(
    vid: Vid, make_renderer: MakeRenderer, plan: PlanSettings, rng: np.random.Generator
) -> Iterator[Query]:
    """A picture from every pose of a plan, the presets of sensor faults taking turns.

    ``in_vivo_like`` pictures are drawn in a kidney that has moved and swollen since the scan; their pose is the one
    relative to the wall around.
    """
    views = plan_views(vid.kidney, vid.lumen, plan)
    renderer, names = make_renderer(vid.kidney.mesh, vid.camera), list(PRESETS)
    for i, (T, calyx) in enumerate(zip(views.T_kidney_camera, views.calyx, strict=True)):
        name = names[i % len(names)]
        faults = draw_faults(PRESETS[name], rng)
        if name != "in_vivo_like":
            yield Query(simulate(renderer, T, faults, rng), T, int(calyx), name)
            continue
        if i // len(names) % PICTURES_A_WARP == 0:
            warp = WarpSettings(amplitude_mm=rng.uniform(0.5, 2.0), distension=rng.uniform(0.0, 0.1))
            moved = deform_mesh(vid.kidney.mesh, warp, rng)
            inside = make_renderer(moved.mesh, vid.camera)
        yield Query(simulate(inside, moved.carry(T), faults, rng), T, int(calyx), name)


def learn_confidence(
    vid: Vid,
    make_renderer: MakeRenderer,
    plan: PlanSettings,
    queries_per_calyx: int = 24,
    progress: Progress = no_progress,
    make_localizer: Callable[[Vid], Localizer] = Localizer,
) -> dict[str, object]:
    """Locate simulated pictures from poses that are no views, and fit confidence to what came out.

    Args:
        vid: the views, already with features.
        make_renderer: called as ``make_renderer(mesh, camera)``.
        plan: how the VID's views were planned; the queries are planned alike, with a seed of their own.
        queries_per_calyx: pictures of each calyx.
        progress: ``progress(total, what)`` gives a context with ``advance(n)``.
        make_localizer: with the settings that pictures will be located with; confidence holds for them alone.

    Returns:
        Plain data for `Confidence.from_calibration`.
    """
    rng = np.random.default_rng(plan.seed + 1)
    alike = replace(plan, views_per_calyx=queries_per_calyx, passage_views=queries_per_calyx, seed=plan.seed + 1)
    localizer = make_localizer(vid)
    lumen = vid.lumen
    found, shown, far = [], [], []
    total = round((1 + NONE_SHARE) * queries_per_calyx * (len(vid.kidney.calyces) + 1))
    with torch.inference_mode(), one_thread_an_operation(), progress(total, "pictures to learn from") as advance:
        for image, calyx, T in _pictures(vid, make_renderer, alike, rng):
            advance(1)
            try:
                features = localizer.features(image)
            except FeatureError:
                continue
            judged = localizer.judge(features)
            found.append((judged.numbers, judged.calyx, judged.voted))
            shown.append(calyx)
            far.append(lumen.to_calyces(T[:3, 3])[0, calyx] if calyx >= 0 else np.nan)
    numbers, answered, voted = (np.array(column) for column in zip(*found, strict=True))
    nearest = numbers[:, :-REFINED_NUMBERS] if localizer.refines else numbers
    right = np.array(shown) == answered
    look_alikes = find_look_alikes(np.array(shown), answered, np.array(far), len(vid.kidney.calyces))
    return {
        "confidence": {
            "settings": localizer.evidence_settings(),
            "refined": list(fit(numbers, right).weights),
            "nearest": list(fit(nearest, np.array(shown) == voted).weights),
        },
        "queries": len(right),
        "right": int(right.sum()),
        "look_alikes": look_alikes.to_dict(),
    }


def _pictures(
    vid: Vid, make_renderer: MakeRenderer, plan: PlanSettings, rng: np.random.Generator
) -> Iterator[tuple[NDArray[np.uint8], int, NDArray[np.float64]]]:
    """Pictures, the calyx each shows and its pose; -2, which no answer equals, for pictures of nothing."""
    count = 0
    for query in simulated_queries(vid, make_renderer, plan, rng):
        count += 1
        yield query.image, query.calyx, query.T_kidney_camera
    renderer = make_renderer(vid.kidney.mesh, vid.camera)
    for image, _ in none_pictures(rng, round(NONE_SHARE * count), renderer, vid.T_kidney_camera):
        yield image, -2, np.full((4, 4), np.nan)
