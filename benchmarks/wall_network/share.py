"""How much of the relief the wall network should say: ``python -m benchmarks.wall_network.share work=DIR``.

Pictures of phantoms that the network never saw, of every kind that certainty is learned from, are located with each
share; what is right is counted, and how far off positions are. Arguments, each ``key=value``: ``work=DIR`` (keeps the
VIDs), ``phantoms=3`` ``views=60`` (a calyx) ``pictures=24`` (a calyx, the kinds taking turns)
``vary=learned=0,0.15,0.3,0.5,1`` (the shares) ``out=FILE.json``.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.certainty.population import kinds
from benchmarks.shared.phantoms import phantom_vid
from benchmarks.shared.results import Report, errors_told, overrides, work_folder
from benchmarks.shared.vary import named_values, with_value
from ursnav_torch.errors import FeatureError
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.localization import Localizer, Query, simulated_queries
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import PlanSettings

DEFAULTS = {"work": "", "phantoms": 3, "views": 60, "pictures": 24, "vary": "learned=0,0.15,0.3,0.5,1", "out": ""}
FIRST_SEED = 1100
#: What a picture that shows too little is off by, mm.
_NOWHERE_MM = 100.0


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Run the choice, print its tables and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    work = work_folder(settings, "the phantoms' VIDs")
    report = Report("wall_network_share", {k: v for k, v in settings.items() if k not in ("work", "out")})
    name, values = named_values(settings["vary"])
    choices = {value: with_value(DefaultSettings(), name, value) for value in values}
    answers: dict[tuple[str, str], list[tuple[bool, float]]] = {}
    for seed in range(FIRST_SEED, FIRST_SEED + settings["phantoms"]):
        plan = PlanSettings(views_per_calyx=settings["views"], passage_views=settings["views"])
        vid = phantom_vid(make_phantom_kidney(seed), plan, work / f"share_{seed}_{settings['views']}")
        alike = replace(
            plan, views_per_calyx=settings["pictures"], passage_views=0, nearest_mm=3.0, farthest_mm=11.0, tilt_deg=8.0,
            roll_deg=180.0, seed=77,
        )  # fmt: skip
        asked = {value: Localizer(replace(vid, settings=choice)) for value, choice in choices.items()}
        for query in simulated_queries(vid, RaycastRenderer, alike, np.random.default_rng(seed), kinds()):
            for value, localizer in asked.items():
                answer = _answer(localizer, query)
                for kind in (query.preset, "all kinds"):
                    answers.setdefault((kind, value), []).append(answer)
        print(f"phantom {seed} done", file=sys.stderr, flush=True)
    for (kind, value), own in sorted(answers.items()):
        right = [r for r, _ in own]
        note = f"{sum(right)}/{len(own)}"
        report.add(f"right calyx, {kind}", f"{name}={value}", "%", [100 * float(np.mean(right))], note, len(own))
        report.add(f"position, {kind}", f"{name}={value}", "mm", [mm for _, mm in own])
    report.finish(settings["out"])
    return 0


def _answer(localizer: Localizer, query: Query) -> tuple[bool, float]:
    """Whether the calyx is right, and how far off the position is, mm."""
    try:
        found = localizer.locate(query.image)
    except FeatureError:
        return False, _NOWHERE_MM
    off = float(np.linalg.norm(found.T_kidney_camera[:3, 3] - query.T_kidney_camera[:3, 3]))
    return found.calyx == query.calyx, off


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
