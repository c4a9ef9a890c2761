"""A picture's size is known before it is decoded."""

import resource
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from ursnav_torch.errors import InputError
from ursnav_torch.features import read_image
from ursnav_torch.pictures import MOST_PIXELS, decode_picture


def huge_png(width: int, height: int) -> bytes:
    """A black PNG, a thousand times smaller than its picture."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer, rows = zlib.compressobj(1), bytes(width + 1) * 100
    data = b"".join(packer.compress(rows) for _ in range(height // 100)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


@pytest.mark.parametrize(("side", "match"), [(7000, "has 49 megapixels"), (30_000, "has 900 megapixels")])
def test_a_small_file_of_a_huge_picture_takes_no_memory(tmp_path: Path, side: int, match: str) -> None:
    (tmp_path / "huge.png").write_bytes(huge_png(side, side))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=rf"{match}; at most 40 are read"):
        read_image(tmp_path / "huge.png")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000, "KiB"


def test_opencvs_own_limit_holds_for_what_no_other_library_reads() -> None:
    program = "import ursnav_torch, os, cv2, numpy as np; print(os.environ['OPENCV_IO_MAX_IMAGE_PIXELS'])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert int(done.stdout) == MOST_PIXELS


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_a_tiff_that_declares_more_than_it_holds_takes_no_memory(dtype: type, channels: int) -> None:
    """Found by the fuzzer: 4.6 GiB and 5 s for a TIFF of three floats a pixel, which Pillow does not know."""
    good = cv2.imencode(".tiff", np.zeros((24, 32, channels), dtype))[1].tobytes()
    (first,) = struct.unpack("<I", good[4:8])
    bad = bytearray(good)
    for i in range(struct.unpack("<H", good[first : first + 2])[0]):
        at = first + 2 + 12 * i
        if struct.unpack("<H", good[at : at + 2])[0] in (256, 257):  # width, length
            bad[at + 2 : at + 12] = struct.pack("<HII", 4, 1, 32_000)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match="has 1024 megapixels; at most 40 are read"):
        decode_picture(bytes(bad), "x")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000, "KiB"
    assert decode_picture(good, "x") is not None


@pytest.mark.parametrize("suffix", [".webp", ".jp2", ".ppm", ".hdr", ".exr", ".ras"])
def test_formats_that_nobody_asked_for_are_not_decoded(suffix: str) -> None:
    image = np.zeros((24, 32, 3), np.float32 if suffix in (".hdr", ".exr") else np.uint8)
    try:
        written, encoded = cv2.imencode(suffix, image)
    except cv2.error:
        written = False
    if not written:
        pytest.skip("this OpenCV does not write it")
    assert decode_picture(encoded.tobytes(), "x") is None


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".jpg"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(20, 30), (20, 30, 3)])
def test_pictures_of_every_kind_are_decoded_as_opencv_does(suffix: str, dtype: type, shape: tuple[int, ...]) -> None:
    if dtype == np.uint16 and suffix in (".bmp", ".jpg"):
        pytest.skip("this format has 8 bits")
    image = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, shape, dtype)
    encoded = cv2.imencode(suffix, image)[1].tobytes()
    found = decode_picture(encoded, "x")
    assert found is not None and found.dtype == dtype
    np.testing.assert_array_equal(found, cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_UNCHANGED))
    assert decode_picture(b"", "x") is None and decode_picture(encoded[:9], "x") is None


@pytest.mark.parametrize("length", [0xFF000923, 10_000])
def test_a_png_whose_chunk_reaches_beyond_the_file_takes_no_memory(length: int) -> None:
    """OpenCV made room for 4.3 GB before it saw that the chunk is not there."""
    good = cv2.imencode(".png", np.full((24, 32, 3), 90, np.uint8))[1].tobytes()
    at = good.index(b"IDAT") - 4
    bad = good[:at] + length.to_bytes(4, "big") + good[at + 4 :]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert decode_picture(bad, "x") is None
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000, "KiB"
    assert decode_picture(good + b"behind its end", "x") is not None
