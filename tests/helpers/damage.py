"""Random damage to files, as by failing disks, broken copies and careless editing."""

import json
import random
from collections.abc import Callable
from typing import Any

SECTOR_BYTES = 512


def _flip_bits(data: bytearray, dice: random.Random) -> None:
    for _ in range(dice.choice([1, 1, 1, 8])):
        at = dice.randrange(8 * len(data))
        data[at // 8] ^= 1 << at % 8


def _random_sector(data: bytearray, dice: random.Random) -> slice:
    # the first sectors hold the structure
    at = dice.randrange(min(len(data), dice.choice([110 * SECTOR_BYTES, len(data)]))) // SECTOR_BYTES
    return slice(SECTOR_BYTES * at, min(SECTOR_BYTES * (at + 1), len(data)))


def _zero_sector(data: bytearray, dice: random.Random) -> None:
    where = _random_sector(data, dice)
    data[where] = bytes(where.stop - where.start)


def _repeat_sector(data: bytearray, dice: random.Random) -> None:
    one, other = _random_sector(data, dice), _random_sector(data, dice)
    data[other] = data[one][: other.stop - other.start].ljust(other.stop - other.start, b"\0")


def _swap_sectors(data: bytearray, dice: random.Random) -> None:
    one, other = _random_sector(data, dice), _random_sector(data, dice)
    if one.stop - one.start == other.stop - other.start:
        data[one], data[other] = data[other], data[one]


def _cut_end(data: bytearray, dice: random.Random) -> None:
    del data[dice.randrange(len(data)) :]


def _append_bytes(data: bytearray, dice: random.Random) -> None:
    data += dice.randbytes(dice.choice([1, SECTOR_BYTES, 5000]))


def _overwrite_sector(data: bytearray, dice: random.Random) -> None:
    where = _random_sector(data, dice)
    data[where] = dice.randbytes(where.stop - where.start)


_BYTE_DAMAGES: list[Callable[[bytearray, random.Random], None]] = [
    _flip_bits, _flip_bits, _zero_sector, _zero_sector, _repeat_sector, _swap_sectors, _cut_end, _append_bytes,
    _overwrite_sector,
]  # fmt: skip
_ODD_VALUES: list[Any] = [
    None, True, 0, -1, 2, 1e308, 10**40, "", "x", "\0", "a\0b", "\ud800", "/", "../..", [], {}, [1], [[]], {"a": 1},
    [{}], {"results.nc": "x"}, {"results.nc": []}, {"results.nc": [1]}, {"../results.nc": ["x"]}, "🦆" * 300,
]  # fmt: skip


def damage_bytes(data: bytes, dice: random.Random) -> bytes:
    """Damage the bytes of a file once."""
    changed = bytearray(data)
    if changed:
        dice.choice(_BYTE_DAMAGES)(changed, dice)
    return bytes(changed)


def edit_json(data: bytes, dice: random.Random, checksum: Callable[[dict[str, Any]], str]) -> bytes:
    """Change a value of a JSON object, and perhaps its checksum and format."""
    content = json.loads(data)
    name = dice.choice([*content, "more"])
    if dice.random() < 0.2:
        content.pop(name, None)
    else:
        content[name] = dice.choice(_ODD_VALUES)
    if dice.random() < 0.7:
        unsigned = {n: v for n, v in content.items() if n not in ("format", "sha256")}
        content["sha256"] = checksum(unsigned)
    if dice.random() < 0.2:
        content = {n: v for n, v in content.items() if n not in ("sha256", "computed_on", "outputs", "finished")}
        content["format"] = 1
    return json.dumps(content).encode()
