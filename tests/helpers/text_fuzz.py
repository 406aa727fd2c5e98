"""Damaged study files, logs and weather files, and what the readers make of them.

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
from functools import partial
from pathlib import Path
from typing import Any

from helpers.fuzz_seeds import CELLS, FOREIGN, LINES, LOG, STUDIES, TIMED, VALUES, VALVE, WEATHER
from helpers.weather_years import epw, hours_from, tmy3

MEMORY = 2**30
"""Bytes that reading one file may take."""
SECONDS = 10.0
"""So long takes none, even on a machine that does other things."""
LONGEST_SENTENCE = 1500


BYTES = [b"\0", b"\xff", b"\r", b"\n", b'"', b"'''", b"[", b"=", b",", b".", b"\\", b"\xef\xbb\xbf"]


def bytes_changed(data: bytes, r: random.Random) -> bytes:
    """Some bytes flipped, cut out, put in, doubled or cut off."""
    changed = bytearray(data)
    for _ in range(r.randint(1, 8)):
        k, n = r.randrange(len(changed) + 1), r.choice([1, 2, 10, 200])
        place, new = r.choice([
            (slice(k, k + 1), bytes([r.randrange(256)])), (slice(k, k + n), b""), (slice(k, k), r.choice(BYTES)),
            (slice(k, k), changed[k : k + n]), (slice(k, None if r.random() < 0.2 else k), b""),
        ])  # fmt: skip
        changed[place] = new
    return bytes(changed)


def text_wrapped(data: bytes, r: random.Random) -> bytes:
    """As other programs save text: other line ends, byte order marks, other encodings, lines in another order."""
    text = data.decode()
    lines = text.splitlines(keepends=True)
    return r.choice([
        text.replace("\n", "\r\n").encode(), text.replace("\n", "\r").encode(), b"\xef\xbb\xbf" * 2 + data,
        text.encode("utf-16"), text.encode("latin-1", "replace"), data + b"\x1a", data * 2,
        "".join(r.sample(lines, len(lines))).encode(), data.replace(b"\n", b"\n\0"),
    ])  # fmt: skip


def study_token(data: bytes, r: random.Random) -> bytes:
    """A value replaced, a line doubled, lost or put in: of the forms that take long to parse, too."""
    lines = data.decode().split("\n")
    k, kind = r.randrange(len(lines)), r.randrange(6)
    if kind <= 2:
        k = r.choice([i for i, line in enumerate(lines) if "=" in line])
        numbers = [*re.finditer(r"(?<![\w.])-?\d[\d.]*|\"[^\"]*\"", lines[k])]
        start, end = r.choice(numbers).span() if kind and numbers else (lines[k].index("=") + 1, len(lines[k]))
        lines[k] = lines[k][:start] + r.choice(VALUES) + lines[k][end:]
    elif kind == 3:
        lines.insert(k, r.choice(lines))
    elif kind == 4:
        del lines[k]
    else:
        lines.insert(k, r.choice(LINES))
    return "\n".join(lines).encode()


def log_token(data: bytes, r: random.Random, separator: str = ",") -> bytes:
    """Cells replaced, columns swapped, doubled or left out, rows moved, the time scaled, thousands of columns."""
    rows = [line.split(separator) for line in data.decode().splitlines()]
    (header, *body), kind, i, j = rows, r.randrange(8), r.randrange(len(rows[0])), r.randrange(len(rows[0]))
    if kind <= 1:
        for _ in range(r.randint(1, 5)):
            r.choice(rows)[r.randrange(len(header))] = r.choice(CELLS)
    elif kind == 2:
        for row in rows[r.randrange(2) :]:
            row[i], row[j] = row[j], row[i]
    elif kind == 3:
        rows = [row[:i] + row[i + 1 :] if r.random() < 0.5 else row + row[i : i + 1] for row in rows]
    elif kind == 4:
        factor = r.choice([1e6, 1e300, 1e-6, -1, 0])
        rows = [header, *([scaled(row[0], factor), *row[1:]] for row in body)]
    elif kind == 5:
        rows = [
            header,
            *r.choice([body[::-1], sorted(body), body + body[:5], body[:1] * 30, r.sample(body, len(body))]),
        ]
    elif kind == 6:
        n = r.choice([200, 20_000])
        wide = [[f"c{k}" for k in range(n)], *[["1"] * n] * 4]
        rows = wide if r.random() < 0.5 else [header + ["1"] * n, *body]
    else:
        header[i] = r.choice(["x" * 50_000, "T_sup [" + "C" * 9000 + "]", "a" + " " * 20_000 + "b", "\x1b[2J"])
    return "\n".join(map(separator.join, rows)).encode()


def scaled(cell: str, factor: float) -> str:
    """A number times the factor; an hour of it for what is none."""
    try:
        return f"{float(cell) * factor}"
    except ValueError:
        return str(3600 * factor)


def damaged(data: bytes, r: random.Random, tokens: Callable[[bytes, random.Random], bytes]) -> bytes:
    """The bytes with one to three kinds of damage."""
    for _ in range(r.choice([1, 1, 1, 2, 3])):
        try:
            data = r.choice([bytes_changed, text_wrapped, tokens, tokens, tokens])(data, r) if data else b""
        except (UnicodeDecodeError, IndexError):
            data = bytes_changed(data, r)
    return data


def complaint(read: Callable[[], object]) -> str | None:
    """What is wrong with how a file was read, or refused; ``None`` if nothing is."""
    from fastcoil.base.errors import InputError

    start = time.monotonic()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", RuntimeWarning)
            read()
    except InputError as error:
        longest = max(error.problems, key=len)
        if len(longest) > LONGEST_SENTENCE:
            return f"a sentence of {len(longest)} characters: {longest[:200]!r} … {longest[-100:]!r}"
        if not all(problem.strip() for problem in error.problems):
            return "an empty sentence"
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:300]!r}"
    took = time.monotonic() - start
    return f"took {took:.1f} s" if took > SECONDS else None


def limit_memory() -> None:
    """Let this process take no more than ``MEMORY`` in addition to what it has."""
    has = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (has + MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))


def main(seed: int, count: int, folder: Path) -> None:
    """Damage and read ``count`` files of each kind."""
    from fastcoil.logs import Reading, read_log
    from fastcoil.logs.columns import Wanted
    from fastcoil.logs.join import join_points
    from fastcoil.loops.boundary import Boundary
    from fastcoil.loops.boundary.weather import weather_day
    from fastcoil.study.file.spec import read_study

    whole = {"valve.toml": VALVE, "log.csv": LOG, "weather.csv": WEATHER}
    for name, text in whole.items():
        (folder / name).write_text(text, encoding="utf-8")
    paths = {name: folder / name for name in ("study.toml", "damaged.toml", "damaged.csv")}
    of_valve = Wanted(needed=("command", "m_w"), measured=("m_w",))
    of_day = {"m_a": 1.0, "T_w_in": 7.0, "T_set": 14.0, "outdoor_fraction": 0.3, "T_return": 24.0, "RH_return": 0.5}

    year = hours_from(1, 1, 59)

    def include() -> object:
        paths["study.toml"].write_text('[loop]\ninclude = ["damaged.toml"]\n[boundary]\nhours = 1\n')
        return read_study(paths["study.toml"])

    def csv(read: Callable[..., object], *args: Any, **options: Any) -> Callable[[], object]:
        return partial(read, paths["damaged.csv"], *args, **options)

    whose = {"columns": {"T_set": "T_set"}}
    unit = {"units": {"command": "1"}}
    foreign = {"columns": {"timestamp": "Zeit"}, "drop": True, "jumps": "split"}
    foreign_token = partial(log_token, separator=";")

    def join() -> object:
        return join_points([paths["damaged.csv"]], columns={}, units={}, time_format=None, step=None, max_gap=None)

    kinds: list[tuple[str, str, str, Callable[..., bytes], Callable[[], object]]] = [
        *(
            (f"study {k}", text, "study.toml", study_token, lambda: read_study(paths["study.toml"]))
            for k, text in enumerate(STUDIES)
        ),
        ("include", VALVE, "damaged.toml", study_token, include),
        ("day", LOG, "damaged.csv", log_token, csv(Boundary.from_csv, units={"T_set": "degC"}, **whose)),
        ("day, timed", TIMED, "damaged.csv", log_token, csv(Boundary.from_csv, **whose)),
        ("log", LOG, "damaged.csv", log_token, csv(read_log, of_valve, Reading(drop=True, jumps="split", **unit))),
        ("log, strict", LOG, "damaged.csv", log_token, csv(read_log, of_valve, Reading(**unit))),
        ("log, foreign", FOREIGN, "damaged.csv", foreign_token, csv(read_log, of_valve, Reading(**foreign))),
        ("joined", FOREIGN, "damaged.csv", foreign_token, join),
        *(
            (f"weather{form}", text, "damaged.csv", log_token, csv(weather_day, **of_day, hours=2, start_hour=3))
            for form, text in (("", WEATHER), (", EPW", "\n".join(epw(year))), (", TMY3", "\n".join(tmy3(year))))
        ),
    ]
    for _, text, name, _, read in kinds:  # whole files are read, and the libraries are there
        (folder / name).write_text(text, encoding="utf-8")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read()
    limit_memory()
    for number in range(count):
        for kind, text, name, tokens, read in kinds:
            r = random.Random(f"{seed} {number} {kind}")
            data = damaged(text.encode(), r, tokens)
            (folder / name).write_bytes(data)
            if (said := complaint(read)) is not None:
                (folder / f"bad-{seed}-{number}-{kind}").write_bytes(data)
                print(f"seed {seed}, number {number}, {kind}: {said}", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
