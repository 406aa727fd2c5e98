"""Damage to files, drawn at random from a seed: what failing disks, broken copies and careless editors do."""

import json
import random
from collections.abc import Callable
from typing import Any

SECTOR = 512


def _flip(data: bytearray, dice: random.Random) -> None:
    for _ in range(dice.choice([1, 1, 1, 8])):
        at = dice.randrange(8 * len(data))
        data[at // 8] ^= 1 << at % 8


def _sector(data: bytearray, dice: random.Random) -> slice:
    # the first sectors hold the structure
    at = dice.randrange(min(len(data), dice.choice([110 * SECTOR, len(data)]))) // SECTOR
    return slice(SECTOR * at, min(SECTOR * (at + 1), len(data)))


def _zero(data: bytearray, dice: random.Random) -> None:
    where = _sector(data, dice)
    data[where] = bytes(where.stop - where.start)


def _repeat(data: bytearray, dice: random.Random) -> None:
    one, other = _sector(data, dice), _sector(data, dice)
    data[other] = data[one][: other.stop - other.start].ljust(other.stop - other.start, b"\0")


def _swap(data: bytearray, dice: random.Random) -> None:
    one, other = _sector(data, dice), _sector(data, dice)
    if one.stop - one.start == other.stop - other.start:
        data[one], data[other] = data[other], data[one]


def _cut(data: bytearray, dice: random.Random) -> None:
    del data[dice.randrange(len(data)) :]


def _append(data: bytearray, dice: random.Random) -> None:
    data += dice.randbytes(dice.choice([1, SECTOR, 5000]))


def _garbage(data: bytearray, dice: random.Random) -> None:
    where = _sector(data, dice)
    data[where] = dice.randbytes(where.stop - where.start)


_OF_BYTES: list[Callable[[bytearray, random.Random], None]] = [
    _flip, _flip, _zero, _zero, _repeat, _swap, _cut, _append, _garbage,
]  # fmt: skip
_VALUES: list[Any] = [
    None, True, 0, -1, 2, 1e308, 10**40, "", "x", "\0", "a\0b", "\ud800", "/", "../..", [], {}, [1], [[]], {"a": 1},
    [{}], {"results.nc": "x"}, {"results.nc": []}, {"results.nc": [1]}, {"../results.nc": ["x"]}, "🦆" * 300,
]  # fmt: skip


def damaged(data: bytes, dice: random.Random) -> bytes:
    """The bytes of a file after one misfortune."""
    changed = bytearray(data)
    if changed:
        dice.choice(_OF_BYTES)(changed, dice)
    return bytes(changed)


def edited(data: bytes, dice: random.Random, checksum: Callable[[dict[str, Any]], str]) -> bytes:
    """A JSON object after somebody changed a value in it, and perhaps its checksum and format."""
    found = json.loads(data)
    name = dice.choice([*found, "more"])
    if dice.random() < 0.2:
        found.pop(name, None)
    else:
        found[name] = dice.choice(_VALUES)
    if dice.random() < 0.7:
        content = {n: v for n, v in found.items() if n not in ("format", "sha256")}
        found["sha256"] = checksum(content)
    if dice.random() < 0.2:
        found = {n: v for n, v in found.items() if n not in ("sha256", "computed_on", "outputs", "finished")}
        found["format"] = 1
    return json.dumps(found).encode()
