"""What the fitted loop would do with another valve, tuning or controller."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fastcoil.measured.diagnosis.fitted_loop import FittedLoop, what_if
from fastcoil.measured.diagnosis.outcome import Outcome

BUFFER = 0.01
"""Of the backlash inverse that is tried, fraction of stroke."""
CASES = ("as_found", "no_gap", "half_gap", "half_gain", "inverse")
WORDS = {
    "as_found": "as found",
    "no_gap": "no gap",
    "half_gap": "half the gap",
    "half_gain": "half the gain",
    "inverse": "a backlash inverse",
}
_MEANINGS = {
    "rmse": ("K", "RMS control error"),
    "amplitude": ("K", "amplitude of the swing, half of peak to peak"),
    "period": ("s", "period of the swing"),
    "travel_per_day": ("1", "strokes of the motor in a day"),
    "reversals_per_day": ("1", "turns of the stem in a day"),
    "hunts": ("1", "whether the loop hunts"),
}


def outcomes_of(fitted: FittedLoop, backlash: float) -> dict[str, Outcome | str]:
    """Simulate the fitted loop in every case; ``backlash``: of its valve, fraction of stroke."""
    return {
        "as_found": what_if(fitted),
        "no_gap": what_if(fitted, backlash=0.0),
        "half_gap": what_if(fitted, backlash=0.5 * backlash),
        "half_gain": what_if(fitted, kp_factor=0.5),
        "inverse": what_if(fitted, estimate=backlash, buffer=BUFFER),
    }


def as_dataset(outcomes: dict[str, Outcome | str]) -> xr.Dataset:
    """The outcomes along ``case``: numbers, NaN where one is a sentence, which is then the ``doubt``."""
    ds = xr.Dataset(coords={"case": list(outcomes)})
    for name, (unit, meaning) in _MEANINGS.items():
        values = [np.nan if isinstance(one, str) else float(getattr(one, name)) for one in outcomes.values()]
        ds[name] = ("case", values, {"units": unit, "long_name": meaning})
    ds["doubt"] = ("case", [one if isinstance(one, str) else "" for one in outcomes.values()])
    return ds
