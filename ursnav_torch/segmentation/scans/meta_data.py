"""Whether a MetaImage's data are whole: its reader returns what lies in memory where packed ones are damaged."""

import math
import zlib
from pathlib import Path
from typing import BinaryIO

from ursnav_torch.errors import InputError
from ursnav_torch.segmentation.scans.text_headers import header_fields, header_numbers

#: Bytes an element of a type takes, MET_ left out.
_BYTES = {
    "CHAR": 1, "UCHAR": 1, "SHORT": 2, "USHORT": 2, "INT": 4, "UINT": 4, "LONG": 4, "ULONG": 4, "LONG_LONG": 8,
    "ULONG_LONG": 8, "FLOAT": 4, "DOUBLE": 8,
}  # fmt: skip
_CHUNK = 1 << 20
#: zlib and gzip, whichever it is.
_ZLIB_OR_GZIP = 47


def check_meta_data(path: Path) -> None:
    """Refuse a MetaImage (.mha, .mhd) whose data are missing, end early or cannot be unpacked.

    Data in several files, as text or behind a header of their own are left to its reader.

    Raises:
        InputError: see there; it does not say how long packed data in its own file are.
    """
    fields = header_fields(path, "=", b"")
    name, each = fields.get("elementdatafile", ""), _BYTES.get(fields.get("elementtype", "").upper()[4:])
    plain = fields.get("headersize", "0") == "0" and fields.get("binarydata", "True").lower() == "true"
    if not name or name.split()[0].upper() == "LIST" or "%" in name or each is None or not plain:
        return
    local, packed = name.upper() == "LOCAL", fields.get("compresseddata", "False").lower() == "true"
    data = path if local else path.parent / name
    if not data.is_file():
        raise InputError(f"{path} names its data {name}, and there is no such file beside it: copy it, too.")
    if local and packed and "compresseddatasize" not in fields:
        raise InputError(f"{path} does not say how long its packed data are (CompressedDataSize); export it again.")
    counts = header_numbers(f"{fields.get('dimsize', '')} {fields.get('elementnumberofchannels', '1')}")
    wanted = each * math.prod(int(n) for n in counts)
    with data.open("rb") as file:
        if local:
            _to_data(file)
        found = _unpacked(file, wanted, data) if packed else data.stat().st_size - file.tell()
    if found < wanted:
        raise InputError(
            f"{data} ends before its data do: it is truncated ({found} of {wanted} bytes). Copy or export it again."
        )


def _to_data(file: BinaryIO) -> None:
    """Behind the header's last line."""
    for line in file:
        if line.lower().lstrip().startswith(b"elementdatafile"):
            return


def _unpacked(file: BinaryIO, wanted: int, data: Path) -> int:
    """How many bytes come out of packed data, up to ``wanted``."""
    unpacker, count, left = zlib.decompressobj(_ZLIB_OR_GZIP), 0, b""
    try:
        while count < wanted and not unpacker.eof:
            left = left or file.read(_CHUNK)
            if not left:
                break
            count += len(unpacker.decompress(left, _CHUNK))
            left = unpacker.unconsumed_tail
    except zlib.error as error:
        raise InputError(f"{data} cannot be unpacked ({error}): it is damaged. Copy or export it again.") from None
    return count
