"""The package as users get it: a wheel in an environment of its own, called from another folder."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def ran(*command: str | Path, cwd: Path, timeout: float = 900) -> subprocess.CompletedProcess[str]:
    """Run a command that must end well; the checkout is not on its path."""
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        list(command), cwd=cwd, capture_output=True, encoding="utf-8", env=environment, timeout=timeout
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("build", reason="needs the extra [dev]")
    out = tmp_path_factory.mktemp("wheel")
    ran(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", out, ROOT, cwd=out)
    (found,) = out.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An interpreter that has the wheel, and everything else from this environment; not this checkout."""
    folder = tmp_path_factory.mktemp("clean") / "venv"
    ran(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder.parent)
    (site,) = folder.glob("lib/python*/site-packages")
    ran(sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--target", site, wheel, cwd=folder)
    others = [p for p in sys.path if p.endswith("site-packages")]
    (site / "others.pth").write_text("\n".join(others), encoding="utf-8")
    return folder / "bin" / "python"


def test_the_wheel_holds_code_and_configurations_and_no_more(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    for path in [*ROOT.glob("ursnav_torch/**/*.py"), *ROOT.glob("configs/**/*.yaml")]:
        inside = path.relative_to(ROOT).as_posix()
        assert (inside if inside.startswith("ursnav") else f"ursnav_torch/{inside}") in names
    for path in ROOT.glob("ursnav_torch/*/templates/*"):
        assert path.relative_to(ROOT).as_posix() in names, "pages need their templates"
    assert "ursnav_torch/py.typed" in names
    assert {name.split("/")[0].split("-")[0] for name in names} == {"ursnav_torch"}
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_runners_answer_from_another_folder(python: Path, tmp_path: Path) -> None:
    where = ran(python, "-c", "import ursnav_torch; print(ursnav_torch.__file__)", cwd=tmp_path).stdout
    assert str(python.parents[2]) in where, "the wheel, not the checkout"
    assert "build_vid" in ran(python, "-m", "ursnav_torch", cwd=tmp_path).stdout
    assert "images:" in ran(python, "-m", "ursnav_torch.match", "--help", cwd=tmp_path).stdout
    ursnav = "from ursnav_torch.__main__ import main; main()"
    assert "images:" in ran(python, "-c", ursnav, "match", "--help", cwd=tmp_path).stdout
    page = "from ursnav_torch.reports.html import render_page as r; print(r('base.html.j2', title='T'))"
    assert "color-scheme" in ran(python, "-c", page, cwd=tmp_path).stdout
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_demo_runs_from_another_folder(python: Path, tmp_path: Path) -> None:
    small = ("kidney.calyces=6", "camera.width=96", "camera.height=96", "views.views_per_calyx=20",
             "views.passage_views=20", "pictures_per_calyx=1", "queries_per_calyx=2", "workers=1")  # fmt: skip
    done = ran(python, "-m", "ursnav_torch.demo", "out=my demo", *small, cwd=tmp_path)
    assert (tmp_path / "my demo" / "report" / "index.html").exists() and "right calyx" in done.stdout
    assert sorted(p.name for p in tmp_path.iterdir()) == ["my demo", "my demo_vid"]
