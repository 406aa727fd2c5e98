"""``fit_loop``: the backlash from commands and supply temperatures, with a coil that is not quite the right one."""

import numpy as np
import pytest
import xarray as xr
from helpers.commands import fastcoil
from helpers.full import full_except

import fastcoil as fc
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE

pytestmark = pytest.mark.kernel

MODEL = fc.Loop.preset("lbnl")
ENTERING = {"m_a": "kg/s", "T_a_in": "degC", "W_a_in": "kg/kg", "T_w_in": "degC"}


def simulate_log(backlash=0.09, every=60, noise=0.03, seed=1, hours=7, T_set=None, **changed):
    """A log of a closed loop: set-point steps, or a constant set-point."""
    day = fc.paper_day(hours=hours, seed=seed)
    series = {name: day.series[name][0] for name in (*ENTERING, "T_set")}
    if T_set is not None:
        series["T_set"] = T_set
    loop = MODEL.assign(backlash=backlash, noise_std=noise, **changed)
    ds = fc.simulate(loop, fc.Boundary(**series), traces=["command", "T_measured"], seed=seed, n_jobs=1)
    columns = {"command": (ds.command.values, "1"), "T_sup": (ds.T_measured.values, "degC")}
    columns |= {name: (series[name], unit) for name, unit in ENTERING.items()}
    t = ("elapsed_time", np.arange(ds.sizes["elapsed_time"], dtype=float), {"units": "s"})
    log = {name: ("elapsed_time", values, {"units": unit}) for name, (values, unit) in columns.items()}
    return xr.Dataset(log, {"elapsed_time": t}).isel(elapsed_time=slice(None, None, every))


@pytest.fixture(scope="module")
def log():
    return simulate_log()


MODEL_ERRORS = [{"C_c": 20.0}, {"valve_c": 0.45}]
MORE_ERRORS = [{}, {"beta1": 0.4}, {"m_max": 1.6}, {"valve_b": 7.0}, {"stroke_time": 45.0}]


@pytest.mark.parametrize(
    "wrong", full_except(MODEL_ERRORS + MORE_ERRORS, MODEL_ERRORS), ids=lambda wrong: next(iter(wrong), "right")
)
def test_the_backlash_is_found_with_a_model_that_is_not_quite_right(log, wrong):
    fit = fc.fit_loop(log, MODEL.assign(**wrong))
    assert fit.identified
    assert fit.backlash == pytest.approx(0.09, abs=0.004)
    low, high = fit.interval
    assert low <= 0.09 <= high
    assert fit.parameters == {"backlash": fit.backlash}
    assert fit.rmse["validation"] < 0.5 * fit.rmse["validation_without_backlash"]


def test_a_good_valve_has_none():
    fit = fc.fit_loop(simulate_log(backlash=0.0), MODEL.assign(C_c=20.0))
    assert fit.identified
    assert fit.backlash <= 0.0025
    assert fit.interval[0] == 0.0


def test_missing_temperatures_and_a_gap_cost_what_they_are(log):
    """The model starts again after the gap; a temperature that is missing costs itself and the change from it."""
    T = log.T_sup.values.copy()
    T[200:204] = np.nan
    holed = log.assign(T_sup=("elapsed_time", T, log.T_sup.attrs)).drop_isel(elapsed_time=range(240, 250))
    fit = fc.fit_loop(fc.read_log(holed, drop=True), MODEL)
    assert fit.backlash == pytest.approx(0.09, abs=0.004)
    assert any("2 unbroken pieces" in note for note in fit.notes)
    assert set(np.unique(fit.residuals.batch)) == {0, 1}


def test_each_piece_is_shown_with_its_own_factor(log):
    """A sensor that shows half of the changes after a gap."""
    half = log.sizes["elapsed_time"] // 2
    T = log.T_sup.values.copy()
    T[half:] = 14.0 + 0.5 * (T[half:] - 14.0)
    log = log.assign(T_sup=("elapsed_time", T, log.T_sup.attrs)).drop_isel(elapsed_time=range(half - 10, half))
    fit = fc.fit_loop(log, MODEL, split=1.0)
    ds = fit.residuals.where(fit.residuals.part == "fit")
    slopes = [np.polyfit(*(piece_residuals[n].dropna("elapsed_time") for n in ("modelled", "T_sup")), 1)[0]
              for piece_residuals in (ds.where(ds.batch == piece) for piece in (0, 1))]  # fmt: skip
    assert slopes == pytest.approx([1.0, 1.0], abs=0.1)


def test_nothing_is_claimed_of_a_coarse_log_of_a_command_that_moves():
    """The size comes out too small, as turns between samples are missed."""
    fit = fc.fit_loop(simulate_log(backlash=0.03, every=300, hours=8), MODEL)
    assert "300 s apart and the command moves" in fit.reason
    assert not fit.identified
    assert "too small" in fit.reason
    assert fit.backlash < 0.01
    assert fit.parameters == {}
    assert any("backlash: not identified" in line for line in fit.summary())


def test_what_the_log_cannot_tell_is_not_claimed(log):
    assert "reverses only 0 times" in fc.fit_loop(log.assign(command=log.command * 0.0 + 0.4), MODEL).reason
    shuffled = log.assign(T_sup=log.T_sup.copy(data=np.random.default_rng(1).permutation(log.T_sup.values)))
    assert "explains" in fc.fit_loop(shuffled, MODEL).reason


def test_the_command_writes_what_the_function_finds(log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    table = log.to_dataframe().rename(columns={name: f"{name} [{log[name].attrs['units']}]" for name in log.data_vars})
    table.index.name = "elapsed_time [s]"
    table.to_csv(tmp_path / "log.csv")
    (tmp_path / "coil.toml").write_text("[loop]\nC_c = 20.0\nbacklash = 0.01\n")
    completed = fastcoil("fit", "loop", "log.csv", "--loop", "lbnl", "--loop", "coil.toml")
    assert "backlash = 0.0" in completed.stdout
    fit = fc.fit_loop(log, MODEL.assign(C_c=20.0))
    assert f"backlash = {fit.backlash!r}" in (tmp_path / "loop.toml").read_text()
    assert (tmp_path / "loop.png").is_file()


@pytest.mark.full
def test_what_is_claimed_is_right_whatever_the_coil_is_taken_for():
    """Valves, coils, motors, sensors and tunings drawn anew; the model knows the valve to half and none of the rest."""
    rng, claimed = np.random.default_rng(2711), []
    for i in range(40):
        backlash = 0.0 if i % 4 == 0 else rng.uniform(0.005, 0.15)
        authority, rangeability = np.exp(rng.uniform(np.log(0.05), np.log(0.9))), np.exp(rng.uniform(3.0, 4.6))
        log = simulate_log(
            backlash, int(rng.choice([10, 30, 60])), rng.uniform(0.0, 0.05), 300 + i, authority=authority, m_full=1.7,
            rangeability=rangeability, C_w=rng.uniform(8.8, 14.0), C_c=rng.uniform(10.0, 30.0),
            stroke_time=rng.uniform(30.0, 150.0), sensor_time_constant=rng.uniform(5.0, 60.0),
            kp=np.exp(rng.uniform(-5.3, -2.8)), ti=np.exp(rng.uniform(3.0, 5.7)), T_set=None if i % 2 else 14.0,
        )  # fmt: skip
        model = MODEL.assign(
            C_w=10.0, C_c=18.0, rangeability=50.0, m_full=1.7 * rng.uniform(0.85, 1.15),
            authority=float(np.clip(authority * rng.uniform(0.6, 1.6), 0.03, 0.95)),
        )  # fmt: skip
        fit = fc.fit_loop(log, model)
        if fit.identified:
            claimed.append(abs(fit.backlash - backlash) <= max(SIZE_TOLERANCE * backlash, GOOD_BACKLASH))
    assert len(claimed) >= 20
    assert np.mean(claimed) >= 0.95
