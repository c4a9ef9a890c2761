"""Every command that README and documentation show is run as it stands, on small files of the names that it gives."""

import json
import re
import shlex
import shutil
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import cv2
import numpy as np
import pytest
from test_docs import COMMANDS, ROOT

from ursnav_torch.rendering import RaycastRenderer
from ursnav_torch.vid import Vid

pytestmark = pytest.mark.slow

#: Runners in the order in which they make what others need, each with what makes it small, and where its result goes.
#: What stands there last counts.
SMALL = {
    "build_vid": "camera.width=96 camera.height=96 views.views_per_calyx=3 views.passage_views=3 calibrate=false "
    "compute.workers=1 out=built",
    "match": "",
    "register": "",
    "validate": "",
    "track": "",
    "navigate": "viewer=none",
    "compare": "",
    "explore": "seconds=0.3 port=0",
    "teleop": "duration_s=1 camera.width=64 camera.height=64 hardware.twin.sensor=null",
    "export": "",
    "print_phantom": "",
}
#: Commands, or their beginnings, that need more than small files; and the tests that run them.
ELSEWHERE = {
    "build_vid ... compute=dask": "tests/vid/test_compute.py",
    "build_vid kidney=ct": "tests/runners/test_segment.py",
    "segment": "tests/runners/test_segment.py",
    "calibrate": "tests/calibration/test_calibration.py",
    "experiment": "tests/runners/test_experiment.py",
    "export to=dicom": "tests/runners/test_export.py",
    "demo": "tests/runners/test_wheel.py",
}
#: A runner named without all that it needs stands for itself in a sentence: there is nothing to run.
WHOLE = [(page, c) for page, c in COMMANDS if not re.fullmatch(r"\w+(?: report=pages)?", c)]
#: Where the EM frame's origin is.
MOVED_MM = np.array([5.0, 6.0, 7.0])
#: What README calls by a word of its own.
NAMED = {"landmarks=FILE": "landmarks=landmarks.csv", "em=FILE": "em=em.csv", "second=another": "second=my_session"}


@pytest.fixture(scope="module")
def lab(vid: Vid, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the commands name."""
    folder = tmp_path_factory.mktemp("lab")
    shutil.copytree(vid.folder, folder / "my_vid")
    vid.kidney.mesh.export(folder / "lumen.stl")
    (folder / "camera.json").write_text(json.dumps(vid.camera.to_dict()), encoding="utf-8")
    (folder / "pictures").mkdir()
    views = [3, 15, 27]
    renderer = RaycastRenderer(vid.kidney.mesh, vid.camera)
    images = [np.atleast_3d(renderer.render(vid.T_kidney_camera[v]).image) for v in views]
    for i, image in enumerate(images):
        cv2.imwrite(str(folder / "pictures" / f"{i}.png"), image)
    video = cv2.VideoWriter(str(folder / "video.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 10, (96, 96))
    for image in 4 * images:
        video.write(np.repeat(image[..., :1], 3, axis=2))
    video.release()
    places = vid.kidney.tips_mm[:5]
    rows = [",".join(f"{v:.3f}" for v in (*p, *(p + MOVED_MM))) for p in places]
    head = "kidney_x_mm,kidney_y_mm,kidney_z_mm,em_x_mm,em_y_mm,em_z_mm"
    (folder / "landmarks.csv").write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    poses = [
        (i, *(vid.T_kidney_camera[v][:3, 3] + MOVED_MM), *vid.T_kidney_camera[v][:3, 2]) for i, v in enumerate(views)
    ]
    rows = [f"{i}.png," + ",".join(f"{value:.4f}" for value in rest) for i, *rest in poses]
    (folder / "em.csv").write_text("\n".join(["image,x_mm,y_mm,z_mm,dx,dy,dz", *rows, ""]), encoding="utf-8")
    return folder


Call = Callable[[str], str]


@pytest.fixture(scope="module")
def call(lab: Path) -> Call:
    """Run a command in the lab; what it printed, once it ended well."""

    def run(command: str, more: str = "") -> None:
        name, *overrides = shlex.split(command)
        given = [NAMED.get(o, o) for o in overrides]
        keys = {o.split("=")[0] for o in shlex.split(more)}
        wanted = [o for o in given if o.split("=")[0] not in keys] + shlex.split(more)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(lab)
            patch.setattr(sys, "argv", [f"{name}.py", *wanted, "overwrite=true"])
            patch.setattr("warnings.formatwarning", lambda *_: "")
            with pytest.raises(SystemExit) as end:
                import_module(f"ursnav_torch.{name}").main()
        assert not end.value.code, f"{command} ended with {end.value.code}"

    return run  # type: ignore[return-value]


def elsewhere(command: str) -> str | None:
    return next((where for start, where in ELSEWHERE.items() if command.startswith(start)), None)


def test_commands_run_as_they_stand(lab: Path, call: Call) -> None:
    here = {c for _, c in WHOLE if elsewhere(c) is None}
    assert len(here) > 12
    order = list(SMALL)
    made = sorted(here, key=lambda c: (order.index(c.split()[0]), "replay" in c, c))
    for command in made:
        name = command.split()[0]
        more = SMALL[name]
        if "camera=file" in command:  # which has no size of its own to be made smaller
            more = more.replace("camera.width=96 camera.height=96 ", "")
        if name == "navigate":
            replay = "hardware=replay" in command
            more += " hardware.speed=0" if replay else " seconds=1.5 hardware.camera.rate_hz=4"
        call(command, more)
    results = {"matches.csv", "pages", "em.json", "verdict.json", "track.csv", "my_session", "for_slicer", "track.tum"}
    assert results <= {path.name for path in lab.iterdir()}


@pytest.mark.parametrize("start", ELSEWHERE)
def test_commands_that_need_more_are_run_by_a_test_of_their_own(start: str) -> None:
    assert any(command.startswith(start) for _, command in COMMANDS), f"nobody shows {start} any more"
    runner, text = start.split()[0], (ROOT / ELSEWHERE[start]).read_text(encoding="utf-8")
    assert re.search(rf"\b{runner}\b|DaskCompute", text), f"{ELSEWHERE[start]} does not run {runner}"
