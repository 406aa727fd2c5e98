"""fit_coil: known coils are found within the stated intervals; parameters that the data do not identify are held."""

import tomllib

import numpy as np
import pytest
from helpers.figure_looks import assert_palette, assert_texts_fit
from helpers.shared_data import measured_file
from helpers.simulated_logs import COIL_TRUTH, assert_covered, coil_log

import fastcoil as fc
from fastcoil.measured.fit import AT_BOUND
from fastcoil.measured.fit_coil import BETA2, COIL_PARAMETERS, CoilProblem

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize(
    ("phi", "seed"),
    [pytest.param(0.0, 1, marks=pytest.mark.full), pytest.param(0.0, 2, marks=pytest.mark.full), (0.99, 3)],
)
def test_known_coils_with_white_and_autocorrelated_noise_are_found_within_the_intervals(phi, seed):
    fit = fc.fit_coil(coil_log(hours=2, seed=seed, phi=phi), split=1.0)
    assert fit.held.keys() <= {"C_w"}  # which may end where the scheme is just stable
    assert_covered(fit)
    assert (fit.n_effective < 0.1 * fit.n_used) == (phi > 0.5)
    assert fc.Loop().assign(**fit.parameters)["air_march"] == "quasistatic"


@pytest.mark.usefixtures("all_starts")
def test_validation_is_as_good_as_the_noise_and_the_leaving_water_comes_out_too():
    fit = fc.fit_coil(coil_log(hours=1.5, seed=4, sd=0.1))
    assert fit.rmse["fit"] == pytest.approx(0.1, rel=0.05)
    assert fit.rmse["validation"] == pytest.approx(0.1, rel=0.05)
    assert fit.rmse["validation_T_w_out"] < 0.1
    part = fit.residuals["part"].values.tolist()
    assert part == ["unused"] * 1800 + ["fit"] * 1980 + ["validation"] * 1620


@pytest.mark.usefixtures("all_starts")
def test_a_value_at_1_kg_s_is_as_uncertain_as_the_exponent_that_carries_it_there():
    """Of too few wet samples β6 is taken from β4, with its uncertainty: β5 alone would be known to 5 % better."""
    day, command = fc.paper_day(hours=1, seed=5), np.repeat(np.random.default_rng(2).uniform(0.1, 0.9, 30), 120)
    traces = fc.simulate(fc.Loop(backlash=0.09), day, command=command, traces=["m_w", "T_sup", "T_w_out"], warm_up=0)
    entering = day.to_dataset().drop_vars(["noise", "enabled", "day"])
    log = traces[["m_w", "T_sup", "T_w_out"]].merge(entering).isel(elapsed_time=slice(None, None, 10))
    fit = fc.fit_coil(log.reset_coords(drop=True), warm_up=600, air_march="lagged")
    assert "beta6" in fit.held
    assert fit.intervals["beta5"] == pytest.approx((0.52159, 0.63853), rel=1e-4)


@pytest.mark.full
def test_intervals_of_95_per_cent_cover_the_truth_that_often():
    """100 logs of 2 h, half with AR(1) noise: at least 88 % of the intervals of each parameter hold the truth."""
    hits = {name: [0, 0] for name in COIL_PARAMETERS}
    for seed in range(100):
        fit = fc.fit_coil(coil_log(hours=2, seed=100 + seed, phi=0.95 * (seed % 2)), split=1.0)
        for name, (low, high) in fit.intervals.items():
            hits[name][0] += low <= COIL_TRUTH[name] <= high
            hits[name][1] += 1
    assert all(inside >= 0.88 * n for inside, n in hits.values()), hits
    assert min(n for _, n in hits.values()) > 40


def test_a_heat_capacity_at_the_limit_of_stability_is_an_answer_and_no_prior():
    """A coil of less water than a volume can hold at a step a second: C_w ends where γ = 1."""
    log = coil_log(hours=1, seed=20, sd=0.1, substeps=2, C_w=5.0, every=5, air_march="lagged")
    fit = fc.fit_coil(log, split=1.0, air_march="lagged")
    assert fit.held == {"C_w": "at the stability limit (γ = 1 at the largest flow)"}
    assert fit.parameters["C_w"] == pytest.approx(float(fit.residuals["m_w"].max()) * fc.Loop()["cp_w"], rel=1e-3)


def test_only_a_heat_capacity_is_held_by_stability(monkeypatch):
    """The exponent β2 ends at a bound below its prior."""
    solve = CoilProblem.solve

    def solve_at_bound(problem):
        best, spread, wet = solve(problem)
        spread.covariance[BETA2] = spread.covariance[:, BETA2] = np.nan
        problem.prior[BETA2] = best.x[BETA2] + 1.0
        return best, spread, wet

    monkeypatch.setattr(CoilProblem, "solve", solve_at_bound)
    assert fc.fit_coil(coil_log(hours=1, seed=13, air=False), split=1.0).held["beta2"] == AT_BOUND


@pytest.fixture(scope="module")
def fit():
    return fc.fit_coil(coil_log(hours=1.5, seed=13, air=False))


def test_a_constant_air_flow_holds_its_exponents_at_a_prior_and_the_result_has_what_is_promised(fit):
    assert {"beta4", "beta6"} <= fit.held.keys()
    assert "the air flow is constant" in fit.held["beta4"]
    assert fit.parameters["beta4"] == -0.45
    assert fit.rmse["fit"] == pytest.approx(0.05, rel=0.05)
    assert list(fit.parameters) == [*COIL_PARAMETERS, "air_march", "n_volumes", "substeps"]
    names = [name for name in COIL_PARAMETERS if name not in fit.held]
    assert list(fit.covariance["parameter"].values) == names == list(fit.intervals)
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), [fit.standard_errors[n] for n in names])
    assert fit.profile is None
    ds = fit.residuals
    np.testing.assert_allclose(ds["T_sup_residual"], ds["T_sup"] - ds["T_sup_modelled"])
    read = tomllib.loads(fit.to_toml())
    assert read["loop"] == fit.parameters
    assert any(line.startswith("beta4: held") for line in read["fit"]["held"])


def test_the_figure_marks_what_is_not_compared(fit):
    figure = fit.plot()
    assert figure.get_supxlabel() == "Grey: not compared"
    assert [axes.get_xlabel() for axes in figure.axes] == ["", "", "time [h]", "time [h]"]
    assert_palette(figure)
    assert_texts_fit(figure)


@pytest.mark.usefixtures("all_starts")
def test_a_coil_of_another_library_is_matched_as_well_as_two_of_its_models_match_each_other():
    """Buildings' WetCoilCounterFlowPControl: fitted on 36-1,200 s, validated after: within 0.57 K."""
    columns = {"elapsed_time": "time_s", "m_w": "m_water_kg_s", "m_a": "m_air_kg_s", "T_sup": "T_sup_C"}
    columns |= {"T_w_in": "T_water_in_C__from_mo", "T_a_in": "T_air_in_C__from_mo", "RH_a_in": "RH_air_in__from_mo"}
    units = {"elapsed_time": "s", "m_w": "kg/s", "m_a": "kg/s", "RH_a_in": "1"}
    units |= dict.fromkeys(("T_w_in", "T_a_in", "T_sup"), "degC")
    path = measured_file("wetcoil_counterflow_picontrol.csv")
    fit = fc.fit_coil(fc.read_log(path, columns=columns, units=units), warm_up=36, split=0.337)
    assert fit.rmse["validation"] < 0.57
    assert {"beta4", "beta6"} <= fit.held.keys()
