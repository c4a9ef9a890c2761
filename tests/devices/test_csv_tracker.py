"""EM samples from a file."""

import pytest
from clocks import Clock, runs_on

from ursnav_torch.devices import CsvTracker, SourceAtEndError
from ursnav_torch.errors import InputError

HEAD = "frame,t_s,x_mm,y_mm,z_mm,dx,dy,dz\n"


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "em.csv"
    path.write_text(HEAD + "0,10.0,1,2,3,0,0,2\n1,10.1,,,,,,\n2,10.2,4,5,6,1,0,0\n")
    return path


def test_samples_come_in_order_with_unit_axes_and_gaps(path):
    with CsvTracker(path, speed=0) as tracker:
        first, gap, last = (tracker.read() for _ in range(3))
        with pytest.raises(SourceAtEndError, match="after 3 samples"):
            tracker.read()
    assert (first.position_mm, first.axis, first.dof) == ((1, 2, 3), (0, 0, 1), 5)
    assert (gap.visible, gap.position_mm) == (False, None)
    assert last.position_mm == (4, 5, 6)


def test_samples_come_at_their_own_pace(path, monkeypatch):
    clock = Clock()
    runs_on(clock, "ursnav_torch.devices.trackers.csv_file", monkeypatch)
    with CsvTracker(path, speed=2) as tracker:
        for _ in range(3):
            tracker.read()
    assert sum(clock.slept) == pytest.approx(0.1)  # 0.2 s of samples at twice their speed


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0,1.0,1,2,3,0,0,0\n", "axis dx,dy,dz is missing or zero"),
        ("0,1.0,1,x,3,0,0,1\n", "y_mm is 'x'"),
        ("0,1.0,1,2,3,0,0,1\n1,0.5,1,2,3,0,0,1\n", "runs backwards"),
        (
            f"0,1.0,1,2,3,0,0,1\n{''.join(f'{i},2.0,{i},2,3,0,0,1' + chr(10) for i in range(20))}",
            "stands still at 2.000",
        ),
    ],
)
def test_files_that_cannot_be_used_are_refused(tmp_path, rows, message):
    path = tmp_path / "em.csv"
    path.write_text(HEAD + rows)
    with pytest.raises(InputError, match=message):
        CsvTracker(path)
