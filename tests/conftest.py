"""What many tests share: a small phantom kidney, its VID, and a way to call runners in this process."""

import os
import random
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import settings as properties

from ursnav_torch.camera import Camera, equidistant_camera
from ursnav_torch.features import DefaultSettings
from ursnav_torch.kidney import Kidney, LumenDistance, make_phantom_kidney
from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import PlanSettings, Vid, build_vid, load_vid

#: Whatever draws without a seed of its own must not matter: set by who wants other numbers, and other examples.
SEED = os.environ.get("URSNAV_TEST_SEED")
properties.register_profile("untimed", deadline=None, derandomize=SEED is None)  # a busy machine is no counterexample
properties.load_profile("untimed")
torch.set_num_threads(1)  # pictures are small: more threads only wait for each other
if SEED is not None:
    torch.manual_seed(int(SEED))
    random.seed(int(SEED))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests first: the last ones are short, so that both processes of ``make test`` end together."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@dataclass(frozen=True, slots=True)
class Finished:
    """How a runner ended; ``err`` is standard error without progress, which a slow machine has more of."""

    code: int
    out: str
    err: str


Run = Callable[..., Finished]


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real kidneys and pictures."""
    folder = os.environ.get("URSNAV_DATA")
    if not folder:
        pytest.skip("URSNAV_DATA does not name the folder of real kidneys and pictures")
    return Path(folder)


@pytest.fixture(scope="session")
def cases() -> Path:
    """The folder of inputs that people reported elsewhere."""
    folder = os.environ.get("URSNAV_CASES")
    if not folder:
        pytest.skip("URSNAV_CASES does not name the folder of inputs that people reported elsewhere")
    return Path(folder)


@pytest.fixture(scope="session")
def phantom() -> Kidney:
    return make_phantom_kidney(0, calyces=6)


@pytest.fixture(scope="session")
def phantom_lumen(phantom: Kidney) -> LumenDistance:
    return LumenDistance.from_kidney(phantom)


@pytest.fixture(scope="session")
def lens() -> Camera:
    return equidistant_camera(160.0, 96, 96)


@pytest.fixture(scope="session")
def plan() -> PlanSettings:
    return PlanSettings(views_per_calyx=12, passage_views=12)


@pytest.fixture(scope="session")
def vid(phantom: Kidney, lens: Camera, plan: PlanSettings, tmp_path_factory: pytest.TempPathFactory) -> Vid:
    """84 views of the phantom, without calibration; its folder is ``vid.folder``. Not to be changed.

    ``URSNAV_TEST_VID`` names a folder where it is kept from run to run, as `benchmarks.mutants` does.
    """
    kept = os.environ.get("URSNAV_TEST_VID")
    if kept and Path(kept).exists():
        return load_vid(kept)
    out = Path(kept) if kept else tmp_path_factory.mktemp("vid") / "small"
    return build_vid(phantom, lens, DefaultSettings(), RaycastRenderer, plan, out, workers=1)


@pytest.fixture(scope="session")
def renderer(phantom: Kidney, lens: Camera) -> RaycastRenderer:
    return RaycastRenderer(phantom.mesh, lens)


@pytest.fixture(scope="session")
def picture(vid: Vid, renderer: RaycastRenderer) -> np.ndarray:
    """A picture (96, 96) of the first calyx."""
    return renderer.render(vid.T_kidney_camera[3]).image


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    """``run("match", "vid=...", ...)`` calls a runner in an empty working folder, as ``python -m`` would."""
    work = tmp_path / "caller's folder"
    work.mkdir()

    def call(name: str, *overrides: str) -> Finished:
        monkeypatch.chdir(work)
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *overrides])
        monkeypatch.setattr("warnings.formatwarning", lambda *_: "")
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            import_module(f"ursnav_torch.{name}").main()
        streams = capfd.readouterr()
        code = end.value.code
        err = re.sub(r"^[\w ]+: \d+ of \d+\n", "", streams.err, flags=re.MULTILINE)
        return Finished(code if isinstance(code, int) else 0, streams.out, err)

    return call
