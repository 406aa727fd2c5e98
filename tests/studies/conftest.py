"""The studies of the repository made small, and the tables that the scripts write."""

import re

import pytest

import fastcoil as fc
from studies import common as report

SHORT_SIZES = {r"(seed = \[\d+, \d+).*\]": r"\1]", r"hours = \d+": "hours = 2", r"size = 4096": "size = 16",
         r"size = 1024": "size = 4"}  # fmt: skip
FEW_RULES = {
    r"\n(learning_step) = \[.*": r"\n\1 = [0.007, 0.028]",
    r"\n(learning_interval) = \[.*": r"\n\1 = [900, 1800]",
    r"\n(learning_ratio) = \[.*": r"\n\1 = [1.5, 2.0]",
    r"\n(noise_std) = \[.*": r"\n\1 = [0.0, 0.1]",
    r"\n(sample_time) = \[.*": r"\n\1 = [1, 30]",
    r"\n(hold|early|stopping|paper_like_fast|lbnl) = .*": "",
}


@pytest.fixture(scope="module")
def run_small(tmp_path_factory):
    """Return a function that runs a study of the repository made small, once, in place of ``common.results``."""
    folder = tmp_path_factory.mktemp("studies")

    def run_small(name):
        text = report.study_file(name).read_text()
        for long, short in (SHORT_SIZES | FEW_RULES if name.startswith("learning") else SHORT_SIZES).items():
            text = re.sub(long, short, text)
        (folder / f"{name}.toml").write_text(text)
        return fc.run_study(folder / f"{name}.toml", folder / name).load()

    return run_small


@pytest.fixture
def weather_file(tmp_path):
    """A file with the weather of a year, whose days differ."""
    lines = [f"{h},{(h - 1) % 24 + 1},{20 + h % 7 + h // 100 % 3},12" for h in range(1, 8761)]
    path = tmp_path / "weather.csv"
    path.write_text("hour_of_year,hour,T_drybulb_C,T_dewpoint_C\n" + "\n".join(lines) + "\n")
    return path


@pytest.fixture
def read_table(monkeypatch, tmp_path):
    """Have tables written elsewhere; return a function that reads one: title, then rows of cells, head first."""
    monkeypatch.setattr(report, "OUTPUT_FOLDER", tmp_path / "studies")

    def read_table(name):
        (path,) = (tmp_path / "studies").glob(f"*/tables/{name}.md")
        title, table = path.read_text().split("\n\n")
        rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
        assert set(rows.pop(1)) == {"---"}
        assert len({len(row) for row in rows}) == 1
        return title.strip("*"), rows

    return read_table
