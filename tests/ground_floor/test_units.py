"""Lengths in another unit than their column says are asked about, wherever coordinates are read."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.errors import InputError, RegistrationError, naming
from ursnav_torch.kidney import Kidney, read_calyces
from ursnav_torch.kidney.tables import check_given
from ursnav_torch.registration import read_landmarks
from ursnav_torch.registration.readings import check_em_unit
from ursnav_torch.runs.track_files import read_truth
from ursnav_torch.stones import read_known_stones
from ursnav_torch.units import LENGTH_MM, check_in_box

#: Of a kidney in a scan's own coordinates, and of one around the origin, mm.
BOXES = {
    "in a scan": np.array([[-87.0, 219.0, -117.0], [-53.0, 274.0, -77.0]]),
    "around 0": np.array([[-20.0] * 3, [30.0] * 3]),
}
OTHER = [unit for unit in LENGTH_MM if unit != "mm"]
POINTS = np.array([[0.1, 0.2, 0.1], [0.9, 0.5, 0.3], [0.4, 0.8, 0.9], [0.7, 0.1, 0.6]])


def table(path: Path, head: str, names: list[str], *columns: np.ndarray) -> Path:
    rows = [
        ",".join([*filter(None, [name]), *map(repr, map(float, row))])
        for name, row in zip(names, np.column_stack(columns), strict=True)
    ]
    path.write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize("unit", OTHER)
@pytest.mark.parametrize("where", BOXES)
def test_points_that_fit_a_kidney_in_another_unit_alone_are_asked_about(where: str, unit: str) -> None:
    box = BOXES[where]
    points = box[0] + POINTS * (box[1] - box[0])
    check_in_box(points, box, "P", "p_unit")
    with pytest.raises(
        InputError,
        match=rf"P (lie outside|are spread).* and fit .*\b{unit}\b.*x_{unit}, .* p_unit=; if they are right, p_unit=mm",
    ):
        check_in_box(points / LENGTH_MM[unit], box, "P", "p_unit")


def test_places_close_to_one_another_are_right_where_nothing_else_fits() -> None:
    box = BOXES["in a scan"]
    check_in_box(box.mean(axis=0) + POINTS, box, "P", "p_unit")
    check_in_box(box[:1] + 5, box, "P", "p_unit")
    check_in_box(box + 400, box, "P", "p_unit")  # of another frame: whoever reads them says so


@pytest.mark.parametrize("unit", LENGTH_MM)
def test_columns_say_their_unit_in_every_table(tmp_path: Path, unit: str) -> None:
    box, mm = BOXES["in a scan"], LENGTH_MM[unit]
    points, names = box[0] + POINTS * (box[1] - box[0]), ["A", "B", "C", "D"]
    xyz = f"x_{unit},y_{unit},z_{unit}"
    calyces, _ = read_calyces(table(tmp_path / "c.csv", f"calyx,{xyz}", names, points / mm))
    np.testing.assert_allclose([c.tip_mm for c in calyces], points)
    stones = read_known_stones(
        table(tmp_path / "s.csv", f"stone,{xyz},size_{unit}", names, points / mm, np.full(4, 6.0) / mm)
    )
    np.testing.assert_allclose([s.center_mm for s in stones], points)
    assert stones[0].size_mm == pytest.approx(6.0)
    head = ",".join(f"{side}_{c}_{unit}" for side in ("kidney", "em") for c in "xyz")
    pairs = read_landmarks(table(tmp_path / "l.csv", head, [""] * 4, points / mm, (points + 7) / mm))
    np.testing.assert_allclose(pairs.em_mm - pairs.kidney_mm, 7)


@pytest.mark.parametrize("unit", OTHER)
def test_tables_whose_columns_lie_are_asked_about_and_may_be_told(tmp_path: Path, unit: str) -> None:
    box, mm = BOXES["around 0"], LENGTH_MM[unit]
    points, names = box[0] + POINTS * (box[1] - box[0]), ["A", "B", "C", "D"]
    path = table(tmp_path / "c.csv", "calyx,x_mm,y_mm,z_mm", names, points / mm)
    with pytest.raises(InputError, match=rf"4 calyces of .*c\.csv .*\bin .*x_{unit}, .*kidney\.calyces_unit="):
        check_given(read_calyces(path)[0], box, str(path))
    np.testing.assert_allclose([c.tip_mm for c in read_calyces(path, unit)[0]], points)
    path = table(tmp_path / "s.csv", "stone,x_mm,y_mm,z_mm,size_mm", names, points / mm, np.full(4, 6.0))
    with pytest.raises(InputError, match=rf"4 stones of .*s\.csv .*\bx_{unit}, .*known_stones_unit="):
        read_known_stones(path, box_mm=box)
    path = table(tmp_path / "t.csv", "stone,x_mm,y_mm,z_mm,size_mm", names, points, np.full(4, 6.0) / mm)
    with pytest.raises(InputError, match=r"line 2: stone 'A' of .* mm; .*known_stones_unit="):
        read_known_stones(path)
    head = ",".join(f"{side}_{c}_mm" for side in ("kidney", "em") for c in "xyz")
    path = table(tmp_path / "l.csv", head, [""] * 4, points / mm, points / mm)
    with pytest.raises(InputError, match=r"kidney points of .*l\.csv are spread over .*another unit .*landmarks_unit="):
        read_landmarks(path)
    np.testing.assert_allclose(read_landmarks(path, unit).em_mm, points)


@pytest.mark.parametrize("read", [read_calyces, read_known_stones, read_landmarks])
def test_units_that_are_none_are_refused(tmp_path: Path, read: Callable[..., object]) -> None:
    head = "calyx,stone,x_mm,y_mm,z_mm,size_mm," + ",".join(f"{s}_{c}_mm" for s in ("kidney", "em") for c in "xyz")
    path = table(tmp_path / "a.csv", head, ["A,1"], np.ones((1, 10)))
    with pytest.raises(InputError, match=r"_unit is 'furlong'; accepted are mm, cm, m, in, and null"):
        read(path, "furlong")


@pytest.mark.parametrize("unit", OTHER)
def test_readings_that_belong_to_the_pictures_in_another_unit_are_asked_about(unit: str) -> None:
    em = 100 + 40 * POINTS

    def away(positions: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.norm(positions - em, axis=1))

    check_em_unit(em + 5, away, "em.csv")
    with pytest.raises(
        InputError,
        match=rf"4 positions of em\.csv are \d+ mm from where .* near if they are in .*{unit}.*say em_unit=",
    ):
        check_em_unit(em / LENGTH_MM[unit], away, "em.csv")


def test_true_poses_in_centimeters_are_told(tmp_path: Path) -> None:
    box = BOXES["in a scan"]
    head, turns = "x_mm,y_mm,z_mm,qx,qy,qz,qw", np.tile([0.0, 0, 0, 1], (4, 1))
    path = table(tmp_path / "t.csv", head, [""] * 4, (box[0] + POINTS * (box[1] - box[0])) / 10, turns)
    with pytest.raises(InputError, match=r"4 poses of .*t\.csv lie outside .*in cm: write them in mm"):
        read_truth(path, box)


def test_a_refusal_of_points_names_their_file() -> None:
    with pytest.raises(RegistrationError, match=r"^l\.csv: Landmarks are collinear"), naming("l.csv"):
        raise RegistrationError("Landmarks are collinear")
    with pytest.raises(InputError, match=r"^The file l\.csv"), naming("l.csv"):
        raise InputError("The file l.csv")


def test_a_phantoms_own_calyces_are_in_its_box(phantom: Kidney) -> None:
    check_given(phantom.calyces, phantom.mesh.bounds, "phantom")
