"""Names, numbers and comments that C, Structured Text and Python can all have."""

import re
import unicodedata

WIDTH = 100
"""Characters of a line of code."""
_C = """
auto break bool case char const continue default do double else enum extern false float for goto if inline int
long register restrict return short signed sizeof static struct switch true typedef union unsigned void volatile
while main memset y0 y1 yn j0 j1 jn gamma fmax fmin fabs fma pow hypot erf round trunc ceil rint div abs labs
"""
_PYTHON = """
and as assert class def del elif except finally from global import in is lambda none nonlocal not or pass raise
try with yield math zeros state check csv sys range len print min max
"""
_IEC = """
abs acos action add and andn array asin at atan bool by byte cal calc case cd concat configuration constant cos
ctd ctu ctud d date delete derivative delay average pid diffeq hysteresis ramp transfer lag1 dint div do dt
dword else elsif en eno eq exit exp expt false find for from function f_edge f_trig ge gt if insert int integral
interval jmp l ld le left len limit lint ln log lreal lt lword max mid min mod move mul mux n ne not of on or
orn p program r read_only read_write real repeat replace resource ret retain return right rol ror rs rtc r_edge
r_trig s sd sel sema shl shr sin single sint sl sqrt sr st step stn string struct sub tan task abstract any bit
class continue final implements interface internal ltime method namespace null overlap override pointer private
property protected public reference ref ref_to super this union using wstring xint then time to tod tof ton tp
transition true trunc type udint uint ulint until usint var while with word xor
"""
IEC = frozenset(_IEC.split())
"""Keywords, types, standard functions and action qualifiers of IEC 61131-3, with those of its third edition."""
RESERVED = frozenset(f"{_C}{_PYTHON}".split()) | IEC
"""In small letters."""
_PLAIN = {
    "ü": "ue", "ä": "ae", "ö": "oe", "ß": "ss", "×": "x", "·": "*", "−": "-", "–": "-", "—": "-", "…": "...",
    "≤": "<=", "≥": ">=", "²": "2", "³": "3", "°": "deg", "±": "+-", "½": "1/2", "Δ": "d", "α": "alpha", "β": "beta",
    "γ": "gamma", "δ": "delta", "ε": "epsilon", "ζ": "zeta", "η": "eta", "λ": "lambda", "σ": "sigma", "τ": "tau",
    "φ": "phi",
}  # fmt: skip


def plain_text(text: str) -> str:
    """A text in ASCII, as the oldest tools read it, that cannot begin or end a comment or a string of any language."""
    spelled = "".join(_PLAIN.get(letter, letter) for letter in text)
    plain = unicodedata.normalize("NFKD", spelled).encode("ascii", "ignore").decode()
    shown = "".join(letter if letter.isprintable() or letter == "\n" else " " for letter in plain)
    apart = re.sub(r"(?<=\*)(?=[/)])|(?<=[/(])(?=\*)", " ", shown.replace("\\", "/"))
    return apart.replace('"', "'").replace("``", "`")


def number(value: float) -> str:
    """A number with all its digits: 1e-9, not 1e-09."""
    return re.sub(r"e([-+])0", r"e\1", repr(float(value)))


def broken(line: str, breaks: str, width: int = WIDTH) -> list[str]:
    """A line that is too long as several, each after the first further in; breaks: before which words it may end."""
    if len(line) <= width:
        return [line]
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    places = [m.start() for m in re.finditer(breaks, line) if len(indent) < m.start() <= width]
    if not places:
        return [line]
    depth = {place: line[:place].count("(") - line[:place].count(")") for place in places}
    best = max(place for place in places if depth[place] == min(depth.values()))
    return [line[:best], *broken(indent + line[best:].lstrip(), breaks, width)]
