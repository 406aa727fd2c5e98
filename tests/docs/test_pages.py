"""README and the pages of ``docs/``: what they show runs, and their commands, links and file names lead somewhere."""

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import fastcoil as fc
from fastcoil.cli.main import main
from fastcoil.model.metric_table import METRICS
from fastcoil.study.file.spec import read_study
from studies.__main__ import questions

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md")), *sorted(ROOT.glob("docs/findings/*.md"))]
PAGES += [ROOT / "studies" / "README.md", ROOT / "benchmarks" / "README.md"]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
SPAN = re.compile(r"`([^`\n]+)`")
PATH = re.compile(r"`((?:docs|studies|benchmarks|fastcoil|tests)/[\w./-]+)`")
SCRIPTS = {"logs.py", "controller.py"}
"""Scripts that the reader makes, or that a command of the page writes."""
TOOLS = {"pytest", "pip", "dask", "."}
LONG_COMMANDS = [["fit", "coil"], ["tune", "ahu.toml"]]
"""Commands that take seconds: `make test` runs a page up to them, `make test-full` to its end."""
HEAVY_IMPORT = "import arviz"
"""Begins a block that loads libraries for seconds, and calls nothing of fastcoil: `make test-full` runs it."""
DEMO_COMMAND = ["demo"]
"""Shown in tests/cli/test_first_minutes.py; nothing on a page needs what it leaves."""


def is_named(path):
    return str(path.relative_to(ROOT))


def blocks(page, *kinds):
    """(kind, text) of the fenced blocks of a page."""
    return [(kind, text) for kind, text in FENCE.findall(page.read_text()) if not kinds or kind in kinds]


def prose(page):
    """A page without its fenced blocks."""
    return FENCE.sub("", page.read_text())


def commands(text):
    """The commands of a block, word by word."""
    for line in text.splitlines():
        words = shlex.split(line.removesuffix("&"), comments=True)
        if words:
            yield [words[0].removeprefix(".venv/bin/"), *words[1:]]


def line_matches(line, expected):
    """Whether a printed line is the one shown, but for numbers that another CPU or library may round otherwise."""
    if "".join(NUMBER.sub("0", line).split()) != "".join(NUMBER.sub("0", expected).split()):
        return False
    numbers, expected_numbers = (NUMBER.findall(text) for text in (line, expected))
    return all(
        float(number) == pytest.approx(float(shown), rel=0.03, abs=1.01 * last_place(shown))
        for number, shown in zip(numbers, expected_numbers, strict=True)
    )


def last_place(number):
    """The value of one in the last digit of a number in text."""
    digits, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))


PAGES_WITH_PYTHON = [page for page in PAGES if blocks(page, "python")]


@pytest.mark.kernel
@pytest.mark.usefixtures("blank_figures")
@pytest.mark.parametrize("page", PAGES_WITH_PYTHON, ids=is_named)
def test_a_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch, capsys):
    """Its Python, its study files and the commands on them; and what it says they print is printed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    names, printed = {"__name__": page.stem}, ""
    for kind, text in blocks(page):
        if kind == "console" and is_named(page) != "docs/hand-over.md":
            continue  # named in test_blocks
        if kind == "python" and text.startswith(HEAVY_IMPORT) and not os.environ.get("FASTCOIL_FULL"):
            printed = None
        elif kind == "python":
            if saved := re.match(r"# (\w+\.py)\n", text):
                Path(saved[1]).write_text(text)
            exec(compile(text, page.name, "exec"), names)
            printed = capsys.readouterr().out
        elif kind == "toml":
            path = Path(re.match(r"# (\w+\.toml)\n", text)[1])
            path.write_text(text)
            read_study(path)
        elif kind == "sh":
            for program, *words in commands(text):
                if words[:2] in LONG_COMMANDS and not os.environ.get("FASTCOIL_FULL"):
                    return
                if program == "fastcoil" and words != DEMO_COMMAND:
                    result = CliRunner().invoke(main, words)
                    assert result.exit_code == 0, (words, result.output)
                    printed = result.output
        elif kind == "console" and shutil.which("gcc"):
            for line in text.splitlines():
                program, *words = shlex.split(line.removeprefix("$ "))
                subprocess.run([sys.executable if program == "python" else program, *words], check=True, timeout=60)
        elif kind == "text" and printed is not None:
            for expected in text.splitlines():
                assert expected == "…" or any(line_matches(line, expected) for line in printed.splitlines()), printed


def test_the_readme_shows_the_script_of_the_first_look():
    script = (ROOT / "studies" / "first_look" / "first_look.py").read_text()
    docstring = ast.parse(script).body[0]
    code = "\n".join(script.splitlines()[docstring.end_lineno :]).strip()
    _, readme_code = blocks(ROOT / "README.md", "python")[0]
    assert readme_code.strip() == code


def test_the_readme_shows_what_the_page_on_diagnosis_prints():
    ((_, console),) = blocks(ROOT / "README.md", "console")
    command, *lines = console.strip().splitlines()
    page = ROOT / "docs" / "logs.md"
    assert command.removeprefix("$ ") in blocks(page, "sh")[0][1]
    assert set(lines) <= set(blocks(page, "text")[0][1].splitlines())


def test_the_readme_counts_the_days_and_tunings_of_the_main_study():
    plan = read_study(ROOT / "studies" / "robustness" / "robustness.toml").plan
    readme = " ".join((ROOT / "README.md").read_text().split())
    assert f"{plan.n_scenarios:,} days: backlash × estimate × {plan.layout.sizes['tuning']} tunings" in readme


def test_every_metric_is_in_the_table_of_metrics():
    page = (ROOT / "docs" / "studies.md").read_text().split("| metric | meaning |")[1].split("\n\n")[0]
    assert set(re.findall(r"`(\w+)`", page.replace("`hagglund`", ""))) == set(METRICS)


def test_the_speeds_that_are_quoted_are_measured():
    """README and promises give what RESULTS.md, written by ``make bench``, has."""
    results = (ROOT / "benchmarks" / "RESULTS.md").read_text()
    peers, fits = results.split("## Kernel")[0], results.split("## Every benchmark")[1]

    def ns(name):
        """ns per lane-step on one thread at sample times of 30 s and of 1 s."""
        slow, fast = re.findall(rf"^\| {name} \| 1 \| ([\d.]+) ", peers, re.MULTILINE)
        return float(slow), float(fast)

    def words(name, form="{:.0f}"):
        """The two ratios to fastcoil, the lower one first."""
        return " to ".join(form.format(r) for r in sorted(a / b for a, b in zip(ns(name), kernel, strict=True)))

    def seconds(name):
        return float(re.search(rf"^\| fit: {name} \|.*?\| ([\d.]+) \(", fits, re.MULTILINE)[1])

    kernel = ns("fastcoil, kernel")
    readme, promises = ((ROOT / page).read_text() for page in ("README.md", "docs/promises.md"))
    assert f"One thread needs {kernel[0]} ns" in readme
    assert f"| {kernel[0]} ns at a sample time of 30 s, {kernel[1]} ns at 1 s |" in promises
    assert f"| against scalar Numba | {words('scalar Numba')} times faster |" in promises
    assert f"| against NumPy | {words('NumPy')} times faster |" in promises
    slower = {f"{float(r):.1f}" for r in re.findall(r"^\| fastcoil, kernel \| 1 .*\| ([\d.]+) \(", peers, re.MULTILINE)}
    assert f"with the same metrics | {' to '.join(sorted(slower))} times slower |" in promises
    assert f"| fit of a valve | {seconds('valve'):.1f} s |" in promises
    assert f"| fit of a coil to 8 h of seconds | {seconds('coil_on_seconds'):.1f} s |" in promises


def command_problem(program, words, targets):
    """What is wrong with a command, or None."""
    if program == "make":
        return None if words and words[0] in targets else f"make has no {words}"
    if (program, *words[:2]) == ("python", "-m", "studies"):
        return None if set(words[2:]) <= {*questions(), "NAME", "--all", "--sample"} else f"no study {words[2:]}"
    if program == "python":
        return None if words[0] in SCRIPTS or (ROOT / words[0]).is_file() else f"no {words[0]}"
    if program != "fastcoil":
        return None if program in TOOLS else f"{program} is unknown"
    command, words = main, list(words)
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        name = words.pop(0)
        command = command.commands.get(name)
        if command is None:
            return f"fastcoil has no {name}"
    options = {option for p in command.params for option in (*p.opts, *p.secondary_opts)} | {"--help", "--version"}
    unknown = [w for w in words if w.startswith("-") and w.partition("=")[0] not in options]
    return f"{command.name} has no {unknown}" if unknown else None


@pytest.mark.parametrize("page", PAGES, ids=is_named)
def test_every_command_exists(page):
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    all_commands = [words for _, text in blocks(page, "sh") for words in commands(text)]
    spans = [span for span in SPAN.findall(prose(page)) if re.match(r"(\.venv/bin/)?(fastcoil|make|python) ", span)]
    all_commands += [words for span in spans for words in commands(span.partition(">")[0])]
    assert not [p for program, *words in all_commands if (p := command_problem(program, words, targets))]


@pytest.mark.parametrize("page", PAGES, ids=is_named)
def test_every_name_of_the_library_and_every_path_of_the_repository_exists(page):
    names = set(re.findall(r"`fc\.(\w+)", prose(page)))
    assert not {name for name in names if not hasattr(fc, name)}
    assert [path for path in PATH.findall(prose(page)) if not (ROOT / path).exists()] == []


def anchors(page):
    """Anchors of the headings of a page, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=is_named)
def test_every_link_leads_somewhere(page):
    text = prose(page)
    targets = [*re.findall(r"\]\(([^)\s]+)\)", text), *re.findall(r"^\[[^\]]+\]: (\S+)$", text, re.MULTILINE)]
    assert not set(re.findall(r"\]\[([^\]]+)\]", text)) - set(re.findall(r"^\[([^\]]+)\]: ", text, re.MULTILINE))
    for target in targets:
        if not target.startswith("https://"):
            path, _, anchor = target.partition("#")
            target_page = (page.parent / path).resolve() if path else page
            assert target_page.exists(), target
            assert not anchor or anchor in anchors(target_page), target


def test_every_page_can_be_reached_from_the_index():
    index = (ROOT / "docs" / "index.md").read_text()
    docs = ROOT / "docs"
    pages = {path.relative_to(docs).as_posix() for path in [*docs.glob("*.md"), *docs.glob("findings/*.md")]}
    assert pages - {"index.md"} <= set(re.findall(r"\]\(([\w/-]+\.md)\)", index))
