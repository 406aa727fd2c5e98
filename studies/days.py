"""Kinds of days: constant and stepped set-point, design days, days of a weather file, and heating.

No verdict of these studies rests on one kind of day: a remedy that helps where the set-point steps every half hour may
cost something where it stands still.  ``make_days`` makes days of a kind from seeds; ``loop_settings`` are
the parameters of a loop that such days require.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import fastcoil as fc

WEATHER_FILE = Path(__file__).parent / "year" / "weather.csv"
"""Where a weather file is looked for (see ``weather.toml``)."""
HOURS = 8
STEPPED, CONSTANT, DESIGN, WEATHER, HEATING = "stepped", "constant", "design", "weather", "heating"
T_SET = 14.0
HEATING_T_W_IN, HEATING_T_SET = 40.0, 25.0
"""Entering water and set-point of a heating day, °C: a low-temperature system, as heat pumps and condensing boilers
need it."""
OUTDOOR_FRACTION = 0.3  # share of outdoor air on days of weather
SUMMER_DAYS = range(140, 274)  # days of the year that are drawn from a weather file


def kinds(weather: Path = WEATHER_FILE) -> tuple[str, ...]:
    """All kinds of days; those of weather only where there is a weather file."""
    return (STEPPED, CONSTANT, DESIGN, *((WEATHER,) if weather.is_file() else ()), HEATING)


def loop_settings(kind: str) -> dict[str, object]:
    """Parameters of a loop that days of this kind require."""
    return {"action": "heating"} if kind == HEATING else {}


def make_days(
    kind: str,
    seeds: Sequence[int],
    weather: Path = WEATHER_FILE,
    *,
    hours: int | None = None,
    outdoor_fraction: float = OUTDOOR_FRACTION,
) -> fc.Boundary:
    """Make one day for each seed, of 8 h by default.

    All carry the smooth noise of ``paper_day`` on air flow and water; what else differs between days of a kind is
    drawn from their seeds.  outdoor_fraction: share of outdoor air on days of weather.
    """
    hours = HOURS if hours is None else hours
    paper_days = fc.paper_day(hours=hours, seed=list(seeds))
    series = {name: paper_days.series[name] for name in ("m_a", "T_a_in", "W_a_in", "T_w_in", "T_set")}
    if kind != STEPPED:
        series["T_set"] = np.full_like(series["m_a"], HEATING_T_SET if kind == HEATING else T_SET)
    if kind in (DESIGN, WEATHER, HEATING):
        outdoor_days = (
            _weather_days(weather, seeds, hours, outdoor_fraction)
            if kind == WEATHER
            else [_design_day(kind, seed, hours) for seed in seeds]
        )
        for name in ("T_a_in", "W_a_in"):
            series[name] = np.concatenate([day.series[name] for day in outdoor_days])
    if kind == HEATING:
        series["T_w_in"] = series["T_w_in"] - 7.0 + HEATING_T_W_IN
    return fc.Boundary(**series, day=list(seeds))


def _design_day(kind: str, seed: int, hours: int) -> fc.Boundary:
    """A design day whose outdoor temperature is milder than the extreme by what the seed draws."""
    rng = np.random.default_rng([seed, 13])
    if kind == HEATING:
        milder_by = rng.uniform(0.0, 25.0)
        return fc.design_day(
            hours=hours, mode="heating", T_design=-20.0 + milder_by, T_daily_range=rng.uniform(2.0, 10.0)
        )
    milder_by = rng.uniform(0.0, 6.0)
    return fc.design_day(
        hours=hours, T_design=33.3 - milder_by, T_wet_bulb=23.7 - milder_by, outdoor_fraction=rng.uniform(0.2, 0.6)
    )


def _weather_days(path: Path, seeds: Sequence[int], hours: int, outdoor_fraction: float) -> list[fc.Boundary]:
    """Summer days of the file that the seeds draw."""
    conditions = {
        "m_a": 1.15,
        "T_w_in": 7.0,
        "T_set": T_SET,
        "outdoor_fraction": outdoor_fraction,
        "T_return": 24.0,
        "RH_return": 0.5,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # hourly data have no fast disturbances: paper_day adds them
        return [
            fc.weather_day(
                path,
                days=[int(np.random.default_rng([seed, 14]).choice(SUMMER_DAYS))],
                hour=9,
                hours=hours,
                **conditions,
            )
            for seed in seeds
        ]
