"""What every suite writes: one JSON file a run, one schema, and the same figures as a table.

Method: every row of a group is measured on the same input in the same process, in interleaved rounds after a
warm-up, so that a busy machine slows all of them alike; the median and the quartiles are kept, losing rows too.
"""

import functools
import json
import math
import os
import platform
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import torch

from ursnav_torch.errors import InputError, UrsnavError

FOLDER = Path(__file__).parents[1] / "results"
FORMAT = 1
_PACKAGES = ("torch", "numpy", "scipy", "POT", "opencv-python-headless", "opencv-contrib-python-headless")


@dataclass(frozen=True, slots=True)
class Row:
    """One figure of a suite.

    Attributes:
        group: the table it belongs to.
        name: what was measured.
        unit: "ms", "%", "x", "GF/s" and so on.
        median: the figure; the median where it was measured more than once.
        quartiles: (lower, upper); both equal to the median for a single count such as an accuracy.
        n: measurements, or items that were counted.
        note: anything that a reader must know.
    """

    group: str
    name: str
    unit: str
    median: float
    quartiles: tuple[float, float]
    n: int
    note: str = ""


@dataclass(slots=True)
class Report:
    """The rows of one run of a suite, and what could not be run."""

    suite: str
    settings: dict[str, Any]
    rows: list[Row] = field(default_factory=list)
    skipped: list[dict[str, str]] = field(default_factory=list)

    def add(self, group: str, name: str, unit: str, samples: Sequence[float], note: str = "", n: int = 0) -> Row:
        """Add the median of `samples`; `n` tells the count behind a single figure."""
        low, middle, high = _quartiles(samples)
        row = Row(group, name, unit, middle, (low, high), n or len(samples), note)
        self.rows.append(row)
        return row

    def skip(self, name: str, reason: str) -> None:
        """Say, in the report and at once, that `name` was left out."""
        self.skipped.append({"name": name, "reason": reason})
        print(f"skipped {name}: {reason}", file=sys.stderr)

    def write(self, path: Path | None = None) -> Path:
        """Write the JSON file, to `FOLDER` unless a path is given, and return where it is."""
        path = path or FOLDER / f"{self.suite}--{_slug(processor())}.json"
        content = describe_run(self)
        validate(content)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(path.name + ".partial")
        partial.write_text(json.dumps(content, indent=1) + "\n")
        partial.replace(path)
        return path

    def finish(self, out: str = "") -> None:
        """Print the tables, write the JSON file (to `FOLDER` when ``out`` is empty) and say where it is."""
        print(self.table())
        print(f"\nwritten to {self.write(Path(out) if out else None)}")

    def table(self) -> str:
        """The rows as one Markdown table a group."""
        lines: list[str] = []
        for group in dict.fromkeys(row.group for row in self.rows):
            lines += ["", f"**{group}**", "", "| what | median | quartiles | n | note |", "|---|--:|--:|--:|---|"]
            for r in (r for r in self.rows if r.group == group):
                low, high = (_number(q) for q in r.quartiles)
                lines.append(f"| {r.name} | {_number(r.median)} {r.unit} | {low} to {high} | {r.n} | {r.note} |")
        return "\n".join([*lines, "", *(f"skipped {s['name']}: {s['reason']}" for s in self.skipped)])


def errors_told(main: Callable[[Sequence[str]], int]) -> Callable[[Sequence[str]], int]:
    """A suite's ``main`` that says in one line what was wrong with what it was given, and returns 1."""

    @functools.wraps(main)
    def told(arguments: Sequence[str]) -> int:
        try:
            return main(arguments)
        except UrsnavError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1

    return told


def time_interleaved(
    calls: Mapping[str, Callable[[], Any]], rounds: int, warm_up: int = 1, repeats: Mapping[str, int] | None = None
) -> dict[str, list[float]]:
    """Milliseconds of every call in every round, the calls taking turns.

    Args:
        calls: what to time, by name.
        rounds: measurements a call.
        warm_up: rounds before that which do not count.
        repeats: how often to run a short call in one measurement (the mean counts); 1 where left out.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for round_ in range(warm_up + rounds):
        for name, call in calls.items():
            count = (repeats or {}).get(name, 1)
            start = time.perf_counter()
            for _ in range(count):
                call()
            if round_ >= warm_up:
                times[name].append((time.perf_counter() - start) * 1e3 / count)
    return times


def describe_run(report: Report) -> dict[str, Any]:
    """The report as plain data, with machine, threads, versions and commit."""
    return {
        "format": FORMAT,
        "suite": report.suite,
        "machine": {"processor": processor(), "cores": os.cpu_count() or 1, "system": platform.system()},
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else 0.0,
        "threads": torch.get_num_threads(),
        "versions": _versions(),
        "commit": commit(),
        "date": time.strftime("%Y-%m-%d"),
        "settings": report.settings,
        "rows": [asdict(row) for row in report.rows],
        "skipped": report.skipped,
    }


_FIELDS: dict[str, type | tuple[type, ...]] = {
    "format": int,
    "suite": str,
    "machine": dict,
    "load": (int, float),
    "threads": int,
    "versions": dict,
    "commit": str,
    "date": str,
    "settings": dict,
    "rows": list,
    "skipped": list,
}


def validate(content: dict[str, Any]) -> None:
    """Check one results file.

    Raises:
        InputError: a field is missing, unknown, of another type or out of range; the message names it.
    """
    if set(content) != set(_FIELDS):
        raise InputError(f"Fields differ from the schema: {sorted(set(content) ^ set(_FIELDS))}.")
    for name, kind in _FIELDS.items():
        if not isinstance(content[name], kind):
            raise InputError(f"Field {name} is a {type(content[name]).__name__}.")
    if content["format"] != FORMAT or content["threads"] < 1 or not content["rows"]:
        raise InputError(f"Expected format {FORMAT}, at least one thread and at least one row.")
    if set(content["machine"]) != {"processor", "cores", "system"} or "torch" not in content["versions"]:
        raise InputError("The machine or the version of torch is not told.")
    if not re.fullmatch(r"[0-9a-f]{7,40}(\+changes)?|unknown", content["commit"]):
        raise InputError(f"commit is {content['commit']!r}.")
    for row in content["rows"]:
        _validate_row(row)


def _validate_row(row: dict[str, Any]) -> None:
    if set(row) != set(Row.__dataclass_fields__):
        raise InputError(f"Row {row.get('name')!r} has other fields than {sorted(Row.__dataclass_fields__)}.")
    low, high = row["quartiles"]
    if not all(isinstance(v, (int, float)) and math.isfinite(v) for v in (low, row["median"], high)):
        raise InputError(f"Row {row['name']!r} has a figure that is not a finite number.")
    if not low <= row["median"] <= high or row["n"] < 1 or not (row["group"] and row["name"] and row["unit"]):
        raise InputError(f"Row {row['name']!r} has quartiles out of order, no count, or an empty name.")


def resident_mb() -> float:
    """Memory of this process now, in MB; 0 where the system does not tell."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1e3 for line in lines if line.startswith("VmRSS:")), 0.0)


def overrides(defaults: dict[str, Any], arguments: Sequence[str]) -> dict[str, Any]:
    """`defaults` with ``key=value`` arguments taken over, each as the type of its default.

    Ends the program with 2 and a line on wrong usage, as every runner does.
    """
    values = dict(defaults)
    for argument in arguments:
        key, _, text = argument.partition("=")
        if key not in defaults or "=" not in argument:
            sys.exit(_usage(f"{argument!r} is not one of {', '.join(f'{k}=' for k in defaults)}"))
        try:
            values[key] = _parse(text, defaults[key])
        except ValueError:
            sys.exit(_usage(f"{argument!r}: expected a value like {defaults[key]!r}"))
    return values


def work_folder(settings: Mapping[str, Any], holds: str) -> Path:
    """The folder ``work=``, made where it is missing; ``holds`` says what is kept there.

    Raises:
        InputError: none was given.
    """
    if not settings["work"]:
        raise InputError(f"work= must name a folder for {holds}.")
    folder = Path(settings["work"])
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _usage(text: str) -> int:
    print(text, file=sys.stderr)
    return 2


def _parse(text: str, default: Any) -> Any:
    if isinstance(default, bool):
        if text not in ("true", "false"):
            raise ValueError(text)
        return text == "true"
    return type(default)(text)


def processor() -> str:
    """The processor's name."""
    info = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*:\s*(.+)", info.read_text(encoding="utf-8")) if info.exists() else []
    return names[0].strip() if names else platform.processor() or platform.machine()


def commit() -> str:
    """The commit that is checked out, with "+changes" if files differ from it; "unknown" outside git."""
    try:
        root = Path(__file__).parents[1]
        run = ["git", "-C", str(root)]
        found = subprocess.run([*run, "rev-parse", "--short=12", "HEAD"], capture_output=True, text=True, check=True)
        package = [*run, "status", "--porcelain", "--", "../ursnav_torch", "*.py"]
        changed = subprocess.run(package, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return found.stdout.strip() + ("+changes" if changed else "")


def _versions() -> dict[str, str]:
    out = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return out


def _quartiles(samples: Sequence[float]) -> tuple[float, float, float]:
    if len(samples) == 1:
        return float(samples[0]), float(samples[0]), float(samples[0])
    low, middle, high = statistics.quantiles(samples, n=4, method="inclusive")
    return low, middle, high


def _number(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
