"""Learning how sure answers are, and judging it on pictures that nothing was learned from.

    python -m benchmarks.certainty work=DIR                 # learn from phantoms, judge on others; some minutes each
    python -m benchmarks.certainty work=DIR save=true       # and store what was learned with the package
    python -m benchmarks.certainty work=DIR data=DIR        # judge what the package knows on kidneys' pictures, too

Every phantom has a VID and is asked with pictures of every kind: the presets, everything widened, and one group of
faults widened alone. Weights, thresholds and the conformal sets come from the first two thirds of the phantoms, each
calibrated by the others; the figures are of the last third, which nothing was chosen on, once with all kinds learned
from, and of every kind once with that kind left out. What is stored is learned in the same way from all of them. A
flight through each phantom does the same for tracks.
What was known of each picture is kept in ``work``, so that another fit takes seconds; after a change of settings, code
or weights that it came from it is asked for anew. Other arguments: ``phantoms=16 pictures=36`` (of a kind)
``flight=80`` (pictures of a flight; with 0 the package's tracks stay as they are, and their position, which
`benchmarks.flights` learns, stays in any case) ``views=120`` (a calyx) ``risk=0.01`` ``probability=0.95``
``learn=false`` (judge what the package knows) ``out=FILE.json``.

Tried before and left, on six phantoms: squares of the numbers make confidence likelier (0.287 against 0.299 nats) and
the first wrong answers surer; a threshold proven on the presets alone is 0.94, not 0.986, and 4 % of what it accepts
of the widened kinds is wrong; the number ``firm`` among the others, and not in a factor of its own, leaves 238 of 1,135
accepted at one wrong in a hundred, not 276; no weight of novelty below 8 is as likely on kinds left out.

Gradient-boosted trees on the same numbers and every calyx's extremes, no command, each of sixteen phantoms by what the
others teach, accept 49.4 % of all kinds and pictures of nothing at one wrong in a hundred, not 47.3 %: what is missing
is evidence, not another model of it.

Two more kinds of evidence, by no command, in a logistic regression on the same numbers, each phantom by what the others
teach: how well the drawing and the picture agree in each part of the picture (561 stills of four phantoms; quantiles of
the correlations in 3 by 3, 4 by 4 and 6 by 6 parts) leaves 0.286 to 0.296 nats, not 0.288; how well the mirrored
picture is aligned, and how far away it is found (280 of two), 0.325 to 0.326, not 0.326. With two phantoms alone the
former had seemed to win (0.300, not 0.326).

On the last four of twelve phantoms what the first eight taught accepted 53 % (59 of the in-vivo-like), with a
calibration error of 0.029 and sets of 2.4 calyces; the same fit to the first four, by no command, 45 % (49), 0.034
and 2.5: more phantoms prove a lower threshold. What is stored comes from sixteen, asked after the wall network had
been taught on and alignment found the water's glow; on the last five of them what the first eleven teach accepts
55.8 % (60), with 0.037 and 2.5 calyces.
On nine, each by what the others teach, the likeliest calyx (or none) answered in place of the aligned pose's is right
in 2,317 of 2,737 pictures, not 2,308, and 1,569 are accepted, not 1,621.
"""

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.certainty.figures import Told, report_told, told
from benchmarks.certainty.flights import learn_track
from benchmarks.certainty.kidneys import judge_kidneys
from benchmarks.certainty.population import asked_of, current_settings, kinds, kinds_without
from benchmarks.shared.results import Report, errors_told, overrides
from ursnav_torch.localization.calibrating import learn_certainty
from ursnav_torch.localization.certainty import CertaintyModel
from ursnav_torch.localization.fitting import Asked
from ursnav_torch.localization.learned import Packaged, packaged_models, save_packaged

DEFAULTS = {
    "phantoms": 16, "pictures": 36, "flight": 80, "views": 120, "work": "", "data": "", "save": False, "learn": True,
    "risk": 0.01, "probability": 0.95, "out": "",
}  # fmt: skip


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Learn, judge, print the tables and write the JSON file."""
    settings = overrides(DEFAULTS, arguments)
    if settings["phantoms"] < 3:
        print(f"error: phantoms={settings['phantoms']} leaves none to judge by; give 3 or more", file=sys.stderr)
        return 2
    report = Report("certainty", {k: v for k, v in settings.items() if k not in ("out", "work", "data", "save")})
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(settings["work"] or scratch)
        work.mkdir(parents=True, exist_ok=True)
        if settings["learn"]:
            _learn(report, settings, work)
        if settings["data"]:
            judge_kidneys(report, Path(settings["data"]), work, settings["risk"], settings["probability"])
    report.finish(settings["out"])
    return 0


def _learn(report: Report, settings: dict[str, Any], work: Path) -> None:
    """Learn for answers with and without refinement; judge both, the refined ones kind by kind left out, too."""
    count = settings["phantoms"]
    learned_on = max(2, round(count * 2 / 3))
    for how in ("refined", "nearest"):
        ask = (settings["pictures"], settings["views"], work, how == "refined")
        learning, judging = asked_of(range(learned_on), *ask), asked_of(range(learned_on, count), *ask)
        model = learn_certainty(learning, kinds_without)
        report_told(report, f"{how}: phantoms never seen", _told(model, judging, settings))
        weight = model.regressions.novelty.weight
        report.add(f"{how}: learned", "log-odds off for novelty", "a sd", [weight], n=len(learning))
        report.add(f"{how}: learned", "accepted from confidence", "of 1", [model.threshold(settings["risk"])])
        if how == "refined":
            left_out(report, learning, judging, weight, settings)
    track = (
        learn_track(report, range(learned_on), range(learned_on, count), settings, work) if settings["flight"] else None
    )
    if settings["save"]:
        packaged = packaged_models()
        if (
            packaged is not None and packaged.track is not None
        ):  # flights that go wrong, too, teach how far off a track is
            kept = packaged.track
            track = kept if track is None else replace(track, position=kept.position, position_told=kept.position_told)
        every = {how: _every(report, how, settings, work) for how in ("refined", "nearest")}
        save_packaged(Packaged(current_settings(), every["refined"], every["nearest"], track))
        print("stored with the package", file=sys.stderr)


def _every(report: Report, how: str, settings: dict[str, Any], work: Path) -> CertaintyModel:
    """What all phantoms teach."""
    asked = asked_of(range(settings["phantoms"]), settings["pictures"], settings["views"], work, how == "refined")
    model = learn_certainty(asked, kinds_without)
    report.add(f"{how}: stored", "accepted from confidence", "of 1", [model.threshold(settings["risk"])], n=len(asked))
    return model


def left_out(report: Report, learning: Asked, judging: Asked, weight: float, settings: dict[str, Any]) -> None:
    """Every kind judged by what was learned without it."""
    found: list[Told] = []
    for kind in kinds():
        rest = learning.subset(~np.isin(learning.kind, kinds_without(kind)))
        model = learn_certainty(rest)
        novelty = replace(model.regressions.novelty, weight=weight)
        model = replace(model, regressions=replace(model.regressions, novelty=novelty))
        found += _told(model, judging.subset(judging.kind == kind), settings)
    report_told(report, "refined: a kind left out, phantoms never seen", found)


def _told(model: CertaintyModel, asked: Asked, settings: dict[str, Any]) -> list[Told]:
    return told(model, asked, settings["risk"], settings["probability"])
