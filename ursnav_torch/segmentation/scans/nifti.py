"""The header of a NIfTI file: geometry, units and where its data end (NIfTI-1.1 and NIfTI-2 data format)."""

import gzip
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ursnav_torch.errors import InputError
from ursnav_torch.segmentation.scans.headers import Said
from ursnav_torch.segmentation.scans.scan import check_straight

Array = NDArray[np.float64]

_UNITS_MM = {1: 1000.0, 2: 1.0, 3: 1e-3}
#: Where sform and qform put a corner of the scan farther apart than this, mm, they tell two places.
_APART_MM = 1.0
#: Two spacings in one header that differ by more than this share are two.
_SAME_SPACING = 0.01
#: A quaternion's three numbers are no longer than 1, but for rounding.
_LONGEST_QUATERNION = 1.001
#: Bytes before the voxels of a single file, by its header's length: the header and four that tell of extensions.
_HEAD_BYTES = {348: 352, 540: 544}


@dataclass(frozen=True, slots=True, eq=False)
class NiftiHeader:
    """Fields of the header, by the format's names; ``single``: header and voxels are one file."""

    sizeof_hdr: int
    single: bool
    dim: tuple[int, ...]
    bitpix: int
    pixdim: tuple[float, ...]
    vox_offset: int
    scl: tuple[float, ...]
    xyzt_units: int
    qform_code: int
    sform_code: int
    quatern: tuple[float, ...]
    qoffset: tuple[float, ...]
    srow: Array

    @property
    def data_end(self) -> int:
        """Length in bytes of a whole file, unpacked."""
        shape = [max(n, 1) for n in self.dim[1 : self.dim[0] + 1]]
        return self.vox_offset + -(-int(np.prod(shape, dtype=object)) * self.bitpix // 8)

    def qform(self) -> Array:
        """(3, 4) RAS <- voxel, from the quaternion (method 2 of the standard)."""
        b, c, d = self.quatern
        a = np.sqrt(max(1 - b * b - c * c - d * d, 0.0))
        scale = np.array(self.pixdim[1:4]) * [1, 1, -1 if self.pixdim[0] < 0 else 1]
        return np.column_stack([Rotation.from_quat([b, c, d, a]).as_matrix() * scale, self.qoffset])


def nifti_said(path: Path) -> Said:
    """What a NIfTI file says of its geometry and of how its numbers are scaled.

    Raises:
        InputError: no NIfTI header, or one that says what cannot be.
    """
    header = _read_header(path)
    _check_begin(header, path)
    _check_place(header, path)
    spacing = all(np.isfinite(v) and v > 0 for v in header.pixdim[1:4])
    added, notes = _added(header, path)
    rival = _sform_spacing(header) if spacing and header.sform_code > 0 else None
    unit = _UNITS_MM.get(header.xyzt_units & 7)
    if unit is None:
        notes.append(f"{path.name} does not state its unit; it is taken for mm")
    both = spacing and header.sform_code > 0 and header.qform_code > 0 and _qform_is_one(header)
    if both and (apart := _apart(header)) > _APART_MM:
        notes.append(
            f"{path.name} tells two places: sform and qform put its corners up to {apart:.1f} mm apart. The sform "
            "is used; check the side in preview.png"
        )
    lies = header.sform_code > 0 or header.qform_code > 0
    found = f"pixdim is {np.round(header.pixdim[1:4], 4).tolist()}"
    return Said(spacing, lies, unit, unit or 1.0, tuple(notes), rival, found, added)


def _check_begin(header: NiftiHeader, path: Path) -> None:
    """Refuse a single file whose voxels would begin within its header."""
    least = _HEAD_BYTES[header.sizeof_hdr]
    if header.single and header.vox_offset < least:
        raise InputError(
            f"{path} says that its voxels begin at byte {header.vox_offset} (vox_offset), within its own header of "
            f"{least} bytes: where they begin is not known. Export it again."
        )


def _check_place(header: NiftiHeader, path: Path) -> None:
    """Refuse numbers that place a scan nowhere: its reader would put it somewhere all the same."""
    if header.sform_code > 0:
        R = header.srow[:, :3]
        if not np.isfinite(header.srow).all() or np.linalg.norm(R, axis=0).min() <= 0:
            raise InputError(
                f"{path}: its sform (srow_x, srow_y, srow_z) is {np.round(header.srow, 4).tolist()}, which places it "
                "nowhere. Export it again."
            )
        check_straight(R / np.linalg.norm(R, axis=0), path.name)
    elif header.qform_code > 0 and not _qform_is_one(header):
        raise InputError(
            f"{path}: its qform (quatern_b, c, d and qoffset_x, y, z) is "
            f"{np.round([*header.quatern, *header.qoffset], 4).tolist()}, which places it nowhere: the first three are "
            "no longer than 1 together. Export it again."
        )


def _qform_is_one(header: NiftiHeader) -> bool:
    finite = bool(np.isfinite([*header.quatern, *header.qoffset]).all())
    return finite and float(np.linalg.norm(header.quatern)) <= _LONGEST_QUATERNION


def _added(header: NiftiHeader, path: Path) -> tuple[float, list[str]]:
    """What the reader adds to the stored numbers though the format says it should not, and a note about it.

    Raises:
        InputError: a slope or an intercept that is no number beside one that is.
    """
    slope, inter = header.scl
    if np.isinf([slope, inter]).any() or (np.isfinite(slope) and slope != 0 and np.isnan(inter)):
        raise InputError(
            f"{path}: its numbers are scaled by scl_slope {slope:g} and scl_inter {inter:g}, which cannot be. Export "
            "it again."
        )
    if slope != 0 or inter == 0 or np.isnan(inter):
        return 0.0, []
    return inter, [
        f"{path.name} has scl_slope 0, by which its numbers are taken as they are stored, and scl_inter {inter:g}, "
        "which is not added. If air is near 0 in it and not near -1000, export it again"
    ]


def check_nifti_length(path: Path) -> None:
    """Refuse a file that ends before its data do: its reader would fill the rest with anything.

    Raises:
        InputError: it does.
    """
    left = _read_header(path).data_end
    try:
        with _opened(path) as file:
            while left > 0:
                chunk = file.read(min(left, 1 << 24))
                if not chunk:
                    raise _short(path)
                left -= len(chunk)
    except EOFError:
        raise _short(path) from None
    except (OSError, zlib.error) as error:
        raise _damaged(path, error) from None


def check_nifti_packing(path: Path) -> None:
    """Refuse a packed file whose check sum is not that of its data.

    Raises:
        InputError: see there, or it ends early.
    """
    check_nifti_length(path)
    try:
        with _opened(path) as file:
            while file.read(1 << 24):
                pass
    except (EOFError, OSError, zlib.error) as error:
        raise _damaged(path, error) from None


def _read_header(path: Path) -> NiftiHeader:
    with _opened(path) as file:
        try:
            header = _header(file.read(540))
        except EOFError:
            raise _short(path) from None
        except (OSError, zlib.error) as error:
            raise _damaged(path, error) from None
    if header is None:
        raise InputError(f"{path} cannot be read as a scan: it has no NIfTI header. Export or copy it again.")
    return header


def _opened(path: Path) -> gzip.GzipFile:
    """The file unpacked, whatever its name says."""
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    return gzip.open(path) if packed else path.open("rb")  # type: ignore[return-value]


def _header(data: bytes) -> NiftiHeader | None:
    for order in "<>":
        if len(data) >= 348 and struct.unpack_from(order + "i", data, 0)[0] == 348:
            return _header_1(data, order)
        if len(data) >= 540 and struct.unpack_from(order + "i", data, 0)[0] == 540:
            return _header_2(data, order)
    return None


def _header_1(data: bytes, order: str) -> NiftiHeader:
    def get(form: str, at: int) -> tuple[float, ...]:
        return struct.unpack_from(order + form, data, at)

    single = data[344:348] == b"n+1\0"
    codes = get("2h", 252) if data[344:347] in (b"n+1", b"ni1") else (0, 0)
    return NiftiHeader(
        348, single, tuple(int(v) for v in get("8h", 40)), int(get("h", 72)[0]), get("8f", 76),
        int(get("f", 108)[0]) if single and np.isfinite(get("f", 108)[0]) else 0, get("2f", 112), int(get("B", 123)[0]),
        int(codes[0]), int(codes[1]), get("3f", 256), get("3f", 268), np.reshape(get("12f", 280), (3, 4)),
    )  # fmt: skip


def _header_2(data: bytes, order: str) -> NiftiHeader:
    def get(form: str, at: int) -> tuple[float, ...]:
        return struct.unpack_from(order + form, data, at)

    return NiftiHeader(
        540, data[4:8] == b"n+2\0", tuple(int(v) for v in get("8q", 16)), int(get("h", 14)[0]), get("8d", 104),
        int(get("q", 168)[0]), get("2d", 176), int(get("i", 500)[0]), int(get("i", 344)[0]), int(get("i", 348)[0]),
        get("3d", 352), get("3d", 376), np.reshape(get("12d", 400), (3, 4)),
    )  # fmt: skip


def _sform_spacing(header: NiftiHeader) -> str | None:
    """What the header says twice, where its sform has another spacing than its pixdim."""
    of_sform, of_pixdim = np.linalg.norm(header.srow[:, :3], axis=0), np.array(header.pixdim[1:4])
    if np.allclose(of_sform, of_pixdim, rtol=_SAME_SPACING):
        return None
    return f"pixdim says {of_pixdim.round(4).tolist()}, the sform {of_sform.round(4).tolist()}"


def _apart(header: NiftiHeader) -> float:
    corners = np.array(np.meshgrid(*[(0, n - 1) for n in header.dim[1:4]])).reshape(3, -1)
    corners = np.vstack([corners, np.ones(corners.shape[1])])
    return float(np.linalg.norm(header.srow @ corners - header.qform() @ corners, axis=0).max())


def _short(path: Path) -> InputError:
    return InputError(f"{path} ends before its data do: it is truncated. Copy or export it again.")


def _damaged(path: Path, error: Exception) -> InputError:
    return InputError(f"{path} cannot be unpacked ({error}): it is damaged. Copy or export it again.")
