"""Exploring by itself over a population of phantoms, in simulated time.

    python -m benchmarks.exploring work=DIR                      # the judging half, places from the tracker
    python -m benchmarks.exploring work=DIR pose=true            # true places with noise instead of the tracker
    python -m benchmarks.exploring work=DIR half=choosing        # the half that settings may be chosen with
    python -m benchmarks.exploring work=DIR half=choosing set=room_mm=3,turn_per_s=2    # other settings

In every phantom one calyx is blocked by a stone that the map does not know, but that pictures tell of (with true
places, once it was in sight for long enough, with the errors of the map of stones). It and the calyces whose way the
scope's limits do not allow (`ScopeLimits`: too narrow, too bent) are out of reach. The scope has plays and breathes.
What the explorer says is compared with the wall that the true poses saw; its path with the shortest tour through the
calyces in reach, and to before the necks that it looked through, without and with the way to the stone. Seeds make the
halves; results are kept in ``work`` for each phantom and setting, and the next call goes on from there. ``tissue=``
names what an operation does besides, of breathing, swelling, bleeding and buckling (see `TissueSettings`). What a scope
can see is what ``views`` a calyx see, and ``around`` times as many that look any way.

Of twelve phantoms explored by the tracker's places one calyx was once called inspected and was not (``flights_49``, E).
Looked at picture by picture, by no command: of 1,074 poses 63 were more than 3 mm off, 47 of them while the scope stood
12 to 13 mm before the tip of E, where a stone bars the way; 42 of these were told more than 3 mm too deep, 25 nearer to
the tip than the stone's center, with deviations of 1.0 to 2.6 mm. Since then a picture counts only where its place is
sure to `CoverageSettings.largest_sd_mm`, and from no place past a stone in the way. That necks are looked behind, and
do not rule places out, came of ``flights_57``, ``flights_51`` and ``flights_41``, and that resistance is met alike at
any rate of pictures of ``flights_61``: these five have had a say.
"""

import hashlib
import itertools
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.exploring.sight import CoverageBehind, StoneSight, in_sight
from benchmarks.exploring.tours import shortest_tours_mm
from benchmarks.exploring.twins import Anatomy, anatomy_of, stone_in, tissue_of, twin_in
from benchmarks.shared.fingerprints import sources
from benchmarks.shared.flights import CHOOSING, JUDGING, Case, population
from benchmarks.shared.results import Report, overrides
from benchmarks.shared.statistics import wilson
from benchmarks.stones.scores import NEAR_MM
from ursnav_torch.autonomy import AutonomySettings, Explorer, State
from ursnav_torch.autonomy.visits import INSPECTED, NOT_REACHED, NOT_TRIED, PARTLY, UNSEEN
from ursnav_torch.devices import Limits
from ursnav_torch.errors import InputError
from ursnav_torch.exploration import ScopeLimits
from ursnav_torch.exploration.coverage import Coverage
from ursnav_torch.exploration.route import route_to
from ursnav_torch.files import write_json
from ursnav_torch.geometry import transform_from
from ursnav_torch.navigation.rehearsal import PictureAnswer, Rehearsal, Rehearsed
from ursnav_torch.simulation import SimulatedTime, Twin, TwinPilot
from ursnav_torch.stones import FoundStone, StoneMapSettings, watch_stones
from ursnav_torch.tracking.robot.odometry import OdometryReading
from ursnav_torch.tracking.tracker import TRACKING, Tracker
from ursnav_torch.vid import Vid

Array = NDArray[np.float64]

#: A change of their code makes results anew.
ROOMS = ("autonomy", "exploration", "navigation", "simulation", "stones", "tracking")
TRUE, TRACKED = "true", "tracked"
SETTINGS = {
    "phantoms": 8, "views": 60, "around": 0.0, "half": JUDGING, "pose": TRACKED, "seconds": 300.0,
    "tissue": "breathing", "rate_hz": 15.0, "work": "", "set": "", "only": "", "out": "",
}  # fmt: skip
#: Noise of places that stand for a tracker's: mm and degrees, each axis.
NOISE_MM, NOISE_DEG = 0.3, 1.5
#: Stones are told anew every so many pictures: once a second, as live.
STONES_EVERY = 15
#: A shaft compressed by more pushes against a wall by force, mm.
FORCED_MM = 0.5
#: A tip so near to the stone's surface pushes against it, mm: what is kept off, and the breath.
AT_STONE_MM = 1.8


def main(arguments: Sequence[str]) -> int:
    """Explore, print the table and keep the figures."""
    settings = overrides(SETTINGS, arguments)
    if settings["half"] not in (CHOOSING, JUDGING) or settings["pose"] not in (TRUE, TRACKED):
        raise InputError(f"half= is {CHOOSING} or {JUDGING}, pose= {TRUE} or {TRACKED}; got {settings}.")
    if settings["set"] and settings["half"] != CHOOSING:
        raise InputError(f"set= tries a setting, which the {JUDGING} half must not see; give half={CHOOSING}.")
    told = {k: v for k, v in settings.items() if k not in ("work", "out", "only")}
    report = Report("exploring" if settings["pose"] == TRACKED else "exploring-true-places", told)
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(settings["work"] or scratch)
        cases = {c.kidney: c for c in population(settings["phantoms"]) if c.half == settings["half"]}
        chosen = [case for name, case in cases.items() if settings["only"] in name]
        found = [explored(case, settings, work) for case in chosen]
    add_figures(report, found)
    report.finish(settings["out"])
    return 0


def explored(case: Case, settings: dict[str, Any], work: Path) -> dict[str, Any]:
    """What exploring one phantom brought; from the work folder where the same was done already."""
    careful = tried(settings["set"])
    told = tuple(settings[k] for k in ("views", "around", "pose", "seconds", "tissue", "rate_hz"))
    key = sources(ROOMS) + repr([case.kidney, case.seed, case.kind, careful, *told])
    path = work / "explored" / f"{case.kidney}_{hashlib.sha256(key.encode()).hexdigest()[:8]}.json"
    if not path.exists():
        known = anatomy_of(case, settings["views"], settings["around"], work, drawn=settings["pose"] == TRACKED)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, explore_phantom(case, known, careful, settings))
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    print(f"{case.kidney}: {found['seconds']:.0f} s, {found['path_mm']:.0f} mm, {found['end']}", file=sys.stderr)
    for c in found["calyces"]:
        print(f"  {c['calyx']}{' (stone)' if c['blocked'] else ''}: {c['verdict']}, own {c['share']:.2f}, "
              f"true {c['true_share']:.2f} {c.get('reason', '')}", file=sys.stderr)  # fmt: skip
    return found


def tried(text: str) -> AutonomySettings:
    """Settings with some changed: ``room_mm=3,turn_per_s=2``."""
    changes = dict(part.split("=", 1) for part in text.split(",") if part)
    default = AutonomySettings()
    return replace(default, **{k: type(getattr(default, k))(v) for k, v in changes.items()})


def explore_phantom(case: Case, known: Anatomy, careful: AutonomySettings, settings: dict[str, Any]) -> dict[str, Any]:
    """Explore one phantom; the facts, as they are kept."""
    rng, kidney, lumen = np.random.default_rng([case.seed, 21]), known.kidney, known.lumen
    stone, blocked = stone_in(known, rng)
    own = Coverage(kidney, known.camera, lumen, known.T_kidney_camera[::2])
    truth = CoverageBehind(stone, kidney, known.camera, lumen, known.T_kidney_camera[::2])
    explorer = Explorer(own, lumen, careful)
    clock = SimulatedTime()
    twin = twin_in(case, known, rng, clock, stone, tissue_of(settings["tissue"]))
    sight = StoneSight(known, stone, blocked, np.random.default_rng([case.seed, 24]))
    locate = noisy_truth(rng, sight) if known.vid is None else tracker_of(known.vid)
    operator = TwinPilot(twin, kidney, clock=clock) if settings["pose"] == TRACKED else None
    rehearsal = Rehearsal(twin, explorer, locate, settings["rate_hz"], operator, clock)
    if operator is not None:  # a person leads in, until the tracker has found its place
        operator.hands_over = lambda: rehearsal.autopilot.is_placed
    begun = time.monotonic()
    found = rehearsal.run(settings["seconds"], truth)
    seen = in_sight(known, stone)
    told = facts(explorer, rehearsal, found, truth, (stone, blocked))
    return told | {"took_s": time.monotonic() - begun, "stone_in_sight": seen}


def facts(
    explorer: Explorer, rehearsal: Rehearsal, found: Rehearsed, truth: Coverage, barred: tuple[Array, int]
) -> dict[str, Any]:
    """What an exploration said and did, beside what is true; ``barred`` are the stone and the calyx that it closes."""
    kidney, careful, (stone, blocked) = explorer.kidney, explorer.settings, barred
    visits, start = explorer.account().visits, kidney.centerline.points_mm[0]
    ways = [route_to(kidney, start, c, ScopeLimits()) for c in range(len(kidney.calyces))]
    within = [c for c, way in enumerate(ways) if c != blocked and (way.feasible or visits[c].tried)]
    tours_mm = shortest_tours_mm(kidney, careful.standoff_mm, stone, blocked, within)
    true_share = {c.calyx: c.share for c in truth.calyces()}
    return {
        "seconds": found.t_s[-1], "end": explorer.machine.reason, "finished": explorer.finished,
        "path_mm": found.path_mm, "tour_mm": tours_mm[0], "tour_with_stone_mm": tours_mm[1],
        "forced": contacts(found, stone), "pressed_mm": max(found.pressed_mm),
        "limits_passed": limits_passed(found, rehearsal.robot.limits),
        "disarmed": found.disarmed, "faults": found.faults[:5],
        "position_mm": np.percentile(found.off_mm, [50, 90]).tolist(),
        "states": {s: found.states.count(s) for s in dict.fromkeys(found.states)},
        "ways_mm": found.ways_mm(),
        "stones": told_stones(found.stones, stone, blocked),
        "settings": asdict(careful),
        "calyces": [
            v.to_dict() | {"true_share": round(true_share[v.calyx], 4), "blocked": i == blocked,
                           "feasible": ways[i].feasible, "narrowest_mm": ways[i].narrowest_mm}
            for i, v in enumerate(visits)
        ],
    }  # fmt: skip


def told_stones(told: Sequence[FoundStone], stone: Array, blocked: int) -> list[dict[str, Any]]:
    """Of every stone that was told, the largest first: whether it is the true one (x, y, z, radius), and how well."""
    found: list[dict[str, Any]] = []
    for one in sorted(told, key=lambda s: -s.size_mm):
        off, size = float(np.linalg.norm(one.center_mm - stone[:3])), 2 * float(stone[3])
        right = off - size / 2 < NEAR_MM and not any(f["right"] for f in found)
        found.append({
            "right": right, "off_mm": off, "size_share": one.size_mm / size - 1, "size_mm": one.size_mm,
            "in_calyx": one.calyx == blocked, "state": one.state,
        })  # fmt: skip
    return found


def limits_passed(found: Rehearsed, limits: Limits) -> int:
    """In how many pictures the joints were beyond the robot's limits."""
    joints = np.array(found.joints).reshape(-1, 3)
    too_bent = np.hypot(joints[:, 0], joints[:, 1]) > limits.max_bend_rad + 1e-6
    too_far = (joints[:, 2] < -1e-6) | (joints[:, 2] > limits.max_insertion_mm + 1e-6)
    return int(too_bent.sum() + too_far.sum())


def noisy_truth(rng: np.random.Generator, sight: StoneSight) -> Callable[[Twin, float], PictureAnswer]:
    """True places with noise, and the stone once it was seen."""

    def locate(twin: Twin, t_s: float) -> PictureAnswer:
        turn = Rotation.from_rotvec(rng.normal(0, np.radians(NOISE_DEG), 3)).as_matrix()
        true = twin.pose()
        T = true @ transform_from(turn, rng.normal(0, NOISE_MM, 3))
        return PictureAnswer(T, position_sd_mm=NOISE_MM * 3**0.5, stones=sight.see(true, t_s))

    return locate


def tracker_of(vid: Vid) -> Callable[[Twin, float], PictureAnswer]:
    """Places and stones from the pictures, by the tracker as it runs live, with what the robot reports."""
    tracker = Tracker(vid)
    watch = watch_stones(tracker, StoneMapSettings())
    frames = itertools.count()
    stones: tuple[FoundStone, ...] = ()

    def locate(twin: Twin, t_s: float) -> PictureAnswer:
        nonlocal stones
        joints = twin.scope.drive.joints(twin.axes_mm())
        odometry = OdometryReading(joints.insertion_mm, joints.bend_x_rad, joints.bend_y_rad)
        image = twin.image()
        tracked = tracker.follow(tracker.extract(image), t_s, None, None, odometry, image)
        frame = next(frames)
        watch.see(tracked, image, t_s, frame)
        if frame % STONES_EVERY == 0:
            stones = watch.stones.stones()
        if tracked.state != TRACKING or tracked.T_kidney_camera is None or not np.isfinite(tracked.score):
            return PictureAnswer(None, stones=stones)
        sure = tracked.certainty
        calyces = () if sure is None else tuple(c for c in sure.calyces if c >= 0)
        sd = None if sure is None else sure.position_sd_mm
        play = tracker.slider_play_mm
        return PictureAnswer(tracked.T_kidney_camera, calyces, sd, tracked.is_settled, play, stones, tracked.bodies)

    return locate


def contacts(found: Rehearsed, stone: Array) -> dict[str, int]:
    """How often the shaft began to push by force: against the wall, against the stone, and while a person led it in."""
    forced = np.array(found.pressed_mm) > FORCED_MM
    begun = np.flatnonzero(forced[1:] & ~forced[:-1]) + 1
    by_hand = np.array([found.states[i] == State.WAITING.value for i in begun], bool)
    places = np.array(found.T_kidney_camera)[begun, :3, 3]
    at_stone = np.linalg.norm(places - stone[:3], axis=1) < stone[3] + AT_STONE_MM
    counted = {"wall": ~at_stone & ~by_hand, "stone": at_stone & ~by_hand, "by_hand": by_hand}
    return {what: int(which.sum()) for what, which in counted.items()}


def add_figures(report: Report, found: Sequence[dict[str, Any]]) -> None:
    """The bars of exploring by itself."""
    calyces = [c for f in found for c in f["calyces"]]
    shut = [c for c in calyces if c["blocked"] or not c["feasible"]]
    open_ = [c for c in calyces if c not in shut]

    def share(name: str, hits: int, of: int) -> None:
        if not of:
            report.skip(name, "there was none")
            return
        low, high = wilson(hits, of)
        note = f"{hits}/{of}, 95 % interval {100 * low:.1f} to {100 * high:.1f} %"
        report.add("exploring", name, "%", [100 * hits / of], note, of)

    said = [c for c in calyces if c["verdict"] == INSPECTED]
    share("reachable calyces inspected", sum(c["verdict"] == INSPECTED for c in open_), len(open_))
    share("all calyces inspected", len(said), len(calyces))
    named = [c for c in calyces if c["verdict"] == NOT_REACHED]
    missed = [c for c in shut if c["verdict"] != INSPECTED]
    right = sum(c["verdict"] == NOT_REACHED and bool(c.get("reason")) for c in missed)
    share("out of reach and not inspected: called not reached, with the reason", right, len(missed))
    share("of those called not reached, really out of reach", sum(c in shut for c in named), len(named))
    for verdict in (PARTLY, UNSEEN, NOT_TRIED):
        hits = sum(c["verdict"] == verdict for c in calyces)
        report.add("exploring", f"calyces {verdict}", "calyces", [hits], n=len(calyces))
    for least in (0.7, 0.8, 0.9):
        wrong = sum(c["true_share"] < least for c in said)
        report.add("exploring", f"called inspected, less than {least:.0%} really seen", "calyces", [wrong], n=len(said))
    for what, name in (("wall", "with the wall"), ("stone", "with the stone"), ("by_hand", "of who leads it in")):
        report.add("exploring", f"forced contacts {name}", "contacts", [sum(f["forced"][what] for f in found)])
    for what, length in (("", "tour_mm"), (" that finds the stone, too", "tour_with_stone_mm")):
        ratios = [f["path_mm"] / f[length] for f in found]
        report.add("exploring", f"path over shortest tour{what}", "x", ratios)
    for state in (State.APPROACHING, State.INSPECTING, State.RETREATING, State.WITHDRAWING, State.LOOKING):
        shares = [f["ways_mm"].get(state.value, 0.0) / f["tour_mm"] for f in found]
        report.add("exploring", f"path while {state.value}, over shortest tour", "x", shares)
    add_stones(report, found)
    report.add("exploring", "limits passed", "times", [sum(f["limits_passed"] for f in found)], n=len(found))
    report.add("exploring", "disarmed by the watchdog", "times", [sum(f["disarmed"] for f in found)], n=len(found))
    report.add("exploring", "not finished in time", "kidneys", [sum(not f["finished"] for f in found)], n=len(found))
    report.add("exploring", "simulated time a kidney", "s", [f["seconds"] for f in found])
    report.add("exploring", "position error, median of a kidney", "mm", [f["position_mm"][0] for f in found])
    report.add("exploring", "position error, 90th percentile of a kidney", "mm", [f["position_mm"][1] for f in found])


def add_stones(report: Report, found: Sequence[dict[str, Any]]) -> None:
    """How well the stones of the kidneys were told."""
    told = [s for f in found for s in f["stones"]]
    right = [s for s in told if s["right"]]
    report.add(
        "exploring", "stones told", "%", [100 * len(right) / len(found)], f"{len(right)}/{len(found)}", len(found)
    )
    seen = [f for f in found if f["stone_in_sight"]]
    hits, of = sum(s["right"] for f in seen for s in f["stones"]), len(seen)
    if seen:
        report.add(
            "exploring", "of stones that a pose in reach shows, told", "%", [100 * hits / of], f"{hits}/{of}", of
        )
    wrong = [s for s in told if not s["right"]]
    for what, some in (("", wrong), (", of 2 mm and more", [s for s in wrong if s["size_mm"] >= 2])):
        name, a_kidney = f"stones told that are none{what}, a kidney", len(some) / len(found)
        report.add("exploring", name, "stones", [a_kidney], f"{len(some)} in {len(found)}", len(found))
    if right:
        calyx = 100 * sum(s["in_calyx"] for s in right) / len(right)
        report.add("exploring", "stones told, in the right calyx", "%", [calyx], n=len(right))
        report.add("exploring", "stones told, place off by", "mm", [s["off_mm"] for s in right])
        report.add("exploring", "stones told, size off by", "%", [100 * abs(s["size_share"]) for s in right])
