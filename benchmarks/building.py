"""How fast a VID is built, features included, and what a very large one would cost: ``python -m benchmarks.building``.

A phantom's VID, with as large a share of views in passages and all around as by default, is built without calibration
through the default lens; the seconds are the runner's own: planning, drawing, features, joining and storing.
Arguments, each ``key=value``: ``views=20000`` ``workers=2`` ``repeats=1`` ``compute=local`` (or a scheduler's address,
``tcp://HOST:8786``; then ``work`` must be a shared folder) ``work=DIR`` (where the VID stays) ``out=FILE.json``.
"""

import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from benchmarks.shared.results import Report, overrides
from ursnav_torch.camera import equidistant_camera
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.rendering import HeadLight, RaycastRenderer
from ursnav_torch.vid import Compute, DaskCompute, LocalCompute, PlanSettings, build_vid

DEFAULTS = {"views": 20_000, "workers": 2, "repeats": 1, "compute": "local", "work": "", "out": ""}
#: The large VID that is reckoned from the measured cost.
LARGE = 100_000


def main(arguments: Sequence[str]) -> int:
    """Run the suite, print its tables and write its JSON file."""
    settings = overrides(DEFAULTS, arguments)
    report = Report("building", {k: v for k, v in settings.items() if k not in ("out", "work")})
    seconds, megabytes, views = [], 0.0, 0
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(settings["work"] or scratch)
        for _ in range(settings["repeats"]):
            took, megabytes, views = build(settings, work / "vid")
            seconds.append(took)
    rates = [views / s for s in seconds]
    per_view = sorted(seconds)[len(seconds) // 2] / views
    report.add("building", "views a second", "1/s", rates, f"{views} views, {settings['workers']} workers")
    report.add("building", "all", "s", seconds)
    report.add("building", "on disk", "MB", [megabytes], n=1)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    report.add("building", "greatest resident memory of the process that joins", "GiB", [memory], n=1)
    if views < LARGE:
        report.add("reckoned for 100,000 views", "time at this rate", "h", [LARGE * per_view / 3600], n=1)
    report.finish(settings["out"])
    return 0


def build(settings: Mapping[str, object], out: Path) -> tuple[float, float, int]:
    """Seconds, MB and number of views of one build into a folder; reads ``views``, ``workers`` and ``compute``."""
    kidney = make_phantom_kidney(seed=2300)
    plan = PlanSettings()
    each = max(1, round(int(str(settings["views"])) / (len(kidney.calyces) + 1 + plan.around)))
    plan = replace(plan, views_per_calyx=each, passage_views=each)
    where = str(settings["compute"])
    compute: Compute = LocalCompute(int(str(settings["workers"]))) if where == "local" else DaskCompute(where)
    start = time.perf_counter()
    vid = build_vid(
        kidney,
        equidistant_camera(),
        DefaultSettings(),
        partial(RaycastRenderer, light=HeadLight()),
        plan,
        out,
        overwrite=True,
        compute=compute,
        progress=_progress,
    )
    seconds = time.perf_counter() - start
    size = sum(p.stat().st_size for p in out.rglob("*") if p.is_file())
    return seconds, size / 1e6, len(vid)


@contextmanager
def _progress(total: int, what: str) -> Iterator[Callable[[int], None]]:
    """A line every thousand views."""
    done = 0

    def advance(views: int) -> None:
        nonlocal done
        if done // 1000 != (done + views) // 1000:
            print(f"{done + views} of {total} {what}", file=sys.stderr)
        done += views

    yield advance


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
