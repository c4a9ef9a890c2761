"""Where a JPEG's or PNG's picture ends in its file, and whether others stand in it.

A picture is whole when its own end is there, whatever follows: phones append videos, and grabbers pad files.
"""

#: Markers of a JPEG without a length behind them: TEM, RST0 to RST7, SOI.
_BARE = {0x01, *range(0xD0, 0xD9)}
_EOI, _SOS = 0xD9, 0xDA
#: How a PNG begins.
PNG = b"\x89PNG\r\n\x1a\n"


#: How files of other kinds begin that people take for pictures: from which byte on, and what they are.
_OTHERS = (
    (0, b"GIF8", "a GIF"), (8, b"WEBP", "a WebP"), (4, b"ftyphei", "a HEIC"), (4, b"ftypavif", "an AVIF"),
    (4, b"ftyp", "a video"), (128, b"DICM", "a DICOM file"), (0, b"%PDF", "a PDF"), (0, b"version https://git-lfs",
    "a pointer of Git LFS"), (0, b"<", "a page of the web"), (0, b"P6", "a PPM"), (0, b"P5", "a PGM"),
)  # fmt: skip


def what_else(data: bytes) -> str:
    """What a file is that is none of the kinds of pictures that are read; "" where it does not begin as any does."""
    if not data:
        return "empty"
    return next((what for at, mark, what in _OTHERS if data[at : at + len(mark)] == mark), "")


def picture_end(data: bytes) -> int | None:
    """How many bytes of a JPEG or PNG belong to its first picture; None where its end is missing, 0 for other kinds."""
    if data[:3] == b"\xff\xd8\xff":
        return _jpeg_end(data)
    if data[:8] == PNG:
        return _png_end(data)
    return 0


def pictures_within(data: bytes) -> int:
    """How many pictures a JPEG or PNG holds: frames of an animated PNG, or JPEGs that follow each other (MPO)."""
    end = picture_end(data)
    if not end:
        return 1
    if data[:8] == PNG:
        at = data.find(b"acTL", 8, 8 + 4096)
        return int.from_bytes(data[at + 4 : at + 8]) if at > 0 else 1
    count = 1
    while data[end : end + 3] == b"\xff\xd8\xff" and (more := _jpeg_end(data[end:])):
        count, end = count + 1, end + more
    return count


def _jpeg_end(data: bytes) -> int | None:
    """Just behind EOI, by the lengths of the segments before (a thumbnail in one of them has its own EOI)."""
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker == _EOI:
            return at + 2
        if marker == 0xFF:  # padding
            at += 1
            continue
        at += 2 if marker in _BARE else 2 + int.from_bytes(data[at + 2 : at + 4])
        if marker == _SOS:
            at = _next_marker(data, at)
    return at + 2 if data[at : at + 2] == b"\xff\xd9" else None


def _next_marker(data: bytes, at: int) -> int:
    """The next marker behind compressed data, in which FF 00 is a byte and RST0 to RST7 go on."""
    while (at := data.find(b"\xff", at)) >= 0:
        if at + 1 >= len(data):
            break
        if data[at + 1] != 0 and not 0xD0 <= data[at + 1] <= 0xD7 and data[at + 1] != 0xFF:
            return at
        at += 1 if data[at + 1] == 0xFF else 2
    return len(data)


def _png_end(data: bytes) -> int | None:
    at = len(PNG)
    while at + 12 <= len(data):
        length, kind = int.from_bytes(data[at : at + 4]), data[at + 4 : at + 8]
        at += 12 + length
        if kind == b"IEND":
            return at if at <= len(data) else None
    return None
