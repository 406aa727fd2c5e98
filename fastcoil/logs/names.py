"""Which series a header of a building system, a Haystack name or a Brick class means, if that is beyond doubt.

A header is split into words, each of which stands for words of the table below.  It is read as a series if it has the
words of one, and no others but the unit of plant before them: ``AHU1 CHW VLV CMD``, ``discharge air temp sp``,
``Supply_Air_Temperature_Setpoint``.  What else it says, such as that it is a schedule or a limit, forbids it.
"""

import re
from typing import NamedTuple

from fastcoil.logs.series import COLUMNS
from fastcoil.logs.table import label_and_unit

_SPELLINGS = {
    "supply": "supply sup discharge disch dsch",
    "mixed": "mixed mix entering",
    "air": "air",
    "water": "water",
    "temp": "temp temperature tmp t temperatur",
    "setpoint": "setpoint setpt stpt spt sp sollwert",
    "flow": "flow",
    "valve": "valve vlv ventil",
    "cooling": "cooling cool clg chilled",
    "heating": "heating heat htg hot preheat pht reheat rht",
    "coil": "coil",
    "command": "command cmd output out o",
    "position": "position pos feedback fb fbk actual act",
    "fan": "fan",
    "status": "status sts stat s run on off",
    "supply air": "sa da",
    "supply air temp": "sat dat zulufttemperatur",
    "supply fan": "sf sfan",
    "mixed air": "ma",
    "mixed air temp": "mat",
    "air flow": "airflow cfm",
    "cooling water": "chw",
    "heating water": "hw hhw",
    "cooling water valve": "chwv chwvlv",
    "heating water valve": "hwv hwvlv hhwv",
    "cooling coil valve": "clgvlv ccv kühlventil",
    "heating coil valve": "htgvlv hcv heizventil",
    "": "sensor present value pv trend log duct effective eff active modulating",
    "place": "ahu rtu doas acu mau unit bldg building floor",
    "other": (
        "return ret ra rat rf outside outdoor oa oat exhaust relief ea ef zone zn room rm space average avg mean min "
        "max minimum maximum low high lo hi limit lim alarm alm fault sched schedule occ unocc occupied unoccupied "
        "reset offset deadband db humidifier hum steam bypass isolation iso damper dmpr dpr econ wheel erv hrv hru "
        "leaving lat static pressure dp humidity rh dewpoint speed spd vfd chiller boiler pump condenser cw"
    ),
}
"""Words of the rules, and what buildings write for them; of a blank no meaning depends on."""
_WORDS = {word: known.split() for known, written in _SPELLINGS.items() for word in written.split()}
_RULES = [
    ("command", "valve command", "cooling heating water coil position"),
    ("command", "valve", "cooling heating water coil"),
    ("command", "cooling command", "coil water"),
    ("command", "heating command", "coil water"),
    ("T_sup", "supply air temp", "position"),
    ("T_set", "supply air temp setpoint", "cooling heating"),
    ("T_a_in", "mixed air temp", "coil"),
    ("m_a", "air flow", "supply fan"),
    ("enabled", "fan status", "supply air"),
]
"""Series, words that its header must have, and words that it may have."""
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
    for name, needed, allowed in _RULES:
        rest = words - {*needed.split()}
        if len(words) - len(rest) == len(needed.split()) and rest <= {*allowed.split(), "position"}:
            is_clear &= rest <= {*allowed.split()}  # a position that is fed back is no command
            return (
                Meaning(name, frozenset(place), is_clear)
                if unit is None or COLUMNS[name].is_same_unit(unit, unit)
                else None
            )
    return None
