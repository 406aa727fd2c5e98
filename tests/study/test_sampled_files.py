"""Files that [sample] names: their content is part of the study, and of its folder."""

import warnings

import pytest

import fastcoil as fc
from fastcoil.study.file.spec import read_study

STUDY = """
[loop]
preset = "lbnl"
[sample]
method = "sobol"
size = 4
backlash = { csv = "measured/gaps.csv", column = "gap" }
kp = { fit = "pi.toml" }
[boundary]
kind = "constant_day"
hours = 0.5
[run]
warm_up = 60
"""


@pytest.fixture
def path(tmp_path):
    home = tmp_path / "home"
    (home / "measured").mkdir(parents=True)
    (home / "measured/gaps.csv").write_text("gap [%]\n2\n5\n7\n")
    (home / "pi.toml").write_text("[loop]\nkp = 0.02\n[fit.interval_95]\nkp = [0.01, 0.03]\n")
    (home / "study.toml").write_text(STUDY)
    return home / "study.toml"


@pytest.mark.parametrize("name", ["measured/gaps.csv", "pi.toml"])
def test_the_content_of_a_file_is_part_of_the_hash(path, name):
    before, file = read_study(path).sha256, path.parent / name
    assert read_study(path).sha256 == before
    file.write_text(file.read_text().replace("7", "8").replace("0.03", "0.04"))
    assert read_study(path).sha256 != before


@pytest.mark.kernel
def test_a_study_is_not_resumed_with_other_measurements(path, tmp_path):
    out, gaps = tmp_path / "out", path.parent / "measured/gaps.csv"
    fc.run_study(path, out, n_jobs=1)
    gaps.write_text("gap [%]\n2\n5\n8\n")
    with warnings.catch_warnings(), pytest.raises(fc.IntegrityError, match="a file that the study reads changed"):
        fc.run_study(path, out, n_jobs=1)
