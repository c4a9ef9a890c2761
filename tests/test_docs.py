"""What README and documentation show is true: commands compose, examples run, links lead somewhere."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir

from ursnav_torch.__main__ import runners
from ursnav_torch._runner import config_dir, quote_path

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
TEXT = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
COMMAND = re.compile(r"(?:^|`)(?:python -m ursnav_torch\.|ursnav )([a-z_]+(?: [^`\n#]*)?)", re.M)
COMMANDS = sorted({(page, found.strip()) for page, text in TEXT.items() for found in COMMAND.findall(text)})
PATHS = {"kidney.path", "camera.path", "hardware.path", "images", "out", "source", "vid"}


@pytest.mark.parametrize(("page", "command"), COMMANDS)
def test_a_command_that_is_shown_composes(page: str, command: str) -> None:
    name, *overrides = shlex.split(command)
    assert name in runners(), f"{page} names a runner {name} that does not exist"
    given = [quote_path(o, PATHS) for o in overrides if "=" in o and "..." not in o]
    with initialize_config_dir(config_dir(), version_base="1.3"):
        compose(name, given)


def test_commands_are_found_at_all() -> None:
    assert len(COMMANDS) > 15 and {page for page, _ in COMMANDS} >= {"README.md", "tutorial_mesh.md"}


@pytest.mark.parametrize(
    "page", [page for page, text in TEXT.items() if page.startswith("tutorial") and "```python" in text]
)
def test_a_tutorials_python_runs(page: str) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```$", TEXT[page], re.M | re.S)
    exec(compile("\n".join(blocks), page, "exec"), {})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_pictures_are_there(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", TEXT[page.name]):
        assert target.startswith("https://") or (page.parent / target).exists(), f"{page.name} links to {target}"


def test_the_questions_are_what_the_program_says() -> None:
    """Every message of the FAQ stands in the code, but for what its dots stand for."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in sorted((ROOT / "ursnav_torch").rglob("*.py")))
    code = re.sub(r'"\s*\n\s*[rf]*"', "", text)
    cells = [row.split("|")[1] for row in TEXT["errors.md"].splitlines() if row.startswith("| `")]
    messages = [part for cell in cells for part in re.findall(r"`([^`]*)`", cell) if " " in part]
    pieces = [piece.strip() for message in messages for piece in message.split("…") if len(piece.strip()) > 8]
    assert len(pieces) > 30
    unsaid = [piece for piece in pieces if piece not in code]
    assert not unsaid, f"nothing says this any more: {unsaid}"


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs")
    pytest.importorskip("mkdocstrings")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")],
        cwd=ROOT, capture_output=True, text=True, env={"NO_MKDOCS_2_WARNING": "1", "PATH": "", "HOME": str(tmp_path)},
    )  # fmt: skip
    assert (built.returncode, built.stderr) == (0, ""), built.stdout + built.stderr
    index = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    assert "Which calyx this is".lower() in index.lower()
    assert "Localizer" in (tmp_path / "site" / "reference.html").read_text(encoding="utf-8")
    assert not re.search(r"<(?:script|link|img)[^>]+(?:src|href)=\"https?:", index), "nothing is fetched from elsewhere"
