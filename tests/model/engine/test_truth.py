"""Every trace and metric equals ``reference``, the paper in plain Python.

With the package's saturation function handed to the reference only the logic is compared: 1e-9 in the unit of
the trace.  With the Hyland-Wexler formula of the reference the approximation is compared as well.
"""

import os
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers.full import full_except
from helpers.twins import assert_equal_to_reference, assert_traces_equal
from reference import saturation_humidity_ratio

import fastcoil as fc
from fastcoil.model.metric_table import TRACES

pytestmark = pytest.mark.kernel

SECONDS = np.arange(3600)
WARM_UP = 600
SEED = 2**40 + 5


class Case(NamedTuple):
    """One run: parameters, series in place of those of the day, open-loop command."""

    loop: dict[str, Any]
    series: dict[str, Any] = {}
    command: np.ndarray | None = None


DRY = {"W_a_in": 0.004}
WET = {"W_a_in": 0.017, "T_w_in": 5.0}
COLD_AIR = -3.0 + 9.0 * np.cos(SECONDS / 573.0)
FROST = {
    "T_a_in": COLD_AIR,
    "W_a_in": np.minimum(
        0.0035 + 0.001 * np.sin(SECONDS / 150.0),
        0.95 * np.array([saturation_humidity_ratio(T, 101325.0) for T in COLD_AIR]),
    ),
    "T_w_in": 4.0 - SECONDS / 1200, "T_set": 4.0,
}  # fmt: skip
STEAM = {
    "T_a_in": 40.0 + SECONDS / 200, "W_a_in": 0.085 + 0.015 * np.sin(SECONDS / 200.0), "T_w_in": 61.0, "T_set": 56.0,
}  # fmt: skip
HEATING = {"T_w_in": 55.0, "T_a_in": 12.0 + SECONDS / 1800, "T_set": np.where(SECONDS < 1800, 24.0, 20.0)}
COMMAND_STEPS = np.repeat([0.0, 0.3, 1.0, 0.55, 0.5, 0.62, 0.0, 0.12, 0.9], 400)
RINGING_COMMAND = np.clip(0.5 + 0.5 * np.sin(SECONDS / 90.0), 0.0, 1.0)
RECORDED_NOISE = 0.1 * np.sin(SECONDS / 7.0) + 0.05 * np.sin(SECONDS**2 / 500.0)
OFF_AND_ON = np.where((SECONDS % 1500 > 1000) & (SECONDS % 1500 < 1315), 0, 1)
LOOSE_SCALE = np.where((SECONDS > 1100) & (SECONDS < 2500), 2.0, 0.8)
GENTLE_PI = {"kp": 0.018, "ti": 30.0, "sample_time": 15.0}
REAL_LOOP = {**GENTLE_PI, "C_c": 10.0, "sensor_time_constant": 30.0, "stroke_time": 90.0}
LEARNER = {"learning_step": 0.007, "backlash_estimate": 0.007, "learning_interval": 600.0}
BOLD_LEARNER = LEARNER | {
    "learning_early_trip": 1, "learning_ratio": 1.5, "learning_growth": 2.0, "learning_shrink": 0.5,
    "learning_interval": 700.0,
}  # fmt: skip
WARY_LEARNER = LEARNER | {
    "learning_reference": 1, "learning_error_ratio": 0.8, "learning_floor": 50.0, "noise_std": 0.02,
}  # fmt: skip
PRESSURE = 1.0 + 0.5 * np.sin(SECONDS / 240.0) * (SECONDS > 700)
ROOM = {"room_capacity": 200.0, "room_ua": 0.08}
ROOM_SERIES = {"T_out": 30.0 + SECONDS / 900, "Q_room": 1.5 + np.sin(SECONDS / 300.0)}
INSTALLED_VALVE = {"rangeability": 50.0, "authority": 0.3, "m_full": 1.8}

CASES = {
    "plain PI": Case({}),
    "no backlash": Case({"backlash": 0.0}),
    "inverse 60 %": Case({"backlash_estimate": 0.6 * 0.07}),
    "inverse 95 %": Case({"backlash_estimate": 0.95 * 0.07}),
    "inverse 100 %": Case({"estimate_ratio": 1.0}),
    "inverse 120 %": Case({"estimate_ratio": 1.2}),
    "dry": Case({}, DRY),
    "wet": Case({}, WET),
    "dry to wet and back": Case({}, {"W_a_in": 0.0105 + 0.003 * np.sin(SECONDS / 200.0)}),
    "steps, dry": Case({}, DRY, COMMAND_STEPS),
    "steps, wet": Case({}, WET, COMMAND_STEPS),
    "steps, partly wet": Case({}, {}, COMMAND_STEPS),
    "open loop, large backlash, rate limit": Case({"backlash": 0.3, "stroke_time": 90.0}, {}, RINGING_COMMAND),
    "open loop, actuator of four positions": Case({"command_resolution": 0.4}, {}, COMMAND_STEPS),
    "sample time 1 s": Case({"sample_time": 1.0}),
    "stroke time 90 s": Case({"stroke_time": 90.0, **GENTLE_PI}),
    "sensor lag": Case({"sensor_time_constant": 30.0}),
    "lagged sensor and slow actuator": Case(REAL_LOOP),
    "recorded noise": Case(GENTLE_PI, {"noise": RECORDED_NOISE}),
    "Gaussian noise": Case({"noise_std": 0.1, "sample_time": 5.0}),
    "Gaussian noise, open loop": Case(
        {"noise_std": 0.1, "sample_time": 7.0, "sensor_resolution": 0.1}, command=COMMAND_STEPS
    ),
    "both noises, buffer": Case({"noise_std": 0.05, "buffer": 0.01, "estimate_ratio": 1.0}, {"noise": RECORDED_NOISE}),
    "resolutions": Case({"sensor_resolution": 0.1, "command_resolution": 0.004, "sample_time": 7.0}),
    "buffer 0": Case({"buffer": 0.0, "backlash_estimate": 0.05}),
    "quasistatic": Case({"air_march": "quasistatic"}),
    "substeps": Case({"substeps": 4}),
    "quasistatic, wet, substeps": Case({"air_march": "quasistatic", "substeps": 3, "n_volumes": 6}, WET),
    "wear": Case({"wear_rate": 2e-3, "estimate_ratio": 0.6}),
    "wear on a real loop": Case({**REAL_LOOP, "wear_rate": 5e-3, "neutral_zone": 0.011, "noise_std": 0.05}),
    "wear, open loop": Case({"wear_rate": 2e-3, "stroke_time": 90.0}, {}, RINGING_COMMAND),
    "a linkage that comes loose and is fixed": Case(GENTLE_PI, {"backlash_scale": LOOSE_SCALE}),
    "a loose linkage that wears, with a learner": Case(
        {**LEARNER, "wear_rate": 1e-3, "noise_std": 0.02}, {"backlash_scale": LOOSE_SCALE}
    ),
    "a set-point that is reset": Case(GENTLE_PI, {"T_set": 14.0 + SECONDS / 1800.0}),
    "quasistatic, dry": Case({"air_march": "quasistatic"}, DRY),
    "quasistatic, wet": Case({"air_march": "quasistatic"}, WET),
    "heating": Case({**REAL_LOOP, "action": "heating", "kp": 0.01, "estimate_ratio": 0.6}, HEATING),
    "frost": Case({}, FROST),
    "frost, tight valve, quasistatic": Case({"air_march": "quasistatic", "leakage": 0.0}, FROST, COMMAND_STEPS),
    "hot and humid": Case({**REAL_LOOP, "action": "heating", "kp": 0.01}, STEAM),
    "5 volumes": Case({"n_volumes": 5, **GENTLE_PI}),
    "1 volume": Case({"n_volumes": 1}),
    "12 volumes": Case({"n_volumes": 12, "C_w": 13.2}),
    "valve of given authority": Case(INSTALLED_VALVE),
    "neutral zone": Case({"neutral_zone": 0.013, **GENTLE_PI}),
    "neutral zone, slow motor, coarse input": Case({"neutral_zone": 0.021, **REAL_LOOP, "command_resolution": 0.004}),
    "stick-slip": Case({"slip_jump": 0.023, **GENTLE_PI, "kp": 0.012}),
    "stick-slip, slow motor": Case({"slip_jump": 0.0513, "noise_std": 0.05, **REAL_LOOP, "sample_time": 5.0}),
    "stick-slip, open loop": Case({"backlash": 0.3, "slip_jump": 0.0713, "stroke_time": 90.0}, {}, RINGING_COMMAND),
    "leakage": Case({"leakage": 0.02}),
    "tight valve": Case({"leakage": 0.0}, {}, COMMAND_STEPS),
    "tight valve, off and on": Case({"leakage": 0.0, "beta2": -0.9}, {"enabled": OFF_AND_ON}),
    "valve with all faults": Case(REAL_LOOP | INSTALLED_VALVE | {
        "neutral_zone": 0.011, "slip_jump": 0.0313, "leakage": 0.01, "noise_std": 0.05,
    }),
    "linear valve": Case({"curve": "linear", "m_max": 1.2}),
    "linear valve that leaks": Case({"curve": "linear", "m_max": 1.2, "leakage": 0.03}, {}, COMMAND_STEPS),
    "linear valve that closes": Case({"curve": "linear", "beta2": -0.9}, {"enabled": OFF_AND_ON}),
    "pressure that varies": Case({}, {"dp_ratio": PRESSURE}),
    "pressure that varies, valve at rest": Case({"leakage": 0.01}, {"dp_ratio": PRESSURE}, COMMAND_STEPS),
    "pressure-independent valve": Case({"pressure_independent": 1}, {"dp_ratio": PRESSURE}),
    "positioner": Case({"positioner_band": 0.013, **REAL_LOOP}),
    "positioner with a narrow band": Case({"positioner_band": 0.0065, **REAL_LOOP, "command_resolution": 0.004}),
    "positioner, open loop": Case({"positioner_band": 0.021, "stroke_time": 90.0}, {}, RINGING_COMMAND),
    "room": Case(ROOM, ROOM_SERIES),
    "controlled room": Case({**ROOM, **REAL_LOOP, "controlled": "T_room", "noise_std": 0.05}, ROOM_SERIES),
    "controlled room, reheat": Case(
        {**ROOM, "controlled": "T_room", "action": "heating", "kp": 0.05, "ti": 300.0}, {**HEATING, **ROOM_SERIES}
    ),
    "off and on": Case({"noise_std": 0.02}, {"enabled": OFF_AND_ON}),
    "no air for a while": Case({}, {"m_a": np.where((SECONDS > 1200) & (SECONDS < 2000), 0.0, 1.15)}),
    "98 kPa, other specific heats": Case({"pressure": 98000.0, "cp_w": 3.8, "cp_a": 1.006, "T_initial": 12.0}),
    "learner": Case({**LEARNER, "noise_std": 0.02, "sample_time": 7.0}),
    "learner that stops": Case({**LEARNER, "learning_ratio": 0.9, "learning_stop": "first_step_down"}),
    "learner at its cap": Case({**LEARNER, "learning_floor": 50.0, "learning_cap": 0.02}),
    "learner that trips early": Case({**BOLD_LEARNER, "noise_std": 0.03, "sample_time": 7.0}),
    "learner that trips early and stops": Case(
        {**BOLD_LEARNER, "learning_stop": "first_step_down", "learning_final": 0.95, "noise_std": 0.02}
    ),
    "learner without evidence": Case({**LEARNER, "learning_min_switches": 12.0, "noise_std": 0.01}),
    "learner without a reference": Case({**LEARNER, "learning_max_reference": 0.25, "noise_std": 0.1}),
    "learner with an averaged reference": Case(
        {**BOLD_LEARNER, "learning_interval": 600.0, "learning_reference": 2, "noise_std": 0.03, "sample_time": 7.0}
    ),
    "learner that looks at its error": Case({**WARY_LEARNER, "sample_time": 7.0}),
    "learner that looks at its error, off and on": Case(WARY_LEARNER, {"enabled": OFF_AND_ON, "T_set": 14.0}),
}  # fmt: skip

COVERED_CASES = (
    "no backlash", "inverse 60 %", "inverse 100 %", "steps, dry", "steps, wet", "stroke time 90 s", "sensor lag",
    "Gaussian noise", "quasistatic", "quasistatic, dry", "wear", "5 volumes", "neutral zone", "stick-slip", "leakage",
    "linear valve", "pressure that varies", "positioner", "room",
    "learner that stops", "learner that trips early", "learner that looks at its error",
)  # fmt: skip
"""Cases that others contain: `make test-full` runs them."""
EXACT_SATURATION_CASES = (
    "plain PI", "wet", "quasistatic, wet", "98 kPa, other specific heats", "heating", "frost", "hot and humid"
)  # fmt: skip
"""Cases that are also compared with exact saturation by default; `make test-full` does so with all."""

WORKING_DAYS = {
    "learner": {"learning_step": 0.007, "backlash_estimate": 0.007},
    "learner on a real loop": {**REAL_LOOP, "learning_step": 0.007, "noise_std": 0.02, "buffer": 0.005},
    "bold learner": {**BOLD_LEARNER, "learning_min_switches": 3.0, "noise_std": 0.005, "sample_time": 25.0},
}
ROUND_OFF_CASES = {
    "hunting heating coil": Case({"action": "heating"}, HEATING),
    "hunting with recorded noise": Case({}, {"noise": RECORDED_NOISE}),
}
"""Hunting loops in which the reference itself moves by more than 1e-9 when its start moves by round-off."""


class Run(NamedTuple):
    """A loop as the package and the reference saw it; ``exact`` runs the reference with its own saturation."""

    ds: Any
    traces: dict[str, np.ndarray]
    metrics: dict[str, float]
    exact: Callable[[], tuple[dict[str, np.ndarray], dict[str, float]]]


def with_series(boundary, series):
    return fc.Boundary(**{name: values[0] for name, values in boundary.series.items()} | series, day=7)


def run_both(run_reference, loop, day, **options):
    ds = fc.simulate(loop, day, traces=list(TRACES), **options)
    return Run(ds, *run_reference(loop, day, **options), partial(run_reference, loop, day, exact=True, **options))


@pytest.fixture(scope="module", params=full_except(CASES, CASES.keys() - set(COVERED_CASES)))
def case(request, one_hour_day, run_reference):
    loop, series, command = CASES[request.param]
    options = {"command": command, "warm_up": WARM_UP, "seed": SEED}
    return run_both(run_reference, fc.Loop(**loop), with_series(one_hour_day, series), **options)


REFERENCE_HOURS = 8 if os.environ.get("FASTCOIL_FULL") else 2
"""An hour of the reference takes a third of a second; the learners decide every half hour or more often."""


@pytest.fixture(scope="module", params=WORKING_DAYS)
def many_hours(request, run_reference):
    day = fc.paper_day(hours=REFERENCE_HOURS, seed=1)
    return run_both(run_reference, fc.Loop(**WORKING_DAYS[request.param]), day, seed=SEED)


def test_traces_and_metrics(case):
    assert_equal_to_reference(case.ds, case.traces, case.metrics)


@pytest.mark.parametrize("case", full_except(CASES, EXACT_SATURATION_CASES), indirect=True)
def test_traces_with_exact_saturation(case):
    assert_traces_equal(case.ds, case.exact()[0], 1e-5)


def test_traces_and_metrics_over_many_hours(many_hours):
    assert_equal_to_reference(many_hours.ds, many_hours.traces, many_hours.metrics)


@pytest.mark.parametrize("many_hours", full_except(WORKING_DAYS, ["learner"]), indirect=True)
def test_traces_over_many_hours_with_exact_saturation(many_hours):
    assert_traces_equal(many_hours.ds, many_hours.exact()[0], 1e-4)


@pytest.mark.parametrize("name", ROUND_OFF_CASES)
@pytest.mark.filterwarnings("ignore:action = 'heating' with kp")
def test_where_round_off_grows_the_package_differs_by_no_more(name, one_hour_day, run_reference):
    loop, series, _ = ROUND_OFF_CASES[name]
    day = with_series(one_hour_day, series)
    nudged = fc.Loop(**loop, T_initial=20.0 * (1.0 + 1e-13))
    ds = fc.simulate(fc.Loop(**loop), day, traces=["T_sup", "mode"], warm_up=WARM_UP)
    traces, _ = run_reference(fc.Loop(**loop), day)
    deviation = np.abs(run_reference(nudged, day)[0]["T_sup"] - traces["T_sup"]).max()
    assert deviation > 1e-9
    assert np.abs(ds.T_sup.values - traces["T_sup"]).max() < deviation
    np.testing.assert_array_equal(ds["mode"].values, traces["mode"])


@pytest.mark.parametrize(("name", "least", "most"), [("dry", 0, 0), ("wet", 8, 8), ("dry to wet and back", 0, 8)])
def test_cases_are_as_wet_as_they_say(name, least, most, one_hour_day):
    loop, series, _ = CASES[name]
    ds = fc.simulate(fc.Loop(**loop), with_series(one_hour_day, series), traces=["wet_volumes"], warm_up=WARM_UP)
    assert (int(ds.wet_volumes.min()), int(ds.wet_volumes.max())) == (least, most)
