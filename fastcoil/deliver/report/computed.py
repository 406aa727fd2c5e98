"""How results were computed, which versions made them, and how to cite them: all from their attributes."""

import json
import platform
import tomllib
from collections.abc import Mapping
from typing import Any

import xarray as xr

from fastcoil.base.machine import VERSION
from fastcoil.base.text import NONE
from fastcoil.deliver.report.page import Code, Section, Table, Words, facts, setting
from fastcoil.loops.labels import sizes_in_words
from fastcoil.loops.presets import NOT_THE_FIT, PRESETS
from fastcoil.loops.provenance import package_versions
from fastcoil.model.parameter_table import PARAMETERS


def how(ds: xr.Dataset) -> Section:
    """The section on how a study was computed."""
    constants, loop = json.loads(ds.attrs["parameters"]), tomllib.loads(ds.attrs["study_toml"])["loop"]
    preset = str(loop.get("preset", "paper_like"))
    substeps, noise, n = constants.get("substeps", 1), constants.get("noise_std"), ds.sizes.get("replicate", 1)
    sizes = sizes_in_words(ds["status"].sizes)
    spread = "swept" if noise is None else f"standard deviation {setting('noise_std', noise)}" if noise else "none"
    pairs = [
        ("Model", "closed loop of sensor, PI, backlash inverse, motor, valve with backlash and coil, after Cai and "
                  "Braun (2016); every scenario is a day of the loop"),
        ("Control volumes of the coil", str(constants.get("n_volumes", "swept"))),
        ("Time step", "1 s" if substeps == 1 else f"1 s, the coil in {substeps} substeps"),
        ("Preset", f"{preset}: {PRESETS[preset].text}. {NOT_THE_FIT}" if preset in PRESETS else preset),
        ("Scenarios", f"{ds['status'].size:,} = {sizes}" if sizes else "1"),
        ("Days", str(ds.attrs.get("boundary", NONE))),
        ("Left out of every metric", f"the first {ds.attrs.get('warm_up_s', NONE)} s"),
        ("Noise", f"{spread}; seed {ds.attrs.get('seed', NONE)}, {n} realisation{'s' if n > 1 else ''}"),
    ]  # fmt: skip
    if ds.attrs.get("carry_over"):
        pairs.append((
            "Between days", "each begins as the one before ended (carry_over).  Intervals over days take them as "
            "independent, which days in a row are not quite",
        ))  # fmt: skip
    own = changed(constants, preset)
    return Section("How it was computed", [facts(*pairs), *([own] if own.rows else [])])


def changed(constants: Mapping[str, Any], preset: str, against: str = "preset") -> Table:
    """The parameters that a loop gives other values than its preset; ``against``: what to call it."""
    base = PRESETS[preset if preset in PRESETS else "paper_like"]
    given = {name: value for name, value in constants.items() if value is not None}
    rows = []
    for name in base.changed(given):
        before = base.value(PARAMETERS[name]) if name in PARAMETERS else None
        what = PARAMETERS[name].text if name in PARAMETERS else "of its own rule"
        rows.append([name, setting(name, given[name]), NONE if before is None else setting(name, before), what])
    return Table(f"Parameters that differ from the {against}", ["name", "value", against, "meaning"], rows)


def versions(ds: xr.Dataset) -> Section:
    """What made the results, and their hashes."""
    packages = json.loads(ds.attrs["package_versions"])
    names = {"fastcoil": "fastcoil_version", "Python": "python_version", "Machine": "platform",
             "Run on": "date_created"}  # fmt: skip
    hashes = [f"{name}_sha256" for name in ("content", "study", "model", "boundary")]
    return Section("Versions and hashes", [facts(
        *((words, str(ds.attrs.get(name, "unknown"))) for words, name in names.items()),
        ("Packages", ", ".join(f"{name} {number}" for name, number in packages.items())),
        *((name, str(ds.attrs[name])) for name in hashes if name in ds.attrs),
    )])  # fmt: skip


def here() -> Section:
    """The versions of this installation, for a result that was not read from a file."""
    found = [f"{package} {number}" for package, number in package_versions().items()]
    pairs = [("fastcoil", VERSION), ("Python", platform.python_version()), ("Packages", ", ".join(found))]
    return Section("Versions", [facts(*pairs)])


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
"""The same as in CITATION.cff."""


def citation(results: Mapping[str, Any] | None = None) -> list[str]:
    """Plain text, a line each.

    results: the attributes of results, which are then cited with the version that made them and their hash.
    """
    lines = [
        f"{AUTHORS}. {TITLE}. Version {_version(results)}, {LICENCE} licence.",
        f"{PAPER['authors']} ({PAPER['year']}). {PAPER['title']}. {PAPER['series']}, paper {PAPER['number']}, "
        f"{PAPER['publisher']}. {PAPER['url']}",
    ]
    if results is not None:
        lines.append(
            f"Results: {results['title']}. Made with fastcoil {_version(results)}; content_sha256 "
            f"{results['content_sha256']}."
        )
    return lines


def bibtex(results: Mapping[str, Any] | None = None) -> list[str]:
    """The same as BibTeX."""
    entries = [
        _entry(
            "software", "fastcoil",
            title=f"{{{TITLE}}}", author=f"{{{AUTHORS}}}", version=_version(results), license=LICENCE,
        ),
        _entry(
            "inproceedings", "cai2016backlash",
            title=f"{{{PAPER['title']}}}", author=PAPER["authors"], year=PAPER["year"], booktitle=PAPER["series"],
            number=PAPER["number"], publisher=PAPER["publisher"], url=PAPER["url"],
        ),
    ]  # fmt: skip
    if results is not None:
        title = " ".join(str(results["title"]).split()).translate(_SPECIAL)
        entries.append(
            _entry(
                "misc", f"results{results['content_sha256'][:8]}",
                title=f"{{{title}}}", howpublished=f"Results of fastcoil {_version(results)}",
                note=rf"content\_sha256 {results['content_sha256']}",
            )
        )  # fmt: skip
    return [line for entry in entries for line in entry]


def _version(results: Mapping[str, Any] | None) -> str:
    return VERSION if results is None else str(results.get("fastcoil_version", "unknown"))


_SPECIAL = str.maketrans({
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    **{letter: f"\\{letter}" for letter in "{}$&#_%"},
})  # fmt: skip
"""What TeX would read as a command."""


def _entry(kind: str, key: str, **fields: str) -> list[str]:
    return [f"@{kind}{{{key},", *(f"  {name} = {{{value}}}," for name, value in fields.items()), "}"]


def cited(ds: xr.Dataset | None = None) -> Section:
    """How to cite the results, or fastcoil alone."""
    attrs = None if ds is None else ds.attrs
    return Section("How to cite", [Words(citation(attrs)), Code("\n".join(bibtex(attrs)))])
