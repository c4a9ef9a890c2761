"""Whether what a work folder keeps still comes from the code and the weights of today."""

import hashlib
from pathlib import Path

import ursnav_torch


def sources(rooms: tuple[str, ...]) -> str:
    """A fingerprint of the code of some rooms, and of what they learned."""
    root = Path(ursnav_torch.__file__).parent
    files = sorted(
        p for room in rooms for p in (root / room).rglob("*") if p.suffix in (".py", ".json", ".safetensors")
    )
    return hashlib.sha256(b"".join(p.read_bytes() for p in files)).hexdigest()
