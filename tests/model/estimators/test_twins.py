"""Every estimator is its twin in plain Python, in closed loop: whatever the loop, valve, noise and sample time."""

import numpy as np
import pytest
from helpers.twins import assert_equal_to_reference

import fastcoil as fc
from fastcoil.model.metric_table import TRACES

pytestmark = pytest.mark.kernel

WARM_UP_S = 600
ELAPSED_S = np.arange(3600)
PASSIVE = {"estimator": "hagglund", "plant_gain": 25.0, "estimate_share": 0.0}
ACTING = PASSIVE | {"estimate_share": 0.8}
GRADIENT = {"estimator": "gradient", "gradient_gain": 3e-3}
IDENTIFY = {"estimator": "identify", "identify_interval": 200.0, "identify_certainty": 0.4, "identify_memory": 3600.0}
HEATING = {"T_w_in": 55.0, "T_a_in": 12.0 + ELAPSED_S / 1800, "T_set": np.where(ELAPSED_S < 1800, 24.0, 20.0)}
OFF_AND_ON = {"enabled": np.where((ELAPSED_S > 1250) & (ELAPSED_S < 1615), 0, 1)}
GUSTS = {"m_a": np.where(ELAPSED_S % 1600 < 800, 1.0, 1.3)}
NOISY = {"noise_std": 0.05, "buffer": 0.01}
STEPS = {"T_set": 14.0 + np.resize([0.0, 1.0, -0.5, 0.5], 6)[ELAPSED_S // 600]}
ONE_GUST = {"m_a": np.where(ELAPSED_S < 2000, 1.0, 1.3)}
CALMER = {"sample_time": 5.0, "identify_memory": 1e5, "kp": 0.02, "backlash": 0.1}
WARMER = {"action": "heating", "kp": 0.01, "stroke_time": 60.0, "sample_time": 10.0}

CASES = {
    "passive": (PASSIVE, {}),
    "passive, fast, unfiltered": (PASSIVE | NOISY | {"sample_time": 7.0, "hagglund_filter_ratio": 0.0}, {}),
    "acting": (ACTING | NOISY | {"hagglund_least_half_periods": 5}, {}),
    "acting, heating": (ACTING | {"action": "heating", "kp": 0.02, "backlash_estimate": 0.01}, HEATING),
    "acting, off and on": (ACTING | {"hagglund_filter_ratio": 1.0}, OFF_AND_ON),
    "gradient": (GRADIENT, {}),
    "gradient, fast, noise": (GRADIENT | NOISY | {"sample_time": 7.0}, {}),
    "gradient, heating": (GRADIENT | {"action": "heating", "kp": 0.02, "backlash_estimate": 0.03}, HEATING),
    "gradient, off and on": (GRADIENT | {"gradient_pause": 100.0}, OFF_AND_ON),
    "gradient, gusts": (GRADIENT | {"gradient_filter_time": 30.0, "gradient_reference_time": 120.0}, GUSTS),
    "gradient at its cap": (GRADIENT | {"gradient_cap": 0.02, "gradient_dead_zone": 0.0, "gradient_pause": 0.0}, {}),
    "identify": (IDENTIFY | {"sample_time": 10.0, "estimate_share": 0.9}, STEPS),
    "identify, fast, noise": (IDENTIFY | NOISY | {"sample_time": 7.0, "stroke_time": 90.0}, STEPS),
    "identify, slow, a gust": (IDENTIFY | {"backlash_estimate": 0.15, "identify_stroke_time": 0.0}, STEPS | ONE_GUST),
    "identify, off and on": (IDENTIFY | CALMER, STEPS | OFF_AND_ON),
    "identify, heating": (IDENTIFY | WARMER, HEATING | {"T_set": 10.0 + STEPS["T_set"]}),
}


@pytest.mark.parametrize("name", CASES)
def test_estimators_are_their_twins(name, one_hour_day, run_reference):
    values, series = CASES[name]
    day = fc.Boundary(**{n: s[0] for n, s in one_hour_day.series.items()} | series, day=7)
    options = {"warm_up": WARM_UP_S, "seed": 3}
    ds = fc.simulate(fc.Loop(**values), day, traces=list(TRACES), **options)
    assert_equal_to_reference(ds, *run_reference(fc.Loop(**values), day, **options))
    assert np.unique(ds.estimate).size > 1
