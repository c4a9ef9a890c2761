"""The console command ``ursnav``: the runners under one name, help, version and completion."""

import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from ursnav_torch import __main__
from ursnav_torch._help import help_text
from ursnav_torch._runner import config_dir
from ursnav_torch.completion import completion_script, runner_words


def said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str
) -> tuple[object, str, str]:
    """Exit code, standard output and error of ``ursnav ARGUMENTS``."""
    monkeypatch.setattr(sys, "argv", ["ursnav", *arguments])
    code: object = 0
    try:
        __main__.main()
    except SystemExit as exit_:
        code = exit_.code
    return code, *capsys.readouterr()


def test_lists_all_runners_and_says_its_version(monkeypatch, capsys) -> None:
    for arguments in ((), ("--help",), ("help",)):
        code, out, _ = said(monkeypatch, capsys, *arguments)
        assert code == 0 and all(f"  {name} " in out for name in __main__.runners())
    assert said(monkeypatch, capsys, "--version")[1] == f"ursnav-torch {version('ursnav-torch')}\n"


def test_a_runner_that_does_not_exist_is_refused_with_the_nearest(monkeypatch, capsys) -> None:
    code, out, error = said(monkeypatch, capsys, "mtach", "vid=x")
    assert (code, out) == (2, "") and "no runner 'mtach'. Did you mean match?" in error


def test_runs_the_same_code_with_the_same_exit_codes(monkeypatch, capsys, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, error = said(monkeypatch, capsys, "match", "vid=nowhere", "images=a.png", "out=x.csv")
    assert code == 1 and error.startswith("error: ") and "nowhere" in error
    assert said(monkeypatch, capsys, "match", "vdi=nowhere")[0] == 2


@pytest.mark.parametrize("runner", __main__.runners())
def test_help_begins_with_name_and_examples_and_ends_with_settings(runner: str, monkeypatch, capsys) -> None:
    code, out, _ = said(monkeypatch, capsys, runner, "--help")
    text = help_text(Path(config_dir()) / f"{runner}.yaml")
    assert code == 0 and out == text + "\n"
    name, examples, *_, more = text.split("\n\n")
    assert (
        name.startswith(f"NAME\n  ursnav {runner} - ")
        and examples.startswith("EXAMPLES\n  ursnav ")
        and f"\n  ursnav {runner} " in examples + " "
    )
    assert "SETTINGS" in text and "--cfg job" in more and "hydra" not in text


def test_completion_knows_keys_and_choices() -> None:
    words = runner_words("match")
    assert {"vid=", "images=", "report=", "matching=sinkhorn", "localization=shape"} <= set(words)
    assert not {"hydra=", "defaults=", "matching="} & set(words)
    assert completion_script("tcsh", ["match"]) is None


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
@pytest.mark.parametrize(
    ("line", "offers"),
    [
        ("ursnav ma", ["match"]),
        ("ursnav match localization=s", ["localization=shape"]),
        ("ursnav match vid=my", ["vid=my_vid"]),
    ],
)
def test_bash_completes_runners_keys_choices_and_files(line: str, offers: list[str], tmp_path: Path) -> None:
    (tmp_path / "my_vid").mkdir()
    script = completion_script("bash", ["build_vid", "match"])
    words = line.split(" ")
    call = f"{script}\nCOMP_WORDS=({line})\nCOMP_CWORD={len(words) - 1}\n_ursnav 2>/dev/null\necho ${{COMPREPLY[@]}}"
    done = subprocess.run(["bash", "-c", call], capture_output=True, text=True, cwd=tmp_path, check=True)
    assert done.stdout.split() == offers
