"""Every reader of the package, found by its signature, so that a new one is fuzzed without being listed."""

import importlib
import inspect
import itertools
import pkgutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import ursnav_torch
from ursnav_torch.em_log import EmFormat

#: How the names of functions begin that read a file or a folder.
_VERBS = ("read", "load", "open", "from_json")
#: What classes call their first argument when they read a file or a folder as they are made.
_PLACES = ("path", "folder")
#: Values for further arguments that have no default, by name; a reader that needs another one is an error here.
_ARGUMENTS: dict[str, Any] = {
    "what": "fuzzed",
    "where": "the fuzzed bytes",
    "required": ("x_mm",),
    "names": tuple("ABCDEF"),
    "most_bytes": 1 << 20,
    "offset_camera_mm": (0.0, 0.0, 0.0),
    "kind": "TDATA",
    "form": EmFormat(),
}
#: Not fed, and why.
_LEFT_OUT = {
    "segmentation.load.load_ct_kidney": "segments for seconds what read_scan has read",
    "kidney.mesh.load_mesh_kidney": "looks for calyces for seconds in what read_mesh has read",
    "session.record.Recorder": "writes",
    "segmentation.scans.read.read_scan_here": "runs in a process apart, see segmentation.scans.apart.read_scan",
    "reports.matches.MatchReport": "writes",
    "runs.journal.Journal": "reads only what the same run wrote, see tests/runs/test_matched_resume.py",
    "devices.robots.guardian.Guardian": "hears only the program that started it, over a pipe of its own",
    "devices.robots.guardian.Guardian.feed": "hears only the program that started it, over a pipe of its own",
    "vid.lumen_file.load_lumen": "needs the kidney that it belongs to; load_vid has verified its bytes before",
}
_WRITERS = ("pack", "write", "save", "send", "handle", "inline")


@dataclass(frozen=True, slots=True)
class Reader:
    """One way into the package.

    Attributes:
        name: module and function, without the package's name.
        takes: ``path`` or ``bytes``.
        call: reads one input to its end.
    """

    name: str
    takes: str
    call: Callable[[Any], Any]


def find_readers() -> list[Reader]:
    """All readers, by name.

    Raises:
        LookupError: one has an argument that `_ARGUMENTS` knows no value for.
    """
    found = []
    for module in pkgutil.walk_packages(ursnav_torch.__path__, "ursnav_torch."):
        room = module.name.removeprefix("ursnav_torch.")
        if room.split(".")[0] in ("simulation", "thesis", "results") or room.startswith("_") or "." not in room:
            if room not in ("camera", "records", "pictures", "inputs", "tables"):
                continue
        for name, call in _callables(importlib.import_module(module.name)):
            takes = _takes(name, call)
            if takes and f"{room}.{name}" not in _LEFT_OUT:
                found.append(Reader(f"{room}.{name}", takes, _filled(f"{room}.{name}", call)))
    return sorted(found, key=lambda reader: reader.name)


def _callables(module: Any) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Public functions, classes and class methods that a module defines."""
    for name, value in vars(module).items():
        if name.startswith("_") or getattr(value, "__module__", "") != module.__name__:
            continue
        if inspect.isfunction(value):
            yield name, value
        elif inspect.isclass(value):
            yield name, value
            for inner, method in vars(value).items():
                if isinstance(method, classmethod) and not inner.startswith("_"):
                    yield f"{name}.{inner}", getattr(value, inner)
                elif inner == "feed":
                    yield f"{name}.{inner}", lambda data, kind=value: kind().feed(data)


def _takes(name: str, call: Callable[..., Any]) -> str:
    """``path``, ``bytes``, or blank for what is no reader."""
    try:
        parameters = list(inspect.signature(call).parameters.values())
    except ValueError:  # exceptions have none
        return ""
    last = name.rpartition(".")[2]
    if last == "feed":
        return "bytes"
    if not parameters or last.startswith(_WRITERS):
        return ""
    kind = parameters[0].annotation
    if kind is bytes or kind == "bytes":
        return "bytes" if not inspect.isclass(call) else ""
    if "Path" not in str(kind) or "ArrayLike" in str(kind) or "numpy" in str(kind):
        return ""
    is_reader = parameters[0].name in _PLACES if inspect.isclass(call) else last.startswith(_VERBS)
    return "path" if is_reader else ""


def _filled(name: str, call: Callable[..., Any]) -> Callable[[Any], Any]:
    further = list(inspect.signature(call).parameters.values())[1:]
    needed = [p.name for p in further if p.default is p.empty and p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    if name.endswith(".feed"):
        needed = []
    unknown = [n for n in needed if n not in _ARGUMENTS]
    if unknown:
        raise LookupError(f"{name} is a reader with {', '.join(unknown)}; give them values in {__name__}._ARGUMENTS.")
    values = {n: _ARGUMENTS[n] for n in needed}
    return lambda data: _to_the_end(call(data, **values))


def _to_the_end(found: Any) -> Any:
    """Read what a reader left for later: events of a record, moments of a video, pictures of a VID."""
    for later in ("events", "moments", "results", "pictures"):
        if callable(getattr(found, later, None)):
            list(itertools.islice(iter(getattr(found, later)()), 100))
    return found
