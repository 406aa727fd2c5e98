"""The example of ``docs/own-rule.md`` fits the sources, and works."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fastcoil as fc

PACKAGE = Path(fc.__file__).parent
PAGE = PACKAGE.parent / "docs" / "own-rule.md"


@pytest.fixture
def extended_package(tmp_path):
    """A copy of the package with the slow output of the page."""
    shutil.copytree(PACKAGE, tmp_path / "fastcoil", ignore=shutil.ignore_patterns("__pycache__"))
    diffs = re.findall(r"^```diff\n\+\+\+ (\S+)\n(.*?)^```$", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert len(diffs) == 3
    for name, diff in diffs:
        lines = [(line[:1], line[1:]) for line in diff.splitlines()]
        old = "".join(f"{text}\n" for sign, text in lines if sign != "+")
        new = "".join(f"{text}\n" for sign, text in lines if sign != "-")
        path = tmp_path / name
        assert path.read_text().count(old) == 1, f"{name} has changed: change docs/own-rule.md with it"
        path.write_text(path.read_text().replace(old, new))
    return tmp_path


def run(folder, code):
    environment = os.environ | {"PYTHONPATH": str(folder), "XDG_CACHE_HOME": str(folder)}
    return subprocess.check_output([sys.executable, "-c", code], cwd=folder, env=environment, text=True)


def test_the_example_fits_the_sources(extended_package):
    code = (
        "import fastcoil as fc; from fastcoil.model.control import limit_rate;"
        "print(fc.Loop(output_rate=0.001)['output_rate']);"
        "print(*(limit_rate(u, 0.5, 0.1) for u in (0.2, 0.45, 0.9)), limit_rate(0.9, 0.5, 0.0))"
    )
    assert run(extended_package, code).split() == ["0.001", "0.4", "0.45", "0.6", "0.9"]


@pytest.mark.full
@pytest.mark.kernel
def test_the_example_works(extended_package):
    """The output moves no faster; a rate of 0 changes no bit."""
    code = (
        "import fastcoil as fc; loop = fc.Loop.preset('lbnl').assign(output_rate=[0.0, 0.0005], noise_std=0.02);"
        "ds = fc.simulate(loop, fc.paper_day(hours=2), traces=['u']);"
        "print(*abs(ds.u.diff('elapsed_time')).max('elapsed_time').values, *ds.rmse.values)"
    )
    fastest, slow, rmse, _ = map(float, run(extended_package, code).split())
    ds = fc.simulate(fc.Loop.preset("lbnl").assign(noise_std=0.02), fc.paper_day(hours=2), traces=["u"])
    assert (fastest, rmse) == (float(abs(ds.u.diff("elapsed_time")).max()), float(ds.rmse))
    assert slow == pytest.approx(0.0005 * 15.0)
    assert slow < 0.5 * fastest
