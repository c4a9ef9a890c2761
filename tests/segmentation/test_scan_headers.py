"""Geometry is never invented: what a header does not say is refused by name, or given by name."""

import contextlib
import gzip
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.segmentation import Scan, ScanHeader, read_scan, write_scan
from ursnav_torch.segmentation.scans.read import read_scan_here

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


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({CODES: ("2h", (1, 0)), 256: ("3f", (float("nan"), 0, 0))}, r"its qform .* is \[nan, 0\.0, 0\.0,.*nowhere"),
        ({CODES: ("2h", (1, 0)), 256: ("3f", (1, 1, 1))}, r"its qform .* places it nowhere"),
        ({CODES: ("2h", (1, 0)), 268: ("3f", (float("nan"), 0, 0))}, r"its qform .* places it nowhere"),
        ({CODES: ("2h", (0, 1)), SROW: ("12f", (0,) * 12)}, r"its sform .* places it nowhere"),
        (
            {CODES: ("2h", (1, 1)), SROW: ("12f", (-0.7, 0, 0, 9, 0, -0.8, 0.1, -5, 0, 0, 1.5, 9))},
            "not at right angles",
        ),
        ({108: ("f", (0.0,))}, r"begin at byte 0 \(vox_offset\), within its own header of 352 bytes"),
        ({SLOPE: ("2f", (1, float("nan")))}, "scl_slope 1 and scl_inter nan, which cannot be"),
        ({SLOPE: ("2f", (float("inf"), 0))}, "scl_slope inf and scl_inter 0, which cannot be"),
        ({PIXDIM + 4: ("3f", (-0.7, 0.8, 1.5))}, r"lacks the spacing \(pixdim is \[-0\.7, 0\.8, 1\.5\]\)"),
    ],
)
def test_a_nifti_of_numbers_that_cannot_be_is_not_placed_by_its_readers_guess(
    scan: Scan, tmp_path: Path, changes: dict[int, tuple[str, tuple[float, ...]]], reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        read_scan_here(nifti(tmp_path / "a.nii", scan, changes))


def test_an_intercept_beside_slope_0_is_not_added_and_said(scan: Scan, tmp_path: Path) -> None:
    path = nifti(tmp_path / "a.nii", scan, {SLOPE: ("2f", (0, -1024))})
    with pytest.warns(UserWarning, match="scl_slope 0, .* scl_inter -1024, which is not added"):
        np.testing.assert_array_equal(read_scan_here(path).voxels, scan.voxels)
    nan = nifti(tmp_path / "b.nii", scan, {SLOPE: ("2f", (float("nan"), float("nan")))})
    np.testing.assert_array_equal(read_scan_here(nan).voxels, scan.voxels)


def test_a_packed_file_that_is_damaged_is_not_called_truncated(scan: Scan, tmp_path: Path) -> None:
    write_scan(scan, tmp_path / "a.nii")
    packed = bytearray(gzip.compress((tmp_path / "a.nii").read_bytes()))
    packed[-8] ^= 1
    (tmp_path / "b.nii.gz").write_bytes(packed)
    with pytest.raises(InputError, match=r"b\.nii\.gz cannot be unpacked \(CRC check failed.*it is damaged"):
        read_scan_here(tmp_path / "b.nii.gz")


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        (("space: RPS", DIRECTIONS, ORIGIN), "states its space as 'RPS', which NRRD has not"),
        (("space: LPS", "spacings: 0.7 0.8 1.5"), "a space and spacings, and no space directions"),
        (("space: LPS", DIRECTIONS.replace("1.5", "0"), ORIGIN), r"lacks the spacing \(space directions is"),
        (("space: LPS", DIRECTIONS.replace("1.5", "nan"), ORIGIN), r"lacks the spacing \(space directions is"),
    ],
)
def test_an_nrrd_that_places_nothing_is_refused(
    scan: Scan, tmp_path: Path, fields: tuple[str, ...], reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        read_scan_here(nrrd(tmp_path / "a.nrrd", scan, *fields))


def test_a_place_that_is_no_number_is_no_place(scan: Scan, tmp_path: Path) -> None:
    for path in (
        nrrd(tmp_path / "a.nrrd", scan, *HEAD[:2], "space origin: (nan,nan,nan)"),
        meta(tmp_path / "a.mha", scan, MATRIX, "Offset = nan nan nan", "ElementSpacing = 0.7 0.8 1.5"),
    ):
        with (
            pytest.warns(UserWarning, match="does not say where in the patient it lies"),
            contextlib.suppress(InputError),
        ):
            read_scan_here(path)


def test_numbers_that_16_bits_do_not_hold_are_said(tmp_path: Path) -> None:
    voxels = np.linspace(0, 70_000, 960).reshape(12, 10, 8)
    write_scan(Scan(voxels.astype(np.int32), np.diag([0.7, 0.8, 1.5, 1]), ""), tmp_path / "a.nrrd")
    with pytest.warns(UserWarning, match="numbers from 0 to 70000; CT numbers and labels lie within -32768 and 32767"):
        assert read_scan_here(tmp_path / "a.nrrd").voxels.max() == 32767


LAID = (MATRIX, PLACE, "ElementSpacing = 0.7 0.8 1.5")


@pytest.mark.parametrize("harm", ["cut", "changed", "no length", "gone", "short"])
def test_packed_and_separate_data_of_a_metaimage_are_whole(scan: Scan, tmp_path: Path, harm: str) -> None:
    """Its reader gives what lies in memory where they are not, and says so to nobody."""
    data = bytearray(zlib.compress(scan.voxels.transpose(2, 1, 0).tobytes()))
    length = (f"CompressedDataSize = {len(data)}",) * (harm != "no length")
    head = "\n".join(
        ["NDims = 3", "DimSize = 12 10 8", "ElementType = MET_UCHAR", *LAID, "CompressedData = True", *length]
    )
    path, local = tmp_path / "a.mha", "ElementDataFile = LOCAL"
    path.write_bytes(f"{head}\n{local}\n".encode() + data)
    if harm != "no length":
        np.testing.assert_array_equal(read_scan_here(path).voxels, scan.voxels)
    data[60] ^= 255 * (harm == "changed")
    data = data[: -50 if harm in ("cut", "short") else None]
    (tmp_path / "b.zraw").write_bytes(data) if harm == "short" else None
    separate = harm in ("gone", "short")
    path.write_bytes(f"{head}\n{'ElementDataFile = b.zraw' if separate else local}\n".encode() + data * (not separate))
    reasons = {
        "cut": "truncated", "changed": "cannot be unpacked .*it is damaged", "no length": r"\(CompressedDataSize\)",
        "gone": r"names its data b\.zraw, and there is no such file", "short": r"b\.zraw ends before its data do",
    }  # fmt: skip
    with pytest.raises(InputError, match=reasons[harm]):
        read_scan_here(path)


def test_a_sequence_of_plus_is_no_scan(scan: Scan, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a sequence that Plus recorded"):
        read_scan_here(meta(tmp_path / "a.mha", scan, *LAID, "Seq_Frame0000_Timestamp = 1.0"))
