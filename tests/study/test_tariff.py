"""``[tariff]`` of a study: prices change no scenario, and are those of the file when it is run, opened, extended."""

import pytest
from helpers.commands import fastcoil
from helpers.refusals import assert_refused
from helpers.studies import run, write_study

import fastcoil as fc
from fastcoil.study import maintenance
from fastcoil.study.file.spec import read_study
from fastcoil.study.run import execute

WITHOUT = """
[loop]
noise_std = 0.02
[sweep]
backlash = [0.0, 0.07]
[cases.tuning]
as_found = {}
slow = { ti = 60 }
[boundary]
hours = 0.5
seed = [1, 2]
[run]
warm_up = 100
traces = ["T_sup"]
"""
TARIFF = """
[tariff]
electricity = 0.2
demand = 12
heat = 0.05
"""


@pytest.mark.kernel
def test_prices_are_those_of_the_file_whenever_it_is_run_and_nothing_is_run_again(tmp_path):
    out = tmp_path / "out"
    run(WITHOUT, out)
    before = fc.open_study(out).load()
    for text, price in ((WITHOUT + TARIFF, 0.05), (WITHOUT + TARIFF.replace("0.05", "0.5"), 0.5)):
        finished = execute(write_study(text, out), out, n_jobs=1)
        assert finished.n_run == 0
        assert maintenance.verify(out) == []
        with fc.open_study(out) as now:
            assert now.drop_attrs(deep=False).identical(before.drop_attrs(deep=False))
            assert now.attrs["study_sha256"] == before.attrs["study_sha256"]
            with pytest.warns(UserWarning, match="no dates"):
                costs = fc.cost(now)
            assert float(costs.reheat_cost.sum()) == pytest.approx(price * float(now.reheat_energy.sum()))
            with pytest.warns(UserWarning, match="no dates"):
                dear_costs = fc.cost(now, heat=1.0)
            assert float(dear_costs.reheat_cost.sum()) == pytest.approx(float(now.reheat_energy.sum()))
            assert float(dear_costs.demand_cost.sum()) == float(costs.demand_cost.sum())


@pytest.mark.kernel
def test_the_summary_says_what_backlash_costs_also_after_an_extension(tmp_path):
    out, path = tmp_path / "out", tmp_path / "study.toml"
    path.write_text(WITHOUT + TARIFF)
    output = fastcoil("run", path, "-o", out, "--no-figures").output
    assert "With a gap of 7 %: +" in output
    assert "no dates, so 30 days are a month; scaled from 2 days to a year" in output
    path.write_text(WITHOUT.replace("0.07]", "0.07, 0.12]") + TARIFF + 'baseline = { tuning = "slow" }\n')
    output = fastcoil("run", path, "-o", out, "--no-figures", "--extend").output
    assert "A loop with tuning slow costs " in output
    assert "With tuning as_found: " in output
    assert maintenance.verify(out) == []
    path.write_text(path.read_text().replace("electricity = 0.2", "electricity = 0.4"))
    second_run = fastcoil("run", path, "-o", out, "--no-figures")
    assert second_run.exit_code == 0
    assert "nothing to do" in second_run.output
    assert second_run.output != output
    assert maintenance.verify(out) == []


@pytest.mark.parametrize(
    ("tariff", "field", "code"),
    [
        (TARIFF.replace("heat = 0.05", ""), "heat", "missing"),
        (TARIFF + "copp = 3", "copp", "name"),
        (TARIFF.replace("12", "'12'"), "demand", "type"),
        (TARIFF.replace("12", "-12"), "demand", "value"),
        (TARIFF + "electric_heat = 1", "electric_heat", "type"),
        (TARIFF + "baseline = { tunning = 'slow' }", "baseline", "name"),
        (TARIFF + "baseline = { tuning = 'slo' }", "baseline", "choice"),
        (TARIFF + "baseline = { tuning = 'slow', backlash = 0.0 }", "baseline", "value"),
        (TARIFF + "baseline = { backlash = [0] }", "baseline", "choice"),
        (TARIFF + "baseline = { backlash = 0.01 }", "baseline", "choice"),
    ],
)
def test_a_wrong_tariff_is_refused_in_one_sentence(tmp_path, tariff, field, code):
    (tmp_path / "study.toml").write_text(WITHOUT + tariff)
    assert_refused(field, code, read_study, tmp_path / "study.toml")


def test_prices_do_not_change_which_study_it_is(tmp_path):
    (tmp_path / "a.toml").write_text(WITHOUT)
    (tmp_path / "b.toml").write_text(WITHOUT + TARIFF)
    assert read_study(tmp_path / "a.toml").sha256 == read_study(tmp_path / "b.toml").sha256
