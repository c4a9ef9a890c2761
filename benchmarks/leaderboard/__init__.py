"""A leaderboard of ways to explore a kidney, through the Gymnasium environment that anybody can train in.

    python -m benchmarks.leaderboard work=DIR                       # the page and the JSON beside it
    python -m benchmarks.leaderboard work=DIR add=my_lab.steer:Mine # with a policy of one's own, see `Policy`

Every policy explores the same phantoms with the same seeds, which draw roll, plays, breath, swelling, bleeding and
buckling. They are ranked by the environment's own reward: wall seen, less pushing against it.
"""

import importlib
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from benchmarks.leaderboard.policies import Drifting, Exploring, Policy, Scripted
from benchmarks.shared.phantoms import phantom_vid
from benchmarks.shared.results import Report, errors_told, overrides
from ursnav_torch.errors import InputError
from ursnav_torch.exploration.coverage import INSPECTED, OUT_OF_REACH
from ursnav_torch.files import whole_file
from ursnav_torch.kidney import make_phantom_kidney
from ursnav_torch.reports.html import render_page
from ursnav_torch.simulation import TissueSettings
from ursnav_torch.simulation.environment import ScopeEnv
from ursnav_torch.vid import PlanSettings, Vid

SETTINGS = {"kidneys": 3, "seeds": 2, "seconds": 180.0, "views": 30, "add": "", "work": "", "out": ""}
#: Phantoms of the leaderboard: no setting was chosen on them.
FIRST_KIDNEY = 300
POLICIES: dict[str, Callable[[], Policy]] = {"drifting": Drifting, "scripted": Scripted, "ursnav": Exploring}
#: A shaft that is compressed by more than this pushes by force, mm.
FORCED_MM = 0.5


@dataclass(frozen=True, slots=True)
class Episode:
    """What one policy brought in one kidney.

    Attributes:
        reward: all of the environment's rewards.
        inspected: part of the calyces in reach that were inspected.
        forced: how often it began to push by force.
        path_mm: length of the tip's way.
        seconds: until every calyx was inspected, the policy was done, or time was up.
    """

    reward: float
    inspected: float
    forced: int
    path_mm: float
    seconds: float


@errors_told
def main(arguments: Sequence[str]) -> int:
    """Run every policy, print the table, and write JSON and page."""
    settings = overrides(SETTINGS, arguments)
    policies = POLICIES | ({settings["add"]: found_policy(settings["add"])} if settings["add"] else {})
    episodes: dict[str, list[Episode]] = {name: [] for name in policies}
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(settings["work"] or scratch)
        for seed in range(FIRST_KIDNEY, FIRST_KIDNEY + settings["kidneys"]):
            plan = PlanSettings(settings["views"], settings["views"])
            vid = phantom_vid(make_phantom_kidney(seed), plan, work / f"leaderboard_{seed}_{settings['views']}")
            for name, make in policies.items():
                for number in range(settings["seeds"]):
                    episodes[name].append(run_episode(vid, make(), number, settings["seconds"]))
                    print(f"{name}, kidney {seed}, seed {number}: {episodes[name][-1]}", file=sys.stderr)
    report = Report("leaderboard", {k: v for k, v in settings.items() if k not in ("work", "out")})
    add_rows(report, episodes)
    report.finish(settings["out"])
    page = write_page(report, episodes, Path(settings["out"]) if settings["out"] else report.write())
    print(f"page: {page}")
    return 0


def found_policy(name: str) -> Callable[[], Policy]:
    """A policy by ``package.module:Name``.

    Raises:
        InputError: there is no such thing.
    """
    module, _, attribute = name.partition(":")
    try:
        found: Callable[[], Policy] = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"add={name} names no policy ({error}); give package.module:Name.") from None
    return found


def run_episode(vid: Vid, policy: Policy, seed: int, seconds: float) -> Episode:
    """One episode in a kidney that breathes, swells, bleeds and lets the shaft buckle."""
    env = ScopeEnv(vid, seconds, TissueSettings(), pictures=getattr(policy, "looks", True))
    seen, _ = env.reset(seed=seed)
    policy.begin(env, seed)
    facts: dict[str, Any] = {}
    total, path_mm, forced, pressed_before = 0.0, 0.0, 0, False
    place: Any = None
    ended = cut = False
    while not (ended or cut or policy.done):
        seen, reward, ended, cut, facts = env.step(policy.act(seen, facts))
        total += reward
        now = env.twin.undisturbed[:3, 3].copy()
        path_mm += 0.0 if place is None else float(np.linalg.norm(now - place))
        place, pressed = now, facts["pressed_mm"] > FORCED_MM
        forced += pressed and not pressed_before
        pressed_before = pressed
    verdicts = [v for v in facts["verdicts"].values() if v != OUT_OF_REACH]
    env.close()
    return Episode(total, verdicts.count(INSPECTED) / max(len(verdicts), 1), forced, path_mm, env.now_s)


def ranked(episodes: dict[str, list[Episode]]) -> list[str]:
    """Names of policies, the best by mean reward first."""
    return sorted(episodes, key=lambda name: -fmean(e.reward for e in episodes[name]))


def add_rows(report: Report, episodes: dict[str, list[Episode]]) -> None:
    """The figures of every policy, the best first."""
    for name in ranked(episodes):
        own = episodes[name]
        report.add("leaderboard", f"{name}: reward", "calyces", [e.reward for e in own])
        report.add("leaderboard", f"{name}: calyces in reach inspected", "%", [100 * e.inspected for e in own])
        report.add("leaderboard", f"{name}: forced contacts", "contacts", [e.forced for e in own])
        report.add("leaderboard", f"{name}: path", "mm", [e.path_mm for e in own])
        report.add("leaderboard", f"{name}: simulated time", "s", [e.seconds for e in own])


def write_page(report: Report, episodes: dict[str, list[Episode]], beside: Path) -> Path:
    """The page as an HTML file beside the JSON; returns its path."""
    rows = []
    for name in ranked(episodes):
        own = episodes[name]
        rewards = [e.reward for e in own]
        rows.append({
            "name": name,
            "what": (POLICIES[name].__doc__ or "").split("\n")[0] if name in POLICIES else "",
            "reward": f"{fmean(rewards):.2f} ({min(rewards):.2f} to {max(rewards):.2f})",
            "inspected": f"{100 * fmean(e.inspected for e in own):.0f} %",
            "forced": f"{fmean(e.forced for e in own):.1f}",
            "path": f"{fmean(e.path_mm for e in own):.0f} mm",
            "seconds": f"{fmean(e.seconds for e in own):.0f} s",
        })  # fmt: skip
    settings = ", ".join(f"{k} {v}" for k, v in report.settings.items() if v != "")
    path = beside.with_suffix(".html")
    with whole_file(path) as partial:
        text = render_page(
            "leaderboard.html.j2", room="benchmarks.leaderboard", title="Leaderboard", rows=rows,
            episodes=len(next(iter(episodes.values()))), settings=settings,
        )  # fmt: skip
        partial.write_text(text, encoding="utf-8")
    return path
