"""The house's rules, held over every file of the package: one name for one thing, short functions, small folders."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

import ursnav_torch

PACKAGE = Path(ursnav_torch.__file__).parent
ROOT = PACKAGE.parent
MOST_LINES, MOST_PARAMETERS, MOST_FILES = 40, 6, 16
#: Statements from which on two equal functions are one function written twice.
WORTH_SHARING = 4
Function = ast.FunctionDef | ast.AsyncFunctionDef

#: Names that mean one thing in one room and another in another; each entry would say what is to become of it.
SHARED_NAMES: dict[str, str] = {}
#: Functions that may have more parameters, and why a settings object would not help.
MANY_PARAMETERS = {
    "GrblRobot.__init__": "each is one line of the robot's YAML",
    "OpenCvCamera.__init__": "each is one line of the camera's YAML",
    "register.landmarks_job": "each is one line of the registration's YAML",
    "make_twin": "each is one line of the twin's YAML",
    "build_rig": "one parameter a device: the rig's config composes them",
    "demo.run_demo": "what the runner was told, once",
    "match.match_images": "what the runner was told, once",
    "flight_record.record_flight": "what the runner was told, once",
    "learn.learn_confidence": "what the build was told, handed on",
    "demo._draw_queries": "what the runner was told, handed on",
    "match._journaled": "what the runner was told, handed on to a worker",
    "track._tracked": "what the runner was told, handed on",
    "navigate.navigate_vid": "what the runner was told, once",
    "track.track_source": "what the runner was told, once",
    "validate.judge_matches": "what the runner was told, once",
    "experiment.run_experiment": "what the runner was told, once",
    "run.run_navigation": "what the runner was told, handed on",
    "open_session": "what the runner was told, handed on",
    "run._prepared_vid": "what the runner was told, handed on",
    "series.draw_pictures": "what the experiment draws with, once",
    "synthetic.synthetic_ct": "a made scan's properties, for tests and the demo",
    "build.build_vid": "each is one line of build_vid's YAML",
    "readings.recorded_readings": "a table, its registration, and how their times agree",
}
#: Folders that may hold more files, and why.
LARGE_FOLDERS = {
    "ursnav_torch": "the runners and the ground floor, by design",
}
#: Longer functions, and why they are not cut.
LONG = {
    "run.perform": "the thesis's protocol step by step: it is read beside the thesis",
}


def parsed() -> Iterator[tuple[Path, ast.Module]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        yield path, ast.parse(path.read_text(encoding="utf-8"))


def functions(tree: ast.Module) -> Iterator[tuple[str, Function]]:
    """Every function with the name of its class before it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            yield from ((f"{node.name}.{f.name}", f) for f in node.body if isinstance(f, Function))
    yield from ((f.name, f) for f in tree.body if isinstance(f, Function))


def body(function: Function) -> list[ast.stmt]:
    """The statements after the docstring."""
    return function.body[1:] if ast.get_docstring(function) is not None else function.body


def allowed(table: dict[str, str], path: Path, name: str) -> bool:
    return name in table or f"{path.stem}.{name}" in table


def test_no_two_classes_have_one_name() -> None:
    found = defaultdict(list)
    for path, tree in parsed():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found[node.name].append(str(path.relative_to(PACKAGE)))
    twice = {name: where for name, where in found.items() if len(where) > 1 and name not in SHARED_NAMES}
    assert not twice, f"one name for several things: {twice}"


def test_no_function_is_written_twice() -> None:
    found = defaultdict(list)
    for path, tree in parsed():
        for name, function in functions(tree):
            statements = body(function)
            if sum(isinstance(n, ast.stmt) for s in statements for n in ast.walk(s)) >= WORTH_SHARING:
                text = "\n".join(ast.dump(s) for s in statements) + ast.dump(function.args)
                found[text].append(f"{path.relative_to(PACKAGE)}: {name}")
    twice = [where for where in found.values() if len(where) > 1]
    assert not twice, f"the same function several times: {twice}"


def test_no_two_test_files_have_one_name() -> None:
    """pytest imports a test file by its bare name, so a second file of that name cannot be collected."""
    places = defaultdict(list)
    for path in (ROOT / "tests").rglob("*.py"):
        places[path.name].append(str(path.relative_to(ROOT)))
    assert not {
        name: paths for name, paths in places.items() if len(paths) > 1 and name not in ("__init__.py", "conftest.py")
    }


def test_functions_are_short() -> None:
    long = [
        f"{path.relative_to(PACKAGE)}: {name} has {lines} lines"
        for path, tree in parsed()
        for name, function in functions(tree)
        if body(function)
        and (lines := (function.end_lineno or 0) - body(function)[0].lineno + 1) > MOST_LINES
        and not allowed(LONG, path, name)
    ]
    assert not long, f"cut these into steps with names, at most {MOST_LINES} lines each: {long}"


def test_functions_have_few_parameters() -> None:
    many = []
    for path, tree in parsed():
        for name, function in functions(tree):
            a = function.args
            count = sum(arg.arg not in ("self", "cls") for arg in (*a.posonlyargs, *a.args, *a.kwonlyargs))
            if count > MOST_PARAMETERS and not allowed(MANY_PARAMETERS, path, name):
                many.append(f"{path.relative_to(PACKAGE)}: {name} has {count}")
    assert not many, f"give these a settings object, or say in MANY_PARAMETERS why not: {many}"


def test_what_is_allowed_is_still_needed() -> None:
    """An exception that nothing needs any more goes."""
    names = {f"{path.stem}.{name}" for path, tree in parsed() for name, _ in functions(tree)}
    names |= {name for _, tree in parsed() for name, _ in functions(tree)}
    assert not (MANY_PARAMETERS.keys() | LONG.keys()) - names


@pytest.mark.parametrize("top", ["ursnav_torch", "configs", "tests", "benchmarks"])
def test_folders_are_small(top: str) -> None:
    crowded = {}
    for folder in [ROOT / top, *(p for p in (ROOT / top).rglob("*") if p.is_dir())]:
        name = folder.relative_to(ROOT).as_posix()
        count = sum(p.suffix in (".py", ".yaml") for p in folder.iterdir() if p.is_file())
        if count > MOST_FILES and name not in LARGE_FOLDERS:
            crowded[name] = count
    assert not crowded, f"more than {MOST_FILES} files directly in one folder: {crowded}"


ARRAYS = {"Array", "IntArray", "Tensor", "ArrayLike", "NDArray", "Points", "Picture", "Floats", "BoolArray"}


def takes_arrays(function: Function) -> bool:
    a = function.args
    hints = [arg.annotation for arg in (*a.posonlyargs, *a.args, *a.kwonlyargs)] + [function.returns]
    return any(
        isinstance(node, ast.Name) and node.id in ARRAYS
        for hint in hints
        if hint is not None
        for node in ast.walk(hint)
    )


#: A size in a shape: a number, a letter or a name, a multiple or a sum of them, or any number of axes.
SIZE = r"(?:\d+ [A-Z]|[A-Z] [A-Z]|\d+|[A-Za-z]\w*|\.\.\.)(?: [+*/-] \w+)*"
#: What tells a shape from words in parentheses, such as (x, y): a number, a letter that stands for one, or one axis.
TELLING = r"\d|\b[A-Z][a-z]?\b|\.\.\.|,\)|\bh, w\b"
#: A shape: (N, 3), (3,), (N), (..., 4, 4).
SHAPE = re.compile(rf"\((?=[^)]*(?:{TELLING}))(?:{SIZE},\)|{SIZE}(?:, {SIZE})+\)|[A-Z]\)|\.\.\.\))")
REFERENCE = re.compile(r"\b[Ss]ee `([\w.]+)`")


def with_shape() -> set[str]:
    """Functions whose own docstring states a shape: others may refer to them."""
    named = (pair for _, tree in parsed() for pair in functions(tree))
    return {name for name, function in named if SHAPE.search(ast.get_docstring(function) or "")}


def without_shape() -> list[str]:
    found, contracts = [], with_shape()
    for path, tree in parsed():
        classes = {n.name: ast.get_docstring(n) or "" for n in ast.walk(tree) if isinstance(n, ast.ClassDef)}
        for name, function in functions(tree):
            if any(part.startswith("_") for part in name.split(".")) or not takes_arrays(function):
                continue
            text = ast.get_docstring(function) or ""
            owner = name.split(".")[0] if "." in name else ""
            # What is raised as elsewhere says nothing of what is taken.
            references = REFERENCE.findall(text.split("Raises:")[0])
            if SHAPE.search(text + classes.get(owner, "")) or not contracts.isdisjoint(references):
                continue
            found.append(f"{path.relative_to(PACKAGE)}: {name}")
    return found


def test_public_functions_that_take_or_give_arrays_say_their_shapes() -> None:
    found = without_shape()
    assert not found, f"say a shape like (N, 3), or See `Other.method` that says it: {found}"
