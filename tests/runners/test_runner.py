"""The runner contract, as far as it does not depend on what a runner does."""

import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given, settings
from hypothesis import strategies as st
from omegaconf import OmegaConf

from ursnav_torch import _runner
from ursnav_torch.__main__ import runners
from ursnav_torch._runner import caller_path, quote_path, runner
from ursnav_torch.errors import InputError

AWKWARD = "a b,c=d[1]{2}(ä) 'q' \"z\" #$ %x;é~!"


@pytest.fixture
def end(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Callable[..., Any]:
    """Runs a task as a runner with the configuration of ``match``; gives exit code, standard output and error."""

    def call(task: Callable[[Any], int | None], *overrides: str) -> tuple[Any, str, str]:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["x.py", *overrides])
        monkeypatch.setattr(warnings, "formatwarning", warnings.formatwarning)
        with pytest.raises(SystemExit) as exit_:
            runner("match", paths=("images", "report"))(task)()
        assert not list(tmp_path.iterdir()), "nothing is written in the caller's folder"
        return exit_.value.code, *capsys.readouterr()

    return call


def fails(error: BaseException) -> Callable[[Any], None]:
    def task(config: Any) -> None:
        raise error

    return task


def wrapped(config: Any) -> None:
    try:
        raise InputError("The lens is cracked.")
    except InputError as error:
        raise RuntimeError("Error in call to target 'ursnav_torch.camera.load_camera'") from error


@pytest.mark.parametrize(
    ("task", "code", "says"),
    [
        (lambda config: None, 0, ""),
        (lambda config: 3, 3, ""),
        (fails(InputError("The lens is cracked.")), 1, "error: The lens is cracked.\n"),
        (wrapped, 1, "error: The lens is cracked.\n"),
        (fails(KeyError("views")), 1, "error: KeyError: 'views' (HYDRA_FULL_ERROR=1 shows where)\n"),
        (lambda config: config.out, 2, "error: out= is missing; give it on the command line (--help shows all).\n"),
    ],
)
def test_exit_codes_and_one_line(end: Any, task: Callable[[Any], int | None], code: int, says: str) -> None:
    assert end(task) == (code, "", says)


def test_an_interruption_says_how_to_go_on(end: Any) -> None:
    code, _, err = end(fails(KeyboardInterrupt()))
    assert code == 1 and "interrupted" in err and err.count("\n") == 1


def test_the_whole_error_on_demand(end: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["x.py"])
    with pytest.raises(InputError, match="cracked"):
        runner("match")(fails(InputError("cracked")))()


@pytest.mark.parametrize("override", ["nonsense", "no_such_key=1", "matching=magic", "localization.risk=[", "--wrong"])
def test_wrong_usage(end: Any, override: str) -> None:
    code, _, err = end(lambda config: None, override)
    assert code == 2 and "Traceback" not in err and err


def test_help_names_the_choices(end: Any) -> None:
    code, out, _ = end(lambda config: None, "--help")
    assert code in (0, None) and "sinkhorn" in out and "images:" in out


@pytest.mark.parametrize(
    "path",
    ["2026", "0x10", "1e5", "true", "nUll", "a b", "a,b", "a=b", "[x]", "{x: 1}", "(1)", "'a'", '"a"', "it's", "${vid}",
     "${oc.env:HOME}", "\\", "a\\", "a\\'b", "\\${x}", "a:b", "Nieren ä/é.stl", "~x", "*.png", "a#b", "", AWKWARD],
)  # fmt: skip
def test_a_path_arrives_as_it_was_typed(end: Any, path: str) -> None:
    seen: list[Any] = []
    keys = ("out", "images", "report", "vid")
    assert end(lambda config: seen.extend(config[k] for k in keys), *(f"{k}={path}" for k in keys))[0] == 0
    assert seen == [path] * 4


@given(st.text(st.sampled_from("\\'\"${}[]=,: aä"), max_size=9))
@settings(max_examples=300, deadline=None)
def test_quoting_survives_any_text(path: str) -> None:
    override = OverridesParser.create().parse_override(quote_path(f"out={path}", {"out"}))
    assert OmegaConf.create({"out": override.value()}).out == path


def test_only_paths_are_quoted() -> None:
    for argument in ("accept=0.5", "out", "--help", "report=null", "hydra.run.dir=x"):
        assert quote_path(argument, {"out", "report"}) == argument
    assert quote_path("kidney.calyces=7", {"kidney.calyces"}) == "kidney.calyces=7", "a phantom's number"
    assert quote_path("kidney.calyces=7.csv", {"kidney.calyces"}) == "kidney.calyces='7.csv'"
    assert quote_path("+kidney.path=a b", {"kidney.path"}) == "+kidney.path='a b'"


def test_relative_paths_mean_the_callers_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert caller_path("a/../b c") == tmp_path / "a/../b c" and caller_path(2026) == tmp_path / "2026"
    assert caller_path("/x") == Path("/x") and caller_path("~/x") == Path.home() / "x"


def test_progress_is_lines_on_standard_error_where_nobody_watches(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = iter([0.0, 3.0, 9.0, 11.0, 11.0, 12.0])
    monkeypatch.setattr(_runner.time, "monotonic", lambda: next(clock))
    with _runner.progress(40, "views") as advance:
        for n in (1, 2, 30, 7):
            advance(n)
    assert capsys.readouterr() == ("", "views: 33 of 40\n")


def test_the_list_of_runners_has_a_line_each() -> None:
    found = runners()
    assert {"build_vid", "match"} <= set(found)
    assert all(line.endswith(".") and len(line) < 110 for line in found.values())
    listed = subprocess.run([sys.executable, "-m", "ursnav_torch"], capture_output=True, text=True, check=True)
    assert all(f"  {name}" in listed.stdout for name in found) and "not a medical device" in listed.stdout


def test_runners_import_nothing_heavy_before_they_are_called() -> None:
    """So that --help answers within a second."""
    names = ", ".join(f"ursnav_torch.{name}" for name in runners())
    code = (
        f"import sys, {names}; print(*(m for m in ('torch', 'kornia', 'cv2', 'scipy', 'trimesh') if m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_a_word_alone_sets_what_it_names_and_no_other_word_is_taken(run, monkeypatch) -> None:
    told = []
    monkeypatch.setattr("ursnav_torch.demo._live", lambda config, out: told.append((config.live, out.name)))
    assert run("demo", "live", "out=my flight").code == 0 and told == [(True, "my flight")]
    assert run("demo", "lively").code == 2 and len(told) == 1


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("image=pictures", "'image' is no setting of match; near it: images"),
        ("search.learned=0.1", "'search.learned' is no setting of match"),
        ("locaization.risk=0.1", "'locaization.risk' is no setting of match; near it: localization.risk"),
    ],
)
def test_a_setting_that_is_none_is_named_with_what_is_near_it(run, given: str, meant: str) -> None:
    finished = run("match", given, "matching=hungarian")
    assert finished.code == 2 and meant in finished.err and "`ursnav match --cfg job` shows them all" in finished.err


def test_a_choice_that_is_none_is_told_by_hydra_alone(run) -> None:
    finished = run("match", "matching=sinkhron")
    assert finished.code == 2 and "sinkhorn" in finished.err and "error:" not in finished.err
