"""Geometry is never invented: what a header does not say is refused by name, or given by name."""

import gzip
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.segmentation import Scan, ScanHeader, read_scan, write_scan

pytest.importorskip("SimpleITK", reason="the extra ct is not installed")


@pytest.fixture
def scan() -> Scan:
    voxels = np.random.default_rng(0).integers(0, 3, (12, 10, 8)).astype(np.uint8)
    T = np.diag([0.7, 0.8, 1.5, 1.0])
    T[:3, 3] = [-10, 5, 100]
    return Scan(voxels, T, "")


def nrrd(path: Path, scan: Scan, *fields: str) -> Path:
    """An NRRD with just these fields besides type, sizes and encoding."""
    sizes = " ".join(map(str, scan.voxels.shape))
    head = ["NRRD0005", "type: uint8", "dimension: 3", f"sizes: {sizes}", "encoding: raw", *fields]
    path.write_bytes("\n".join([*head, "", ""]).encode() + scan.voxels.transpose(2, 1, 0).tobytes())
    return path


def meta(path: Path, scan: Scan, *fields: str) -> Path:
    head = ["NDims = 3", f"DimSize = {' '.join(map(str, scan.voxels.shape))}", "ElementType = MET_UCHAR", *fields]
    data = scan.voxels.transpose(2, 1, 0).tobytes()
    path.write_bytes("\n".join([*head, "ElementDataFile = LOCAL", ""]).encode() + data)
    return path


def nifti(path: Path, scan: Scan, changes: dict[int, tuple[str, tuple[float, ...]]]) -> Path:
    """A NIfTI whose header fields, by their places, are changed."""
    write_scan(scan, path)
    data = bytearray(path.read_bytes())
    for at, (form, values) in changes.items():
        struct.pack_into("<" + form, data, at, *values)
    path.write_bytes(bytes(data))
    return path


DIRECTIONS = "space directions: (0.7,0,0) (0,0.8,0) (0,0,1.5)"
ORIGIN = "space origin: (-10,5,100)"
HEAD = ("space: left-posterior-superior", DIRECTIONS, ORIGIN)
PIXDIM, UNITS, CODES, SROW, SLOPE = 76, 123, 252, 280, 112


def test_no_spacing_is_refused_and_may_be_given(scan: Scan, tmp_path: Path) -> None:
    files = [
        nrrd(tmp_path / "a.nrrd", scan),
        nrrd(tmp_path / "b.nrrd", scan, "spacings: NaN NaN NaN"),
        nrrd(tmp_path / "c.nrrd", scan, "space: left-posterior-superior"),
        meta(tmp_path / "d.mha", scan),
        meta(tmp_path / "e.mha", scan, "TransformMatrix = 1 0 0 0 1 0 0 0 1", "Offset = 0 0 0"),
        nifti(tmp_path / "f.nii", scan, {PIXDIM + 4: ("3f", (0, 0, 0))}),
        nifti(tmp_path / "g.nii", scan, {PIXDIM + 12: ("f", (float("nan"),))}),
    ]
    for path in files:
        with pytest.raises(InputError, match=rf"{path.name} does not say how far.*kidney\.header\.spacing_mm="):
            read_scan(path)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*tells two places")
            given = read_scan(path, header=ScanHeader([0.7, 0.8, 1.5], "lps"))
        np.testing.assert_allclose(given.spacing_mm, [0.7, 0.8, 1.5])
        np.testing.assert_array_equal(given.voxels, scan.voxels)


def test_no_orientation_is_refused_and_may_be_given(scan: Scan, tmp_path: Path) -> None:
    files = [
        nrrd(tmp_path / "a.nrrd", scan, "spacings: 0.7 0.8 1.5"),
        nrrd(tmp_path / "b.nrrd", scan, "space dimension: 3", DIRECTIONS, ORIGIN),
        nrrd(tmp_path / "c.nrrd", scan, "space: 3D-right-handed", DIRECTIONS, ORIGIN),
        meta(tmp_path / "d.mha", scan, "ElementSpacing = 0.7 0.8 1.5"),
        nifti(tmp_path / "e.nii", scan, {CODES: ("2h", (0, 0))}),
    ]
    for path in files:
        with pytest.raises(InputError, match=rf"{path.name} does not say how it lies.*kidney\.header\.orientation="):
            read_scan(path)
        given = read_scan(path, header=ScanHeader(orientation="RAS"))
        np.testing.assert_allclose(given.T_lps_voxel[:3, :3], np.diag([-0.7, -0.8, 1.5]), atol=1e-6)


@pytest.mark.parametrize(("word", "mm"), [("cm", 10.0), ("m", 1000.0), ("mm", 1.0), ("um", 1e-3)])
def test_a_stated_unit_is_taken(scan: Scan, tmp_path: Path, word: str, mm: float) -> None:
    d = np.array([0.7, 0.8, 1.5]) / mm
    path = nrrd(
        tmp_path / "a.nrrd", scan, "space: left-posterior-superior", f'space units: "{word}" "{word}" "{word}"',
        f"space directions: ({d[0]:.9g},0,0) (0,{d[1]:.9g},0) (0,0,{d[2]:.9g})",
        f"space origin: ({-10 / mm:.9g},{5 / mm:.9g},{100 / mm:.9g})",
    )  # fmt: skip
    np.testing.assert_allclose(read_scan(path).T_lps_voxel, scan.T_lps_voxel, rtol=1e-6)


@pytest.mark.parametrize(("code", "mm"), [(1, 1000.0), (2, 1.0), (3, 1e-3)])
def test_niftis_units_are_taken(scan: Scan, tmp_path: Path, code: int, mm: float) -> None:
    d, at = np.array([0.7, 0.8, 1.5]) / mm, np.array([10, -5, 100]) / mm
    srow = np.column_stack([np.diag(d * [-1, -1, 1]), at])
    changes = {PIXDIM + 4: ("3f", tuple(d)), UNITS: ("B", (code,)), CODES: ("2h", (0, 1)), SROW: ("12f", srow.ravel())}
    path = nifti(tmp_path / "a.nii", scan, changes)
    np.testing.assert_allclose(read_scan(path).T_lps_voxel, scan.T_lps_voxel, rtol=1e-5)


def test_a_unit_that_is_wrong_may_be_given(scan: Scan, tmp_path: Path) -> None:
    T = scan.T_lps_voxel.copy()
    T[:3] /= 10
    write_scan(Scan(scan.voxels, T, ""), tmp_path / "a.nrrd")
    given = read_scan(tmp_path / "a.nrrd", header=ScanHeader(unit="cm"))
    np.testing.assert_allclose(given.T_lps_voxel, scan.T_lps_voxel, rtol=1e-6)
    with pytest.raises(InputError, match="states its unit as inch, which is not understood"):
        read_scan(
            nrrd(tmp_path / "b.nrrd", scan, "space: LPS", DIRECTIONS, ORIGIN, 'space units: "inch" "inch" "inch"')
        )


@pytest.mark.parametrize("word", ["lp", "lpl", "xyz", "lpsr", ""])
def test_orientations_that_are_none_are_refused(word: str) -> None:
    with pytest.raises(InputError, match="expected three letters"):
        ScanHeader(orientation=word)


def test_a_nifti_that_tells_two_places_or_no_unit_says_so(scan: Scan, tmp_path: Path) -> None:
    mirrored = np.column_stack([np.diag([0.7, -0.8, 1.5]), [10, -5, 100]])
    path = nifti(tmp_path / "a.nii", scan, {CODES: ("2h", (1, 1)), SROW: ("12f", mirrored.ravel())})
    with pytest.warns(UserWarning, match=r"a\.nii tells two places: sform and qform put its corners up to 15\.4 mm"):
        read_scan(path)
    path = nifti(tmp_path / "b.nii", scan, {UNITS: ("B", (0,))})
    with pytest.warns(UserWarning, match=r"b\.nii does not state its unit; it is taken for mm"):
        read_scan(path)
    path = nrrd(tmp_path / "c.nrrd", scan, "space: left-posterior-superior", DIRECTIONS)
    with pytest.warns(UserWarning, match="does not say where in the patient it lies"):
        read_scan(path)


@pytest.mark.parametrize(
    ("stored", "slope", "inter", "true"),
    [
        (np.uint8([0, 255]), 1 / 255, 0.0, [0, 1]),
        (np.uint8([0, 100]), 0.02, 0.0, [0, 2]),
        (np.uint16([24, 1324]), 1.0, -1024.0, [-1000, 300]),
        (np.int16([0, 650]), 2.0, -1000.0, [-1000, 300]),
    ],
)
@pytest.mark.parametrize("packed", ["gz", "plain .nii.gz", "no"])
def test_slope_and_intercept_change_no_length(
    tmp_path: Path, stored: np.ndarray, slope: float, inter: float, true: list[int], packed: str
) -> None:
    """What its reader makes of the stored numbers is wider than they are; the file is whole all the same."""
    voxels = np.tile(stored, (12, 10, 4)).reshape(12, 10, 8)
    path = nifti(tmp_path / "a.nii", Scan(voxels, np.diag([0.7, 0.8, 1.5, 1]), ""), {SLOPE: ("2f", (slope, inter))})
    if packed != "no":
        data = path.read_bytes()
        path = tmp_path / "a.nii.gz"
        path.write_bytes(gzip.compress(data) if packed == "gz" else data)
    assert np.unique(read_scan(path).voxels).tolist() == true
    path.write_bytes(path.read_bytes()[: len(path.read_bytes()) * 2 // 3])
    with pytest.raises(InputError, match="truncated"):
        read_scan(path)


def test_a_map_of_probabilities_is_no_label_map(scan: Scan, tmp_path: Path) -> None:
    write_scan(Scan((scan.voxels / 4).astype(np.float32), scan.T_lps_voxel, ""), tmp_path / "p.nrrd")
    with pytest.raises(InputError, match="fractions from 0 to 1, a map of probabilities"):
        read_scan(tmp_path / "p.nrrd")


@pytest.mark.parametrize("field", ["sizes: ", "space origin: (", "spacings: "])
def test_numbers_of_thousands_of_digits_do_not_reach_the_reader(scan: Scan, tmp_path: Path, field: str) -> None:
    with pytest.raises(InputError, match="holds a number of 5000 digits"):
        read_scan(nrrd(tmp_path / "a.nrrd", scan, field + "1" * 5000))


def test_whole_labels_written_with_a_point_are_whole(scan: Scan, tmp_path: Path) -> None:
    head = (*HEAD, "Segment0_Name:=lumen")
    path = nrrd(tmp_path / "a.seg.nrrd", scan, *head, "Segment0_LabelValue:=1.0")
    assert read_scan(path).names == {"lumen": 1}
    with pytest.raises(InputError, match=r"Segment0_LabelValue is '1\.2\.3', expected a whole number"):
        read_scan(nrrd(tmp_path / "b.seg.nrrd", scan, *head, "Segment0_LabelValue:=1.2.3"))


def test_given_scans_of_public_complaints(cases: Path) -> None:
    folder = cases / "06-nrrd-without-spacing"
    for name in ("noheader.nrrd", "nospacing.mhd", "pixdim0.nii.gz"):
        with pytest.raises(InputError, match="lacks the spacing"):
            read_scan(folder / name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        control, scaled = (
            read_scan(cases / "01-nifti-slope-intercept" / f"{n}.nii.gz") for n in ("control", "lab_scl")
        )
        centimeters = read_scan(cases / "21-ct-in-centimeters" / "units_cm.nrrd")
    np.testing.assert_array_equal(scaled.voxels, control.voxels)
    np.testing.assert_allclose(centimeters.spacing_mm, 0.6)
    for path in sorted((cases / "fuzz").glob("*.nrrd")):
        with pytest.raises(InputError, match=r"digits|whole number"):
            read_scan(path)


@pytest.mark.parametrize("codes", [(0, 1), (1, 1)], ids=["sform alone", "both"])
def test_a_nifti_of_two_spacings_is_refused_and_may_be_told(scan: Scan, tmp_path: Path, codes: tuple[int, int]) -> None:
    path = nifti(tmp_path / "two.nii", scan, {80: ("3f", (1.0, 1.0, 1.0)), 252: ("2h", codes)})
    with pytest.raises(
        InputError, match=r"pixdim says \[1\.0, 1\.0, 1\.0\], the sform \[0\.7, 0\.8, 1\.5\].*spacing_mm="
    ):
        read_scan(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # sform and qform apart
        told = read_scan(path, header=ScanHeader(spacing_mm=[0.7, 0.8, 1.5]))
    np.testing.assert_allclose(np.linalg.norm(told.T_lps_voxel[:3, :3], axis=0), [0.7, 0.8, 1.5])


def test_a_packed_nifti_by_a_plain_name_is_told(scan: Scan, tmp_path: Path) -> None:
    write_scan(scan, tmp_path / "a.nii")
    (tmp_path / "b.nii").write_bytes(gzip.compress((tmp_path / "a.nii").read_bytes()))
    with pytest.raises(InputError, match=r"is packed by gzip, .*rename it to b\.nii\.gz"):
        read_scan(tmp_path / "b.nii")


MATRIX, PLACE = "TransformMatrix = 1 0 0 0 1 0 0 0 1", "Offset = 0 0 0"


def test_metaimages_unit_is_taken(scan: Scan, tmp_path: Path) -> None:
    path = meta(tmp_path / "cm.mha", scan, MATRIX, PLACE, "ElementSpacing = 0.07 0.08 0.15", "DistanceUnits = cm")
    np.testing.assert_allclose(np.linalg.norm(read_scan(path).T_lps_voxel[:3, :3], axis=0), [0.7, 0.8, 1.5])
    odd = meta(tmp_path / "odd.mha", scan, MATRIX, PLACE, "ElementSpacing = 0.7 0.8 1.5", "DistanceUnits = ell")
    with pytest.raises(InputError, match=r"states its unit as ell.*kidney\.header\.unit="):
        read_scan(odd)


def test_metaimages_name_of_an_orientation_alone_is_not_believed(scan: Scan, tmp_path: Path) -> None:
    spacing = "ElementSpacing = 0.7 0.8 1.5"
    named = meta(tmp_path / "n.mha", scan, PLACE, spacing, "AnatomicalOrientation = LPI")
    with pytest.raises(InputError, match=r"lacks the orientation.*kidney\.header\.orientation="):
        read_scan(named)
    both = meta(tmp_path / "b.mha", scan, MATRIX, PLACE, spacing, "AnatomicalOrientation = LPI")
    with pytest.warns(UserWarning, match="two orientations: LPI by name and RAI by its matrix, which is used"):
        read_scan(both)
    same = meta(tmp_path / "s.mha", scan, MATRIX.replace("1 0 0 0 1", "-1 0 0 0 1"), PLACE, spacing,
                "AnatomicalOrientation = LAI")  # fmt: skip
    assert read_scan(same).T_lps_voxel[0, 0] == pytest.approx(-0.7)
