"""Plus's sequence files: the sensor's pose a frame, whatever the pictures behind the header are."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ursnav_torch.em_log import EmFormat, read_em_samples
from ursnav_torch.errors import InputError
from ursnav_torch.geometry import transform_from

HEAD = "ObjectType = Image\nNDims = 3\nDimSize = 4 4 3\nElementType = MET_UCHAR\n"
T = [transform_from(Rotation.from_rotvec([0.1 * i, 0.2, 0.3]).as_matrix(), [i, 2.0, 3.0]) for i in range(3)]


def field(frame: int, name: str, value: object) -> str:
    return f"Seq_Frame{frame:04d}_{name} = {value}\n"


def sequence(path: Path, name: str = "ProbeToTracker", more: str = "", status: tuple[str, ...] = ("OK",) * 3) -> Path:
    text = HEAD
    for i, matrix in enumerate(T):
        text += field(i, f"{name}Transform", " ".join(f"{v:.9g}" for v in matrix.ravel()))
        text += field(i, f"{name}TransformStatus", status[i]) + field(i, "Timestamp", 10 + 0.1 * i)
    path.write_bytes((text + more + "ElementDataFile = LOCAL\n").encode() + bytes(range(48)))
    return path


def test_poses_and_times_are_read_and_the_z_axis_is_the_sensors(tmp_path: Path) -> None:
    found = read_em_samples(sequence(tmp_path / "log.mha"))
    np.testing.assert_allclose(found.position_mm, [m[:3, 3] for m in T], atol=1e-6)
    np.testing.assert_allclose(found.axis, [m[:3, 2] for m in T], atol=1e-6)
    assert found.quaternion is not None and found.t_s is not None
    np.testing.assert_allclose(Rotation.from_quat(found.quaternion).as_matrix(), [m[:3, :3] for m in T], atol=1e-6)
    np.testing.assert_allclose(found.t_s, [10.0, 10.1, 10.2])
    later = read_em_samples(tmp_path / "log.mha", EmFormat(offset_s=10.0))
    np.testing.assert_allclose(later.t_s, [0.0, 0.1, 0.2], atol=1e-9)


def test_a_status_that_is_not_ok_and_a_zero_matrix_are_not_visible(tmp_path: Path) -> None:
    zero = field(2, "ProbeToTrackerTransform", " ".join(["0"] * 16))
    path = sequence(tmp_path / "log.mha", more=zero, status=("OK", "MISSING", "OK"))
    assert read_em_samples(path).seen.tolist() == [True, False, False]


def test_of_several_tools_one_is_named(tmp_path: Path) -> None:
    other = "".join(field(i, "StylusToTrackerTransform", " ".join(["0"] * 16)) for i in range(3))
    path = sequence(tmp_path / "log.mha", more=other)
    with pytest.raises(InputError, match=r"ProbeToTracker, StylusToTracker; say which .* em_tool="):
        read_em_samples(path)
    assert read_em_samples(path, EmFormat(tool="ProbeToTracker")).seen.all()
    assert not read_em_samples(path, EmFormat(tool="StylusToTracker")).seen.any()
    with pytest.raises(InputError, match="say which"):
        read_em_samples(path, EmFormat(tool="Scope"))


def test_a_line_of_endless_blanks_is_read_at_once(tmp_path: Path) -> None:
    """Blanks that could be read in two ways would take time with their square or worse: here, for hours."""
    remark = field(0, "Remark", 300_000 * " " + "a" + 300_000 * " " + "b")
    assert read_em_samples(sequence(tmp_path / "log.mha", more=remark)).seen.all()


def test_what_is_no_sequence_is_refused(tmp_path: Path) -> None:
    (tmp_path / "scan.mha").write_bytes(HEAD.encode() + b"ElementDataFile = LOCAL\n" + bytes(48))
    with pytest.raises(InputError, match="no sequence that Plus recorded"):
        read_em_samples(tmp_path / "scan.mha")
    with pytest.raises(InputError, match="cannot be read"):
        read_em_samples(tmp_path / "none.mha")
    broken = sequence(tmp_path / "b.mha", more=field(1, "ProbeToTrackerTransform", "1 2 3"))
    with pytest.raises(InputError, match="no 4 x 4 numbers: '1 2 3'"):
        read_em_samples(broken)
    untimed = sequence(tmp_path / "u.mha", more=field(1, "Timestamp", "soon"))
    with pytest.raises(InputError, match="without a Timestamp"):
        read_em_samples(untimed)
