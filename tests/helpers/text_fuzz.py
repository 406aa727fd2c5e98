"""Damaged study files, logs and weather files for the readers.

``python -m helpers.text_fuzz SEED COUNT FOLDER`` reads that many of each in a process of bounded memory, and prints a
line for each that was neither read nor refused in sentences.
"""

import random
import re
import resource
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from helpers.weather_years import epw, hours_from, tmy3

MAX_MEMORY_BYTES = 2**30
"""Bytes that reading one file may take."""
MAX_READ_SECONDS = 10.0  # generous for a loaded machine
MAX_SENTENCE_CHARACTERS = 1500
ROOT = Path(__file__).parents[2]
STUDIES = (
    (ROOT / "studies" / "paper" / "paper_like.toml").read_text(),
    (ROOT / "studies" / "inverse" / "valve_sensitivity.toml").read_text(),
    """title = "Größe"
[loop]
include = ["valve.toml"]
[sweep]
backlash = [0.02, 0.05, 0.07]
ti = { geomspace = [8, 80, 4] }
[run]
replicates = 2
traces = ["T_sup", "command"]
[boundary]
kind = "csv"
path = "log.csv"
hours = 0.6
units = { T_set = "degC" }
columns = { T_set = "T_set" }
""",
    """[loop]
[boundary]
kind = "weather"
path = "weather.csv"
m_a = 1.15
T_w_in = 7
T_set = 14.0
outdoor_fraction = 0.3
T_return = 24.0
RH_return = 0.5
hours = 2
days = [1]
hour = 3
columns = { RH = "RH_pct" }
""",
)
VALVE = "[loop]\nbacklash = 0.07\nm_max = 1.9\nvalve_a = 0.7\nvalve_b = 9.0\nvalve_c = 0.4\n[fit]\nkind = 'valve'\n"
LOG = "timestamp,m_a [kg/s],T_a_in [degC],RH_a_in [percent],T_w_in [degC],T_set,command,m_w [kg/s],batch\n" + "".join(
    f"2024-07-01T{8 + k // 60:02}:{k % 60:02}:00,1.{k % 9},25.{k % 7},5{k % 9},7.{k % 3},14,0.{k % 10},0.{k % 8},1\n"
    for k in range(40)
)
TIMED = "elapsed_time [s],m_a [m3/h],T_a_in [degF],W_a_in [g/kg],T_w_in [degC],T_set [degC],T_sup [degC]\n" + "".join(
    f"{60 * k},{3000 + k},7{k % 9}.5,9.{k % 10},7.1,14,1{k % 6}.2\n" for k in range(40)
)
FOREIGN = (
    "Trend report\nSite:;Berkeley\n\nZeit;m_a;T_a_in;RH_a_in;T_w_in;T_set;command;m_w;enabled;Status\n"
    ";kg/s;°C;%;°C;°C;%;l/min;;\n"
    + "".join(
        f"{1 + k // 20}.07.2024 8:{k:02};1,{k % 9};25,{k % 7};5{k % 9};7,{k % 3};14;{k % 10},5;1.20{k % 8},5;"
        f"{'On' if k % 5 else 'Off'};{{ok}}\n"
        for k in range(40)
    )
    + "\nEnd of report\n"
)
WEATHER = "hour_of_year,month,day,hour,T_drybulb_C,T_dewpoint_C,RH_pct,p_Pa\n" + "".join(
    f"{k},1,{1 + k // 24},{k % 24},{7 + k % 20},{k % 7},60,10{k % 9}000\n" for k in range(1, 60)
)
WORDS = (
    *("1e308", "-1e308", "nan", "inf", "-1", "0", "1e-320", "9" * 400, "9" * 5000, "0x" + "f" * 5000, "1_0", "1e6"),
    *("true", '""', '"x"', "", " ", "x" * 50_000, '"a\nb"', "\x00", "\x1b[2J", '"\\u202e\\u001b[2J"', "１２", "1,5"),
    *("2024-07-01", "2024-13-01", "31.02.2024", "9999-12-31", "0001-01-01T00:00:00+14:00", "1719820800000", "24:00"),
    *("1,234.5", "5.12 V", "47 %", "#N/A", "3 {down}", "On", "T_sup [" + "C" * 9000 + "]", "a" + " " * 20_000 + "b"),
    *("[]", "{}", "[" * 5000, "[" + "1, " * 20_000 + "]", "{ a = " * 300 + "1" + " }" * 300, '["T_sup", "T_sup"]'),
    *("{ linspace = [0, 1, 10000000] }", "10000000", "18446744073709551615", '"/dev/zero"', '["/dev/zero"]'),
)
"""Replacements of a word or number that are hard to read, or large."""
LINES = (
    *("a." * 20_000 + "b = 1", "[" + "a." * 20_000 + "b]", "\n".join(f"x{i} = 1" for i in range(5000))),
    *("\n".join(f"[cases.d{i}.c]\nkp = 1" for i in range(500)), '"""' + '\\"""' * 20_000, "'''" * 20_001),
    *("[[loop]]", "[[cases.tuning]]", "[run]\nreduce = 'nobody:f'", "[loop]", "," * 20_000, ";" * 20_000),
)
BYTES = (b"\0", b"\xff", b"\r", b"\n", b'"', b"'''", b"[", b"=", b",", b".", b"\\", b"\xef\xbb\xbf")
_WORD = re.compile(r"[^\s,;=\[\]{}]+|\[.*\]|\{.*\}")


def damage_bytes(data: bytes, r: random.Random) -> bytes:
    """Flip, cut out, insert, double or cut off some bytes."""
    changed = bytearray(data)
    for _ in range(r.randint(1, 8)):
        k, n = r.randrange(len(changed) + 1), r.choice([1, 2, 10, 200])
        place, new = r.choice([
            (slice(k, k + 1), bytes([r.randrange(256)])), (slice(k, k + n), b""), (slice(k, k), r.choice(BYTES)),
            (slice(k, k), changed[k : k + n]), (slice(k, None if r.random() < 0.2 else k), b""),
        ])  # fmt: skip
        changed[place] = new
    return bytes(changed)


def change_encoding(data: bytes, r: random.Random) -> bytes:
    """Save text as other programs do: other line ends, byte order marks, other encodings."""
    text = data.decode(errors="replace")
    return r.choice([
        text.replace("\n", "\r\n").encode(), text.replace("\n", "\r").encode(), b"\xef\xbb\xbf" * 2 + data,
        text.encode("utf-16"), text.encode("latin-1", "replace"), data + b"\x1a", data * 2,
    ])  # fmt: skip


def damage_words(data: bytes, r: random.Random) -> bytes:
    """Replace words and numbers; double, drop, insert or reorder lines; add many cells."""
    lines = data.decode(errors="replace").split("\n")
    for _ in range(r.randint(1, 4)):
        k, kind = r.randrange(len(lines)), r.randrange(8)
        words = [*_WORD.finditer(lines[k])]
        if kind < 4 and words:
            start, end = r.choice(words).span()
            lines[k] = lines[k][:start] + r.choice(WORDS) + lines[k][end:]
        elif kind == 4:
            lines.insert(k, r.choice(LINES if r.random() < 0.5 else lines))
        elif kind == 5:
            lines[k : k + r.choice([1, 5, 30])] = []
            lines = lines or [""]
        elif kind == 6:
            lines[1:] = r.choice([lines[:0:-1], sorted(lines[1:]), r.sample(lines[1:], len(lines) - 1)])
        else:
            lines = [line + r.choice(",;") * 200 for line in lines]
    return "\n".join(lines).encode(errors="replace")


def damage_text(data: bytes, r: random.Random) -> bytes:
    """Apply one to three kinds of damage."""
    kinds = (damage_bytes, change_encoding, *[damage_words] * 3)
    for _ in range(r.choice([1, 1, 1, 2, 3])):
        data = r.choice(kinds)(data, r)
    return data


def reading_problem(read: Callable[[], object]) -> str | None:
    """Return the problem of how a file was read, or refused; ``None`` without one."""
    from fastcoil.base.errors import InputError

    start = time.monotonic()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", RuntimeWarning)
            read()
    except InputError as error:
        longest = max(error.problems, key=len)
        if len(longest) > MAX_SENTENCE_CHARACTERS:
            return f"a sentence of {len(longest)} characters: {longest[:200]!r} … {longest[-100:]!r}"
        if not all(problem.strip() for problem in error.problems):
            return "an empty sentence"
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:300]!r}"
    duration = time.monotonic() - start
    return f"took {duration:.1f} s" if duration > MAX_READ_SECONDS else None


def main(seed: int, count: int, folder: Path) -> None:
    """Damage and read ``count`` files of each kind."""
    from fastcoil.logs import ReadingOptions, read_checked_log
    from fastcoil.logs.columns import ColumnSpec
    from fastcoil.logs.join import join_points
    from fastcoil.loops.boundary import Boundary
    from fastcoil.loops.boundary.weather import weather_day
    from fastcoil.study.file.spec import read_study

    for name, text in {"valve.toml": VALVE, "log.csv": LOG, "weather.csv": WEATHER}.items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "including.toml").write_text('[loop]\ninclude = ["valve.toml"]\n[boundary]\nhours = 1\n')
    of_valve = ColumnSpec(required=("command", "m_w"), measured=("m_w",))
    of_day = {"m_a": 1.0, "T_w_in": 7.0, "T_set": 14.0, "outdoor_fraction": 0.3, "T_return": 24.0, "RH_return": 0.5}
    columns, units, year = {"T_set": "T_set"}, {"command": "1"}, hours_from(1, 1, 59)
    strict = ReadingOptions(units=units)
    foreign = ReadingOptions(columns={"timestamp": "Zeit"}, drop=True, jumps="split")
    study, csv = folder / "damaged.toml", folder / "damaged.csv"

    def weather() -> object:
        return weather_day(csv, **of_day, hours=2, days=1, hour=3)

    kinds: list[tuple[str, str, Path, Callable[[], Any]]] = [
        *((f"study {k}", text, study, partial(read_study, study)) for k, text in enumerate(STUDIES)),
        ("include", VALVE, folder / "valve.toml", partial(read_study, folder / "including.toml")),
        ("day", LOG, csv, lambda: Boundary.from_csv(csv, units={"T_set": "degC"}, columns=columns)),
        ("day, timed", TIMED, csv, lambda: Boundary.from_csv(csv, columns=columns)),
        ("log", LOG, csv, lambda: read_checked_log(csv, of_valve, replace(strict, drop=True, jumps="split"))),
        ("log, strict", LOG, csv, lambda: read_checked_log(csv, of_valve, strict)),
        ("log, foreign", FOREIGN, csv, lambda: read_checked_log(csv, of_valve, foreign)),
        ("joined", FOREIGN, csv, lambda: join_points([csv], columns={}, units={}, time_format=None, step=None,
                                                     max_gap=None)),
        ("weather", WEATHER, csv, weather),
        ("weather, EPW", "\n".join(epw(year)), csv, weather),
        ("weather, TMY3", "\n".join(tmy3(year)), csv, weather),
    ]  # fmt: skip
    for _, text, path, read in kinds:  # whole files are read, and the libraries are there
        path.write_text(text, encoding="utf-8")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read()
    used_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used_bytes + MAX_MEMORY_BYTES, resource.getrlimit(resource.RLIMIT_AS)[1]))
    for number in range(count):
        for kind, text, path, read in kinds:
            data = damage_text(text.encode(), random.Random(f"{seed} {number} {kind}"))
            path.write_bytes(data)
            problem = reading_problem(read)
            path.write_text(text, encoding="utf-8")
            if problem is not None:
                (folder / f"bad-{seed}-{number}-{kind}").write_bytes(data)
                print(f"seed {seed}, number {number}, {kind}: {problem}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
