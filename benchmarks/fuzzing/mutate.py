"""Inputs that are almost right: bytes, numbers, lines and JSON values of a good file replaced by what hurts."""

import json
import random
import re
from typing import Any

_NUMBERS = (
    b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e400", b"0", b"-0", b"-1", b"1", b"2147483648", b"-2147483649",
    b"18446744073709551616", b"9" * 400, b"9" * 5000, b"1_5", b"1,5", b"0x10", b"1e-320", b"",
    b"\xd9\xa1", b"true",
)  # fmt: skip
_WORDS = (b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b'"', b"'", b",", b";", b"\r", b"\n", b"{", b"[", b"]", b"}", b"\\",
          b"../", b"%s%n", b"<script>", b"pelvis", b"none", b"|")  # fmt: skip
_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 10**30, -(10**30), 1e308, -1e308, 1e-320, 0.5, "", "x", "nan",
    "../x", "\0", "9" * 400, [], {}, [[]], [None], [1, 2], {"a": 1}, [[1, 2], [3]], ["x"] * 3, list(range(100)),
)  # fmt: skip
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][+-]?\d+)?")


def mutate(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    """A changed copy of some bytes; ``others`` are files of the same kind, to take parts from."""
    for _ in range(1 if rng.random() < 0.5 else rng.randint(2, 8)):
        data = rng.choice(_WAYS)(data, others, rng)
    return data[: 1 << 22]


def _flip(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    if not data:
        return data
    out = bytearray(data)
    out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _set(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    """Some bytes in the first kilobyte, where headers are, or anywhere."""
    if not data:
        return data
    at = rng.randrange(min(len(data), 1024) if rng.random() < 0.6 else len(data))
    new = rng.choice(
        (b"\0", b"\xff", b"\x7f\xff\xff\xff", b"\xff\xff\xff\xff", b"\0\0\0\x80", b"\0\0\xc0\x7f", b"\0" * 8)
    )
    return data[:at] + new + data[at + len(new) :]


def _cut(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] if rng.random() < 0.5 else data[:at] + data[min(len(data), at + rng.randint(1, 64)) :]


def _double(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    part = data[at : at + rng.randint(1, 200)]
    return data[:at] + part * rng.choice((2, 2, 3, 50)) + data[at:]


def _splice(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    other = rng.choice(others) if others else data
    return data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other) + 1) :]


def _insert(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.choice(_WORDS) + data[at:]


def _number(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    """Another number in the place of one."""
    found = list(_NUMBER.finditer(data[:20_000]))
    if not found:
        return _flip(data, others, rng)
    hit = rng.choice(found)
    return data[: hit.start()] + rng.choice(_NUMBERS) + data[hit.end() :]


def _lines(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    """Lines exchanged, left out or twice; cells of one, too."""
    sign = b"," if rng.random() < 0.4 else b"\n"
    parts = data.split(sign, 400)
    i, j = rng.randrange(len(parts)), rng.randrange(len(parts))
    way = rng.randrange(3)
    if way == 0:
        parts[i], parts[j] = parts[j], parts[i]
    elif way == 1:
        del parts[i]
    else:
        parts.insert(i, parts[j])
    return sign.join(parts)


def _json(data: bytes, others: list[bytes], rng: random.Random) -> bytes:
    """One value of a JSON text, or of one of its lines, replaced, left out or nested."""
    lines = data.split(b"\n")
    at = rng.randrange(len(lines))
    whole = data[:1] in (b"{", b"[") and len(lines) > 1 and b"}" not in lines[0]
    try:
        tree = json.loads(data if whole else lines[at])
    except (ValueError, RecursionError):
        return _number(data, others, rng)
    if not isinstance(tree, (dict, list)) or not tree:
        return _number(data, others, rng)
    holder: Any = tree
    while True:
        key = rng.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
        if isinstance(holder[key], (dict, list)) and holder[key] and rng.random() < 0.7:
            holder = holder[key]
            continue
        break
    if rng.random() < 0.2:
        del holder[key]
    else:
        holder[key] = rng.choice(_VALUES)
    text = json.dumps(tree).encode()
    return text if whole else b"\n".join([*lines[:at], text, *lines[at + 1 :]])


_WAYS = (_flip, _set, _cut, _double, _splice, _insert, _number, _number, _lines, _json, _json)
