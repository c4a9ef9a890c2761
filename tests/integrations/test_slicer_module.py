"""The Slicer module without Slicer: its network half against real senders, the other against a stand-in."""

import ast
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from ursnav_torch.devices import Frame, SlicerOutput, Stamp
from ursnav_torch.geometry import T_RAS_LPS, transform_from_quaternion

MODULE = Path(__file__).parents[2] / "integrations" / "slicer" / "UrsnavLive"
T = transform_from_quaternion([1.5, -20.0, 300.0], [0.1, -0.2, 0.3, 0.9])
PICTURE = np.random.default_rng(0).integers(0, 255, (31, 40, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def lib() -> Iterator[ModuleType]:
    sys.path.insert(0, str(MODULE))
    try:
        import UrsnavLiveLib

        yield UrsnavLiveLib
    finally:
        sys.path.remove(str(MODULE))


def gathered(receiver: Any, wanted: set[str], seconds: float = 20.0) -> dict[str, Any]:
    """What was received of each device, until all were heard."""
    found: dict[str, Any] = {}
    end = time.monotonic() + seconds
    while not wanted <= found.keys() and time.monotonic() < end:
        found |= {message.device: message for message in receiver.poll()}
        time.sleep(0.01)
    assert wanted <= found.keys(), f"heard {set(found)}, {receiver.problem}"
    return found


def test_what_navigate_sends_arrives_as_it_was(lib: ModuleType) -> None:
    with SlicerOutput(port=0) as output:
        receiver = lib.Receiver(port=output.port)
        assert not receiver.is_connected and receiver.poll() == []
        output.publish_coverage({"A": ("inspected", 0.93), "Ä": ("unseen", 0.0)}, 1.0)  # told to who comes later
        receiver.connect()
        gathered(receiver, {"Coverage"})
        assert receiver.is_old
        output.publish_pose(T, 2.0)
        output.publish_image(Frame(Stamp(0, 1.0, 2.0), PICTURE))
        found = gathered(receiver, {"CameraToKidney", "ScopePicture"})
        assert not receiver.is_old and receiver.problem == ""
    np.testing.assert_allclose(found["CameraToKidney"].matrix, T_RAS_LPS @ T, atol=1e-4)
    picture = found["ScopePicture"]
    np.testing.assert_array_equal(picture.pixels, PICTURE[..., ::-1])
    np.testing.assert_allclose(picture.ijk_to_ras @ [19.5, 15, 0, 1], [0, 0, 10, 1], atol=1e-5)
    assert receiver.coverage == {"A": ("inspected", 0.93), "Ä": ("unseen", 0.0)}
    while receiver.is_connected:
        receiver.poll()
    assert receiver.problem == "the sender has left"
    receiver.close()


def test_of_many_poses_between_two_looks_the_newest_counts(lib: ModuleType) -> None:
    with SlicerOutput(port=0) as output:
        receiver = lib.Receiver(port=output.port)
        receiver.connect()
        output.publish_coverage({}, 1.0)
        gathered(receiver, {"Coverage"})
        for x in range(50):
            output.publish_pose(transform_from_quaternion([x, 0, 0], [0, 0, 0, 1]), 1.0)
        output.publish_coverage({"A": ("unseen", 0.0)}, 1.0)
        found = gathered(receiver, {"Coverage", "CameraToKidney"})
        while found["CameraToKidney"].matrix[0, 3] != -49:
            found |= gathered(receiver, {"CameraToKidney"})
        receiver.close()


def test_messages_of_pyigtl_with_their_longer_header_are_understood(lib: ModuleType) -> None:
    pyigtl = pytest.importorskip("pyigtl")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        receiver = lib.Receiver(port=listener.getsockname()[1])
        receiver.connect()
        client, _ = listener.accept()
        gray = PICTURE[..., 0].copy()
        matrix = np.diag([2.0, 3.0, 1.0, 1.0])
        with client:
            client.sendall(pyigtl.TransformMessage(T, device_name="Tip").pack())
            client.sendall(pyigtl.ImageMessage(gray[None], matrix, "lps", device_name="Picture").pack())
            client.sendall(pyigtl.StringMessage("hello", device_name="Words").pack())
            stones = {"positions": [[1, 2, 3], [9, 2, 3]], "names": ["1", "2"], "diameters": [4.5, 6.0]}
            client.sendall(pyigtl.PointMessage(**stones, device_name="Stones").pack())
            found = gathered(receiver, {"Tip", "Picture", "Words", "Stones"})
        np.testing.assert_allclose(found["Tip"].matrix, T, atol=1e-4)
        np.testing.assert_array_equal(found["Picture"].pixels, gray)
        np.testing.assert_allclose(found["Picture"].ijk_to_ras, T_RAS_LPS @ matrix, atol=1e-4)
        assert found["Words"].text == "hello"
        assert found["Stones"].names == ("1", "2") and found["Stones"].diameter.tolist() == [4.5, 6.0]
        np.testing.assert_allclose(found["Stones"].at, stones["positions"])
        receiver.close()


@pytest.mark.parametrize(
    ("kind", "body"),
    [("TRANSFORM", b"short"), ("IMAGE", bytes(10)), ("IMAGE", bytes(72)), ("POINT", bytes(100)), ("STRING", b"\0")],
)
def test_broken_messages_are_said(lib: ModuleType, kind: str, body: bytes) -> None:
    with pytest.raises(ValueError):
        lib.decode(kind, "x", 1, body)


def test_a_tool_that_is_not_seen_has_no_pose_and_unknown_kinds_are_passed_over(lib: ModuleType) -> None:
    assert lib.decode("TRANSFORM", "x", 1, bytes(48)).matrix is None
    assert lib.decode("STATUS", "x", 1, b"") is None


def test_another_program_at_the_port_is_said_and_the_window_lives_on(lib: ModuleType) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        receiver = lib.Receiver(port=listener.getsockname()[1])
        receiver.connect()
        client, _ = listener.accept()
        with client:
            client.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n" + b"x" * 100)
            while receiver.is_connected:
                receiver.poll()
    assert "is the port right?" in receiver.problem


def test_nobody_there_is_an_os_error(lib: ModuleType) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(OSError):
        lib.Receiver(port=port).connect()


def test_a_pose_grows_old(lib: ModuleType) -> None:
    now = [0.0]
    receiver = lib.Receiver(clock=lambda: now[0])
    receiver._note(lib.Pose("CameraToKidney", np.eye(4)))
    assert not receiver.is_old
    now[0] = 2.1
    assert receiver.is_old


def test_stones_of_a_table_are_turned_to_ras(lib: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "stones.csv").write_text("stone,calyx,x_mm,y_mm,z_mm,size_mm\n1,A,1,2,3,4.5\n")
    names, at = lib.read_stones(tmp_path / "stones.csv", "lps")
    assert names == ("1 (4.5 mm)",)
    np.testing.assert_allclose(at, [[-1, -2, 3]])
    with pytest.raises(ValueError, match="'xyz'"):
        lib.read_stones(tmp_path / "stones.csv", "xyz")
    (tmp_path / "stones.csv").write_text("stone,x_mm\n1,2\n")
    with pytest.raises(ValueError, match="no table of stones"):
        lib.read_stones(tmp_path / "stones.csv", "lps")


def test_a_folder_of_something_else_is_said(lib: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds nothing of what"):
        lib.find_exports(tmp_path)


def test_every_file_is_python_that_slicer_understands_and_is_installed() -> None:
    cmake = (MODULE / "CMakeLists.txt").read_text(encoding="utf-8")
    for path in MODULE.rglob("*.py"):
        ast.parse(path.read_text(encoding="utf-8"), feature_version=(3, 9))
        name = path.relative_to(MODULE).as_posix().replace("UrsnavLive", "${MODULE_NAME}")
        assert name in cmake, f"{name} is not in CMakeLists.txt"
    assert (MODULE / "Resources/Icons/UrsnavLive.png").read_bytes()[:4] == b"\x89PNG"


@pytest.fixture
def module(lib: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Any:
    """UrsnavLive.py, imported where Slicer's modules only note what they are asked for."""
    scripted = ModuleType("slicer.ScriptedLoadableModule")
    for name in ("", "Widget", "Logic", "Test"):
        setattr(scripted, f"ScriptedLoadableModule{name}", type(f"Base{name}", (), {}))
    slicer = MagicMock()
    slicer.util.vtkMatrixFromArray = lambda array: np.array(array)
    nodes: dict[str, Any] = {}
    slicer.mrmlScene.GetFirstNodeByName = nodes.get
    slicer.mrmlScene.AddNewNodeByClass = lambda kind, name: nodes.setdefault(name, MagicMock(kind=kind))
    fakes = {"slicer": slicer, "slicer.ScriptedLoadableModule": scripted, "qt": MagicMock(), "vtk": MagicMock()}
    for name, fake in fakes.items():
        monkeypatch.setitem(sys.modules, name, fake)
    monkeypatch.delitem(sys.modules, "UrsnavLive", raising=False)
    import UrsnavLive  # type: ignore[import-not-found]

    yield UrsnavLive, slicer, nodes
    sys.modules.pop("UrsnavLive", None)


def test_the_scene_gets_pose_picture_and_colors(module: Any) -> None:
    live, slicer, nodes = module
    logic = live.UrsnavLiveLogic()
    assert logic.words() == "not connected"
    nodes["calyx A"] = MagicMock()
    with SlicerOutput(port=0) as output:
        logic.connect("127.0.0.1", output.port)
        output.publish_coverage({"A": ("glimpsed", 0.3)}, 1.0)
        output.publish_pose(T, 2.0)
        end = time.monotonic() + 20
        while not {"CameraToKidney", "ScopePicture"} <= nodes.keys() and time.monotonic() < end:
            output.publish_pose(T, 2.0)
            output.publish_image(Frame(Stamp(0, 1.0, 2.0), PICTURE))
            logic.update()
            time.sleep(0.01)
        assert logic.words() == "connected"
        logic.receiver.close()
    (matrix,) = nodes["CameraToKidney"].SetMatrixTransformToParent.call_args.args
    np.testing.assert_allclose(matrix, T_RAS_LPS @ T, atol=1e-4)
    assert nodes["CameraToKidney"].kind == "vtkMRMLLinearTransformNode"
    assert nodes["ScopePicture"].kind == "vtkMRMLVectorVolumeNode"
    _, pixels = slicer.util.updateVolumeFromArray.call_args.args
    assert pixels.shape == (1, 31, 40, 3)
    nodes["calyx A"].GetDisplayNode().SetSelectedColor.assert_called_with(0.9, 0.8, 0.2)


def test_an_export_is_loaded_file_by_file(module: Any, tmp_path: Path) -> None:
    live, slicer, nodes = module
    for name in ("kidney.stl", "calyces.mrk.json", "path.mrk.json", "em_to_kidney.tfm"):
        (tmp_path / name).write_text("")
    (tmp_path / "stones.csv").write_text("stone,calyx,x_mm,y_mm,z_mm,size_mm\n1,A,1,2,3,4.5\n")
    points = slicer.util.loadMarkups.return_value
    points.GetNumberOfControlPoints.return_value = 2
    points.GetNthControlPointLabel.side_effect = ["pelvis", "A"]
    slicer.util.arrayFromMarkupsControlPoints.return_value = np.zeros((2, 3))
    live.UrsnavLiveLogic().load(tmp_path)
    slicer.util.loadModel.assert_called_once_with(str(tmp_path / "kidney.stl"))
    slicer.util.loadTransform.assert_called_once_with(str(tmp_path / "em_to_kidney.tfm"))
    assert slicer.util.loadMarkups.call_count == 2
    assert nodes.keys() == {"calyx A", "Stones"}
