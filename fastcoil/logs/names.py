"""Which series a header of a building system, a Haystack name or a Brick class means, if that is beyond doubt.

A header is split into words, each of which stands for words of ``names.toml``.  It is read as a series if it has the
words of one, and no others but the unit of plant before them: ``AHU1 CHW VLV CMD``, ``discharge air temp sp``,
``Supply_Air_Temperature_Setpoint``.  What else it says, such as that it is a schedule or a limit, forbids it.
"""

import re
import tomllib
from pathlib import Path
from typing import NamedTuple

from fastcoil.logs.series import COLUMNS
from fastcoil.logs.table import label_and_unit

_TABLE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_WORDS = {word: known.split() for known, written in _TABLE["words"].items() for word in written.split()}
_ADDRESS = re.compile(r"\b[ab][iov][-_ ]?[0-9]+\b|(?:^|[.:/\\])[a-z](?=[.:/\\])", re.IGNORECASE)
"""Of a BACnet object; a folder of one letter in a path."""
_SET_POINT = re.compile(r"set[-_ ]*point", re.IGNORECASE)
_WORD = re.compile(r"[A-Z]?[a-zà-ÿ]+|[A-ZÀ-Ý]+(?![a-z])|[A-Z]|[0-9]+")


class Meaning(NamedTuple):
    """The series that a header means, words that say of which plant, and whether nothing speaks against it."""

    name: str
    place: frozenset[str]
    is_clear: bool


def meaning_of(header: str) -> Meaning | None:
    """What a header means; None where it means no series, or nothing that is known."""
    label, unit = label_and_unit(header)
    written = [word.lower() for word in _WORD.findall(_SET_POINT.sub("setpoint", _ADDRESS.sub(" ", label)))]
    written += ["cfm"] * (unit is not None and unit.lower() == "cfm")
    known = [_WORDS.get(word) for word in written]
    words = {one for meant in known for one in meant or ()} - {"place"}
    place: list[str] = []
    for k, word in enumerate(written):
        if word.isdigit() and k and known[k - 1] in (None, ["place"]):
            place[-1] += f" {word}"  # AHU-1 is another place than AHU-2, even below NAE-1
        elif known[k] in (None, ["place"]):
            place.append(word)
    first = next((k for k, meant in enumerate(known) if meant not in (None, ["place"])), 0)
    is_clear = all(
        word.isdigit() or meant is not None for word, meant in zip(written[first:], known[first:], strict=True)
    )
    for name, needed, allowed in _TABLE["rules"]:
        rest = words - {*needed.split()}
        if len(words) - len(rest) == len(needed.split()) and rest <= {*allowed.split(), "position"}:
            is_clear &= rest <= {*allowed.split()}  # a position that is fed back is no command
            return (
                Meaning(name, frozenset(place), is_clear)
                if unit is None or COLUMNS[name].is_same_unit(unit, unit)
                else None
            )
    return None
