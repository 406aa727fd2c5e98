"""Presets of cooling and heating coils: the design table, what ``fc.presets`` shows, how they behave."""

import math

import numpy as np
import pytest
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.loops.presets import COOLING_PRESETS, PRESETS
from fastcoil.model.parameter_table import PARAMETERS

pytestmark = pytest.mark.kernel

HEATING = {
    "cp_w": 4.186, "cp_a": 1.02, "pressure": 101325.0, "m_max": None, "valve_a": None, "valve_b": None, "valve_c": None,
    "rangeability": 50.0, "authority": 0.5, "m_full": 0.5, "leakage": 0.001, "sensor_time_constant": 30.0,
    "stroke_time": 90.0, "kp": 0.025, "ti": 80.0, "sample_time": 10.0, "action": "heating",
    "air_march": "quasistatic",
}  # fmt: skip
HEATING_COILS = {
    "heating": {"C_w": 2.2, "C_c": 2.5, "beta1": 0.24, "beta3": 0.10, "beta5": 0.105},
    "heating_45": {"C_w": 4.4, "C_c": 5.0, "beta1": 0.28, "beta3": 0.20, "beta5": 0.21},
    "reheat": {
        "C_w": 0.19, "C_c": 0.21, "beta1": 0.147, "beta3": 0.0333, "beta5": 0.035, "m_full": 0.042,
        "sensor_time_constant": 60.0, "kp": 0.1, "ti": 900.0, "sample_time": 30.0, "controlled": "T_room",
        "room_capacity": 450.0, "room_ua": 0.05,
    },
}  # fmt: skip
VARYING = ("air_march", "C_c", "kp", "ti", "sample_time", "sensor_time_constant", "stroke_time")
DESIGN_TABLE = {
    "paper_like": ("lagged", 30.0, 0.03, 8.0, 30.0, 0.0, 0.0),
    "paper_like_fast": ("lagged", 10.0, 0.05, 5.0, 10.0, 0.0, 0.0),
    "lbnl": ("quasistatic", 10.0, 0.018, 30.0, 15.0, 30.0, 90.0),
    "g36": ("quasistatic", 10.0, 0.05, 600.0, 5.0, 30.0, 90.0),
}


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_the_documented_tables(name):
    loop = fc.Loop.preset(name)
    others = {p.name: p.default for p in PARAMETERS.values()}
    heats = name in HEATING_COILS
    documented = HEATING | HEATING_COILS[name] if heats else dict(zip(VARYING, DESIGN_TABLE[name], strict=True))
    assert {p: loop[p] for p in PARAMETERS} == others | documented


def test_every_preset_is_tested_and_the_default_is_paper_like():
    assert [*COOLING_PRESETS] == [*DESIGN_TABLE]
    assert fc.Loop() == fc.Loop.preset("paper_like")


def test_presets_hold_the_differences_from_the_defaults():
    for name, preset in fc.presets().items():
        loop = fc.Loop.preset(name)
        assert preset.name == name
        differs = {p: loop[p] for p in PARAMETERS if loop[p] != PARAMETERS[p].default}
        assert preset.values == {p: value for p, value in differs.items() if value is not None}


def test_unknown_preset():
    assert_refused("preset", "choice", fc.Loop.preset, "paperlike")
    assert_refused("preset", "type", fc.Loop.preset, None)


STEP = 2.0  # K
STEP_AT = 5400  # s
SECONDS = 9000
CORNERS = [(m_a, T_out, T_w) for m_a in (0.4, 1.3) for T_out in (-20.0, 15.0) for T_w in (45.0, 70.0)]
NAMES = ("heating", "heating_45")


@pytest.fixture(scope="module")
def day():
    """The corners of the working range, a day each, with a step of the set-point within reach."""
    m_a, T_out, T_w_in = (np.array(column)[:, None] * np.ones(SECONDS) for column in zip(*CORNERS, strict=True))
    T_a_in = 0.3 * T_out + 0.7 * 21.0
    T_set = T_a_in + 0.22 * (T_w_in - T_a_in) + STEP * (np.arange(SECONDS) >= STEP_AT)
    return fc.Boundary(m_a=m_a, T_a_in=T_a_in, W_a_in=0.003, T_w_in=T_w_in, T_set=T_set, day=range(len(CORNERS)))


def overshoot(ds, T_set):
    after = ds.T_sup.sel(elapsed_time=slice(STEP_AT, None)).transpose(..., "day", "elapsed_time")
    return ((after.values - T_set[:, -1:]) / STEP).max(axis=-1)


@pytest.mark.parametrize("name", NAMES)
def test_a_heating_preset_does_not_ring_where_the_gains_of_a_cooling_loop_do(name, day):
    loop, T_set = fc.Loop.preset(name).assign(backlash=0.0), day.series["T_set"]
    ds = fc.simulate(loop, day, traces=["T_sup"], trace_interval=10, n_jobs=1)
    assert overshoot(ds, T_set).max() < 0.2
    assert np.median(overshoot(ds, T_set)) < 0.05
    assert not ds.hunts.any()
    assert float(abs(ds.T_sup.isel(elapsed_time=-1) - T_set[:, -1]).max()) < 0.05
    cooling = fc.Loop.preset("lbnl")
    with_them = loop.assign(**{n: cooling[n] for n in ("kp", "ti", "sample_time")})
    with pytest.warns(UserWarning, match="those of the cooling coil lbnl"):
        rings = fc.simulate(with_them, day, traces=["T_sup"], trace_interval=10, n_jobs=1)
    assert overshoot(rings, T_set).max() > 0.35


@pytest.mark.parametrize("name", NAMES)
def test_theory_calls_a_heating_preset_calm_and_its_gains_times_ten_not(name, day):
    loop = fc.Loop.preset(name)
    theory = fc.limit_cycle(loop.assign(backlash=[0.0, 0.15]), day, at=0)
    assert float(theory.hunting_index.max()) < 0.4
    wild = loop.assign(kp=10 * loop["kp"], ti=10.0)
    theory, ds = fc.limit_cycle(wild, day, at=0), fc.simulate(wild, day, n_jobs=1)
    assert theory.hunts.all()
    assert ds.hunts.all()


@pytest.mark.parametrize(("name", "T_w_in"), [("heating", 60.0), ("heating_45", 45.0)])
def test_the_design_load_opens_the_valve_to_0_6_to_0_9(name, T_w_in):
    """Eight volumes come near the counterflow formula of ε and NTU; the flow is that of the installed valve."""
    loop = fc.Loop.preset(name)
    rest = fc.linearise(loop, fc.design_day(0.5, "heating", T_w_in=T_w_in), at=0)
    opening = float(rest.opening)
    assert 0.6 <= opening <= 0.9
    R, N, L = loop["rangeability"], loop["authority"], loop["leakage"]
    shut, partly = (1 / math.sqrt(1 + N * (R ** (2 * (1 - x)) - 1)) for x in (0.0, opening))
    m_w = loop["m_full"] * (L + (1 - L) * (partly - shut) / (1 - shut))
    assert float(rest.m_w) == pytest.approx(m_w, rel=1e-9)
    m_a, T_a_in = 1.15, 0.3 * -20.0 + 0.7 * 21.0
    C_a, C_w = m_a * loop["cp_a"], m_w * loop["cp_w"]
    G_a, G_w = 8 * loop["beta3"] * m_a ** loop["beta4"] * C_a, 8 * loop["beta1"] * m_w ** loop["beta2"] * C_w
    UA = 1 / (1 / G_a + 1 / G_w)
    low, high = sorted((C_a, C_w))
    ratio, ntu = low / high, UA / low
    eps = (1 - math.exp(-ntu * (1 - ratio))) / (1 - ratio * math.exp(-ntu * (1 - ratio)))
    assert 25.0 - T_a_in == pytest.approx(eps * low / C_a * (T_w_in - T_a_in), rel=0.05)


def test_a_heating_preset_is_its_twin_in_plain_python(run_reference):
    hour = {name: values[0][:1800] for name, values in fc.heating_day(1.0, 3).series.items()}
    loop, day = fc.Loop.preset("heating").assign(noise_std=0.02), fc.Boundary(**hour, day=3)
    ds = fc.simulate(loop, day, traces=["T_sup", "opening", "m_w"], warm_up=600, n_jobs=1)
    traces, metrics = run_reference(loop, day, warm_up=600)
    for name in ("T_sup", "opening", "m_w"):
        np.testing.assert_allclose(ds[name].values, traces[name], rtol=0, atol=1e-9, err_msg=name)
    assert float(ds.rmse) == pytest.approx(metrics["rmse"], abs=1e-9)
