"""The study of hunting: its limits, error rates and cycles against plain Python, its conditions and its cures."""

import control
import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from studies import common as report
from studies import days as kinds
from studies.hunting import backlash as hunting_backlash
from studies.hunting import cures as hunting_cures
from studies.hunting import hunting
from studies.hunting import loops as hunting_loops
from studies.hunting.loops import Rule


@pytest.fixture(scope="module")
def loops():
    """Loops that nobody simulated, which hunt by a formula of the test's own: (sample, day)."""
    draw = np.random.default_rng(3)
    shape, dims = (300, 4), ("sample", "day")

    def drawn(low, high):
        return dims, np.exp(draw.uniform(np.log(low), np.log(high), shape))

    ds = xr.Dataset(
        {"kp": drawn(0.005, 0.2), "ti": drawn(4, 300), "K": drawn(5, 60), "T": drawn(20, 300), "theta": drawn(3, 60)},
        coords={"day": ["wet cooling 0", "wet cooling 1", "heating 0", "heating 1"]},
    )
    ds["hunts"] = ((ds.kp * ds.K) ** 0.8 * (ds["T"] + 2.0 * ds.theta) > 5.0 * ds.ti).astype(float)
    ds["backlash"] = ("sample",), draw.choice([0.0, 0.05], 300)
    ds["reachable"] = dims, draw.uniform(size=shape) < 0.9
    ds["margin"] = dims, draw.uniform(0.1, 2.0, shape)
    ds = ds.assign(overshoot=ds.margin, predicted=(ds.margin > 1.0).astype(float))
    return ds.assign(gain_margin=1.0 / ds.margin, phase_margin=90.0 - 30.0 * ds.margin)


def of_rule(ds, rule):
    """(warned, hunts) of the loops that count, as plain Python."""
    return [
        (bool(rule.of(ds)[i, d] > rule.limit), bool(ds.hunts[i, d] > 0))
        for i in range(0, ds.sizes["sample"])
        for d in range(ds.sizes["day"])
        if bool(ds.reachable[i, d]) and float(ds.backlash[i]) > 0.0
    ]


def test_the_choice_finds_the_formula_by_which_loops_hunt(loops):
    rules, (power, delays) = hunting_loops.chosen(loops)
    assert (power, delays) == (0.8, 2.0)
    formula = rules[1]
    assert formula.limit == pytest.approx(5.0, rel=0.03)
    assert formula.safe <= formula.limit
    at = loops.isel(sample=[7], day=[1])
    by_hand = (float(at.kp[0, 0]) * float(at.K[0, 0])) ** 0.8 * (float(at["T"][0, 0]) + 2 * float(at.theta[0, 0]))
    assert float(formula.of(at)[0, 0]) == pytest.approx(by_hand / float(at.ti[0, 0]))


def test_a_limit_is_the_best_of_all_by_plain_python():
    draw = np.random.default_rng(8)
    hunts = draw.uniform(size=120) < 0.4
    x = np.where(hunts, draw.normal(1.0, 0.6, 120), draw.normal(0.0, 0.6, 120))

    def both(limit):
        warned = [v > limit for v in x]
        sensitivity = sum(a and b for a, b in zip(warned, hunts, strict=True)) / hunts.sum()
        return sensitivity + sum(not a and not b for a, b in zip(warned, hunts, strict=True)) / (~hunts).sum()

    among = xr.DataArray(np.ones(120, bool), dims="sample")
    limit, safe = hunting_loops.limits(xr.DataArray(x, dims="sample"), xr.DataArray(hunts * 1.0, dims="sample"), among)
    assert both(limit) == pytest.approx(max(both(v + 1e-9) for v in x))
    assert sum(v >= safe for v in x[hunts]) >= hunting_loops.SURE * hunts.sum() - 1


def test_error_rates_count_worn_valves_that_reach_their_set_point(loops):
    rule = Rule("half of the truth", lambda ds: ds.kp, 0.04, 0.04)
    counted = of_rule(loops.isel(sample=slice(0, 60)), rule)
    shares = hunting_loops.errors(loops.isel(sample=slice(0, 60)), rule)
    right = [warned == hunts for warned, hunts in counted]
    parts = (
        right,
        [r for r, (_, hunts) in zip(right, counted, strict=True) if hunts],
        [r for r, (_, hunts) in zip(right, counted, strict=True) if not hunts],
    )
    assert [cell.split(" ")[0] for cell in shares] == [f"{100 * sum(p) / len(p):.1f}" for p in parts]


def test_only_a_swing_that_lasts_is_a_cycle():
    t = np.arange(0.0, 28800.0, hunting_backlash.SEEN)
    signals = {
        "lasts": 14.0 + 0.2 * np.sin(2 * np.pi * t / 400.0),
        "decays": 14.0 + 2.0 * np.exp(-t / 7200.0) * np.sin(2 * np.pi * t / 400.0),
        "drifts": 14.0 + 0.1 * t / 28800.0,
        "too small": 14.0 + 2e-4 * np.sin(2 * np.pi * t / 400.0),
    }
    T = xr.DataArray(np.array(list(signals.values())), dims=("sample", "elapsed_time"))
    found = hunting_backlash.cycling(T, xr.DataArray(np.zeros(4), dims="sample"))
    assert found.cycles.values.tolist() == [True, False, False, False]
    assert float(found.swing[0]) == pytest.approx(0.4, rel=0.01)
    assert float(found.period[0]) == pytest.approx(400.0, rel=0.06)
    below = hunting_backlash.cycling(T, xr.DataArray(np.full(4, 0.5), dims="sample"))
    assert not below.cycles.any()


def test_a_power_of_the_backlash_is_found_with_its_interval():
    draw = np.random.default_rng(2)
    X = np.array([0.0, 0.01, 0.03, 0.1])
    powers = 1.3 + 0.1 * draw.standard_normal((40, 1, 5))
    swing = xr.DataArray(
        np.exp(draw.normal(size=(40, 1, 5))) * X[None, :, None] ** powers, dims=("sample", "backlash", "day"),
        coords={"backlash": X},
    )  # fmt: skip
    middle, low, high = hunting_backlash.slopes(swing, xr.DataArray(np.ones((40, 5), bool), dims=("sample", "day")))
    assert middle == pytest.approx(float(powers.mean()))
    assert low < middle < high
    assert high - low < 0.12


@pytest.mark.parametrize("kind", hunting_loops.OPERATING)
def test_a_kicked_loop_comes_quietly_and_is_asked_for_more_load(kind, monkeypatch):
    monkeypatch.setattr(hunting_backlash, "KICKS", (0.0, 1.0))
    days, still = hunting_backlash.kicked(kind, 5, 2)
    T_set, air = days.series["T_set"], days.series["T_a_in"]
    before, away = 3600 * (hunting_backlash.RAMP + hunting_backlash.HOLD), 3600 * hunting_backlash.KICK
    more = 1.0 if kind == kinds.HEATING else -1.0
    for row, (condition, kick) in enumerate([(0, 0.0), (0, 1.0), (1, 0.0), (1, 1.0)]):
        end = still.series["T_set"][condition, 0]
        assert T_set[row, 0] == air[row, 0] == still.series["T_a_in"][condition, 0]
        assert (np.diff(T_set[row, :before]) * more >= 0.0).all()
        np.testing.assert_allclose(T_set[row, before : before + away] - end, more * kick, atol=1e-9)
        assert T_set[row, -1] == pytest.approx(end)
    assert all(np.ptp(days.series[name], axis=1).max() == 0.0 for name in ("m_a", "T_a_in", "W_a_in", "T_w_in"))


def test_cures_obey_the_formula_and_change_only_what_they_say():
    loop = fc.Loop.preset("lbnl").assign(kp=("sample", [0.1, 0.01]), ti=("sample", [10.0, 200.0]))
    plant = xr.Dataset(
        {"K": ("sample", [25.0, 25.0]), "T": ("sample", [60.0, 60.0]), "theta": ("sample", [30.0, 30.0])}
    )
    cures = hunting_cures.cured(loop, plant, 0.8, 2.0, 5.0)
    slower, weaker = cures["Ti by the formula, kp as found"], cures["kp by the formula, Ti as found"]
    for kp, ti in (slower, weaker):
        speed = (float(kp[0]) * 25.0) ** 0.8 * 120.0 / float(ti[0])
        assert speed == pytest.approx(5.0)
    assert float(slower[0][0]) == 0.1
    assert float(weaker[1][0]) == 10.0
    assert [float(x[1]) for x in (*slower, *weaker)] == [0.01, 200.0, 0.01, 200.0]
    kp, ti = cures[hunting_cures.BY_SIMC]
    assert (float(kp[0]), float(ti[0])) == pytest.approx((60.0 / (2 * 25 * 30), 60.0))
    assert float(cures["Ti at least T, kp as found"][1][0]) == 60.0


def test_hunting_where_nothing_moves_needs_size_and_periods_not_regularity():
    most = (3600 * hunting_loops.HOURS - hunting_loops.WARM_UP) / 10
    ds = xr.Dataset({
        "hunts": ("sample", [0.0, 0.0, 0.0, np.nan]),
        "hunting_swing": ("sample", [0.2, 0.05, 0.2, 0.2]),
        "hunting_period": ("sample", [most - 1.0, 300.0, most + 1.0, 300.0]),
    })  # fmt: skip
    np.testing.assert_array_equal(hunting_loops.hunting_of(ds).hunts, [1.0, 0.0, 0.0, np.nan])


def test_the_describing_function_of_a_gap_is_that_of_another_library():
    theirs = control.friction_backlash_nonlinearity(0.07)
    for depth in (0.02, 0.3, 0.6, 0.95):
        lag, size = hunting_loops.gap(np.array(depth))
        value = theirs.describing_function(0.5 * 0.07 / depth)
        assert size == pytest.approx(abs(value))
        assert lag == pytest.approx(-np.angle(value))


@pytest.mark.full
@pytest.mark.kernel
def test_the_margin_is_that_of_a_first_order_loop_by_hand_and_proportional_to_kp():
    """With a slow first-order sensor the coil is fast; what is left is K, a lag, half a sample, and an integral."""
    loop = fc.Loop.preset("lbnl").assign(
        sensor_time_constant=2000.0, sample_time=1.0, kp=[0.5, 1.0], ti=100.0, backlash=0.07, C_w=8.8, C_c=8.0
    )
    day = fc.constant_day(hours=1)
    plant = hunting_loops.foreseen(loop, day)
    K, w = float(plant.K[0]), np.geomspace(1e-4, 1.0, 4000)
    s, coil = 1j * w, fc.linearise(loop.assign(sensor_time_constant=0.0, kp=0.5), day)
    L = 0.5 * (1.0 + 1.0 / (100.0 * s)) * K / ((1.0 + 2000.0 * s) * (1.0 + float(coil.lag) * s))
    L = L * np.exp(-s * (float(coil.delay) + 0.5))
    left = np.pi + np.unwrap(np.angle(L))
    N = control.friction_backlash_nonlinearity(1.0)
    values = np.array([N.describing_function(a) for a in np.geomspace(0.501, 50.0, 80)])
    inside = (left > 0.0) & (left < 0.5 * np.pi)
    lag = -np.angle(values)[::-1]
    by_hand = np.max(np.abs(L[inside]) * np.interp(left[inside], lag, np.abs(values)[::-1]))
    assert float(plant.margin[0]) == pytest.approx(by_hand, rel=0.1)
    assert float(plant.margin[1]) == pytest.approx(2.0 * float(plant.margin[0]))
    assert float(plant["T"][0]) == pytest.approx(2000.0, rel=0.05)


@pytest.mark.full
@pytest.mark.kernel
def test_the_command_writes_every_table_and_figure(written, tmp_path, monkeypatch):
    study = tmp_path / "hunting.toml"
    study.write_text(hunting.STUDY.read_text().replace(", 34]", ", 6]"))
    monkeypatch.setattr(hunting, "STUDY", study)
    monkeypatch.setattr(hunting, "results", lambda name: fc.run_study(study, tmp_path / name))
    monkeypatch.setattr(hunting_backlash, "CHANGES", {"as it is: x": {}, "ti × 2": {"ti": 2.0}})
    hunting.main(8, 2)
    names = sorted(path.stem for path in report.WRITTEN.glob("*/tables/*.md"))
    assert names == sorted(path.stem for path in (report.STUDIES / "hunting" / "tables").glob("hunting*.md"))
    assert all(len(written(name)[1]) > 1 for name in names)
    for name in ("hunting", "hunting_population"):
        assert (tmp_path / "studies" / "hunting" / f"{name}.png").stat().st_size > 20_000
