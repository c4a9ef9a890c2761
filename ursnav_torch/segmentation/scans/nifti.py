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

Array = NDArray[np.float64]

_UNITS_MM = {1: 1000.0, 2: 1.0, 3: 1e-3}
#: Where sform and qform put a corner of the scan farther apart than this, mm, they tell two places.
_APART_MM = 1.0
#: Two spacings in one header that differ by more than this share are two.
_SAME_SPACING = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class NiftiHeader:
    """Fields of the header, by the format's names."""

    dim: tuple[int, ...]
    bitpix: int
    pixdim: tuple[float, ...]
    vox_offset: int
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
    """What a NIfTI file says of its geometry.

    Raises:
        InputError: no NIfTI header.
    """
    header = _read_header(path)
    spacing = all(np.isfinite(v) and v > 0 for v in header.pixdim[1:4])
    notes = []
    rival = _sform_spacing(header) if spacing and header.sform_code > 0 else None
    unit = _UNITS_MM.get(header.xyzt_units & 7)
    if unit is None:
        notes.append(f"{path.name} does not state its unit; it is taken for mm")
    if spacing and header.sform_code > 0 and header.qform_code > 0 and (apart := _apart(header)) > _APART_MM:
        notes.append(
            f"{path.name} tells two places: sform and qform put its corners up to {apart:.1f} mm apart. The sform "
            "is used; check the side in preview.png"
        )
    return Said(spacing, header.sform_code > 0 or header.qform_code > 0, unit, unit or 1.0, tuple(notes), rival)


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
    except (EOFError, OSError, zlib.error):
        raise _short(path) from None


def _read_header(path: Path) -> NiftiHeader:
    with _opened(path) as file:
        try:
            header = _header(file.read(540))
        except (EOFError, OSError, zlib.error):
            raise _short(path) from None
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
        tuple(int(v) for v in get("8h", 40)), int(get("h", 72)[0]), get("8f", 76),
        int(get("f", 108)[0]) if single and np.isfinite(get("f", 108)[0]) else 0, int(get("B", 123)[0]),
        int(codes[0]), int(codes[1]), get("3f", 256), get("3f", 268), np.reshape(get("12f", 280), (3, 4)),
    )  # fmt: skip


def _header_2(data: bytes, order: str) -> NiftiHeader:
    def get(form: str, at: int) -> tuple[float, ...]:
        return struct.unpack_from(order + form, data, at)

    return NiftiHeader(
        tuple(int(v) for v in get("8q", 16)), int(get("h", 14)[0]), get("8d", 104), int(get("q", 168)[0]),
        int(get("i", 500)[0]), int(get("i", 344)[0]), int(get("i", 348)[0]), get("3d", 352), get("3d", 376),
        np.reshape(get("12d", 400), (3, 4)),
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
