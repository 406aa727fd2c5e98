"""A report as data and as one HTML file without scripts or other files, and the numbers in it.

All text on it is escaped, and shown with its control characters written out.  How results were computed, which versions
made them and how to cite them is taken from their attributes.
"""

from __future__ import annotations

import base64
import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.errors import InputError
from fastcoil.base.figures import encode_figure
from fastcoil.base.files import exists, has_mark, require_output_file, write_atomically
from fastcoil.base.machine import VERSION
from fastcoil.base.text import MINUS_SIGN, MISSING_VALUE, escape_control_characters, format_count, format_number
from fastcoil.loops.labels import quantity, sizes_in_words
from fastcoil.loops.presets import NOT_THE_PAPER_FIT, PRESETS
from fastcoil.model.parameter_table import PARAMETERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MOST_ROWS = 12  # of a table along a swept parameter; results.nc has all of them


def format_significant(value: float, digits: int = 3) -> str:
    """Format a measured number with so many significant digits, without an exponent between 1e-4 and 1e7."""
    if not math.isfinite(value):
        return MISSING_VALUE
    if value == 0.0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    if abs(rounded) >= 1e7 or abs(rounded) < 1e-4:
        return f"{value:.{digits - 1}e}"
    places = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
    return (f"{rounded:,.0f}" if abs(rounded) >= 1e4 else f"{rounded:.{places}f}").replace("-", MINUS_SIGN)


def format_change(share: float) -> str:
    """Format a relative difference: ``−43 %``."""
    return f"{format_number(100.0 * share, 0, sign=True)} %" if math.isfinite(share) else MISSING_VALUE


def format_change_range(low: float, high: float) -> str:
    """Format an interval of relative differences."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return MISSING_VALUE
    return f"{format_change(low).removesuffix(' %')} to {format_change(high)}"


def format_parameter(name: str, value: object) -> str:
    """Format the value of a parameter with its unit: ``7 %``, ``0.03 1/K``, ``cooling``."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    display = quantity(name)
    entry = PARAMETERS.get(name)
    if display.factor == 1.0 and entry is not None and entry.whole:
        return str(int(value))
    return f"{value * display.factor:.6g} {display.unit}".rstrip()


def select_rows(n: int, keep: tuple[int, ...] = (), most: int = MOST_ROWS) -> list[int]:
    """Select rows of ``n``: all, up to four more than ``most``; else evenly spaced ones and those to ``keep``."""
    if n <= most + 4:
        return list(range(n))
    return sorted({*np.linspace(0, n - 1, most - len(keep)).round().astype(int).tolist(), *keep})


def omission_note(n: int, n_shown: int, noun: str) -> str:
    """Return a note on rows that are not shown; empty if all are."""
    return "" if n_shown == n else f"{n_shown} of {n:,} {noun} are shown; all of them are in results.nc."


_REPORT_MARK = b'<meta name="generator" content="fastcoil '


class Paragraphs(NamedTuple):
    """Paragraphs, or with ``bullets`` the items of a list."""

    lines: Sequence[str]
    bullets: bool = False


class Table(NamedTuple):
    """A table of texts whose first column names the row; note: omissions, and meanings of the columns."""

    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""

    @property
    def sides(self) -> list[str]:
        """Style class of each column: empty for numbers, which are aligned right, or ``words``, aligned left."""
        columns = list(zip(*self.rows, strict=True)) or [()] * len(self.head)
        has_words = [any(c[:1].isalpha() and c not in ("baseline", "never", "yes", "no") for c in cs) for cs in columns]
        return ["words" if has else "" for has in has_words]


def facts_table(*pairs: tuple[str, str]) -> Table:
    """Return a table of names and values, a row each."""
    return Table("", (), pairs)


class Picture(NamedTuple):
    """A PNG; caption: meaning of its dots, lines and bands; alt: text in place of the picture; file: its path."""

    png: bytes
    caption: str
    alt: str
    file: str = ""

    @property
    def data_url(self) -> str:
        return "data:image/png;base64," + base64.b64encode(self.png).decode()


class Code(NamedTuple):
    """Preformatted text."""

    text: str

    @property
    def lines(self) -> list[str]:
        return self.text.rstrip("\n").replace("\r\n", "\n").split("\n")


Block = Paragraphs | Table | Picture | Code


class Section(NamedTuple):
    """A heading and its blocks."""

    title: str
    blocks: Sequence[Block]


class Page(NamedTuple):
    """A report."""

    label: str  # kind of report
    title: str
    question: str
    warnings: Sequence[str]  # printed before the answer
    answer: Sequence[str]  # sentences, the most important first
    sections: Sequence[Section]
    origin: str = ""  # SHA-256 of the results

    def html(self) -> str:
        from jinja2 import Environment, PackageLoader, StrictUndefined

        environment = Environment(
            loader=PackageLoader("fastcoil.deliver.report"), autoescape=True, undefined=StrictUndefined,
            finalize=lambda value: escape_control_characters(value) if type(value) is str else value,  # not markup
            trim_blocks=True, lstrip_blocks=True,
        )  # fmt: skip
        sections = [section for section in self.sections if section.blocks]
        return environment.get_template("page.html").render(page=self, sections=sections, version=VERSION)

    def write(self, path: Path) -> Path:
        write_atomically(path, self.html().encode())
        return path


def require_page(path: Path, option: str = "path") -> None:
    """Refuse, before any work, a path that cannot be written, or that holds anything but an earlier report."""
    require_output_file(option, path, ".html", ".htm")
    if exists(path) and not has_mark(path, _REPORT_MARK):
        raise InputError(f"{option} {path}: this file exists and is not a report: choose another name", option, "path")


def make_picture(figure: Figure, caption: str, alt: str) -> Picture:
    """Encode a figure as a picture, without its title, which the page has as text."""
    figure.suptitle("")
    return Picture(encode_figure(figure, "png", 200), caption, alt)  # dpi for print on A4


def method_section(ds: xr.Dataset) -> Section:
    """Return the section on the model, the days and the parameters of a study."""
    constants, loop = json.loads(ds.attrs["parameters"]), tomllib.loads(ds.attrs["study_toml"])["loop"]
    substeps, noise, n = constants.get("substeps", 1), constants.get("noise_std"), ds.sizes.get("replicate", 1)
    sizes, plant = sizes_in_words(ds["status"].sizes), constants.get("plant", "its plant")
    preset = str(loop.get("preset", "paper_like" if plant == "coil" else MISSING_VALUE))
    noise_text = f"standard deviation {format_parameter('noise_std', noise)}" if noise else "none"
    noise_text = "swept" if noise is None else noise_text
    facts = [
        ("Model", f"closed loop of sensor, PI, backlash inverse, motor, valve with backlash and {plant}, after Cai and "
                  "Braun (2016); every scenario is a day of the loop"),
        ("Control volumes of the coil", str(constants.get("n_volumes", "swept")) if plant == "coil" else MISSING_VALUE),
        ("Time step", "1 s" if substeps == 1 else f"1 s, the coil in {substeps} substeps"),
        ("Preset", f"{preset}: {PRESETS[preset].text}. {NOT_THE_PAPER_FIT}" if preset in PRESETS else preset),
        ("Scenarios", f"{ds['status'].size:,} = {sizes}" if sizes else "1"),
        ("Days", str(ds.attrs.get("boundary", MISSING_VALUE))),
        ("Left out of every metric", f"the first {ds.attrs.get('warm_up_s', MISSING_VALUE)} s"),
        ("Noise", f"{noise_text}; seed {ds.attrs.get('seed', MISSING_VALUE)}, {format_count(n, 'realisation')}"),
    ]  # fmt: skip
    if ds.attrs.get("carry_over"):
        facts.append((
            "Between days", "each begins as the one before ended (carry_over).  Intervals over days take them as "
            "independent, which days in a row are not quite",
        ))  # fmt: skip
    parameter_table = changed_parameters(constants, preset)
    return Section("How it was computed", [facts_table(*facts), *([parameter_table] if parameter_table.rows else [])])


def changed_parameters(constants: Mapping[str, Any], preset: str, against: str = "preset") -> Table:
    """Return a table of the parameters whose values differ from those of a preset; ``against``: its name."""
    base_preset = PRESETS[preset if preset in PRESETS else "paper_like"]
    values = {name: value for name, value in constants.items() if value is not None}
    rows = []
    for name in base_preset.changed_names(values):
        preset_value = base_preset.value(PARAMETERS[name]) if name in PARAMETERS else None
        preset_text = MISSING_VALUE if preset_value is None else format_parameter(name, preset_value)
        meaning = PARAMETERS[name].text if name in PARAMETERS else "parameter of the user's rule"
        rows.append([name, format_parameter(name, values[name]), preset_text, meaning])
    return Table(f"Parameters that differ from the {against}", ["name", "value", against, "meaning"], rows)


def versions_section(attrs: Mapping[str, Any]) -> Section:
    """Return the section on the versions that made the results with these attributes, and on their hashes."""
    labels = [("fastcoil_version", "fastcoil"), ("python_version", "Python"), ("platform", "Machine"),
              ("date_created", "Run on")]  # fmt: skip
    facts = [(label, str(attrs[name])) for name, label in labels if name in attrs]
    packages = json.loads(attrs["package_versions"]).items()
    facts.append(("Packages", ", ".join(f"{name} {number}" for name, number in packages)))
    hashes = [f"{name}_sha256" for name in ("content", "study", "model", "boundary")]
    facts += [(name, str(attrs[name])) for name in hashes if name in attrs]
    return Section("Versions and hashes", [facts_table(*facts)])


TITLE = "fastcoil: closed-loop emulation of HVAC coil valves with backlash"
AUTHORS = "The fastcoil authors"
LICENCE = "MIT"
PAPER: Mapping[str, str] = {
    "title": "Self-learning Backlash Inverse Control of Cooling or Heating Coil Valves Having Backlash Hysteresis",
    "authors": "Cai, Jie and Braun, James E.",
    "year": "2016",
    "series": "International Refrigeration and Air Conditioning Conference",
    "number": "1801",
    "publisher": "Purdue e-Pubs",
    "url": "https://docs.lib.purdue.edu/iracc/1801",
}
"""Citation of the paper, as in CITATION.cff."""


def citation(results: Mapping[str, Any] | None = None) -> list[str]:
    """Return citations as plain text, a line each; with attributes of results, also their version and hash."""
    version = VERSION if results is None else str(results.get("fastcoil_version", "unknown"))
    lines = [
        f"{AUTHORS}. {TITLE}. Version {version}, {LICENCE} licence.",
        f"{PAPER['authors']} ({PAPER['year']}). {PAPER['title']}. {PAPER['series']}, paper {PAPER['number']}, "
        f"{PAPER['publisher']}. {PAPER['url']}",
    ]
    if results is not None:
        made_with = f"Made with fastcoil {version}; content_sha256 {results['content_sha256']}."
        lines.append(f"Results: {results['title']}. {made_with}")
    return lines


def citation_section(ds: xr.Dataset | None = None) -> Section:
    """Return the section on how to cite the results, or fastcoil alone."""
    return Section("How to cite", [Paragraphs(citation(None if ds is None else ds.attrs))])
