"""What a controller gains that tests its own valve once a week, and what the test costs and harms.

Weeks of five days of 8 h in sequence; the test runs on the first day of each, half an hour after its start, and
``estimator = "identify"`` learns from it.  Valves and loops are drawn like those of ``identify_online``, the gains as
somebody left them.  Right means: within 20 % of the true backlash or 1 % of the stroke.  Harm is measured on the days
without a test, against plain PI with the same gains, days and noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

import fastcoil as fc
from fastcoil.measured.identify import GOOD_BACKLASH, SIZE_TOLERANCE
from studies.common import compare_rows, share_of, write_table
from studies.days import CONSTANT, DESIGN, HEATING, HOURS, STEPPED, WEATHER, kinds, loop_settings, make_days
from studies.learning.identify_online import HARM_RISE, IDENTIFY_SETTINGS, population

SEED, VALVES = 9661, 256
SEQUENCES, WEEKS, DAYS_A_WEEK = 4, 2, 5
WEEKLY_SCHEDULE: dict[str, Any] = {"start": 1800, "every": DAYS_A_WEEK * HOURS / 24}
GENTLE_TEST = fc.ValveTest.gentle(**WEEKLY_SCHEDULE)  # days of operation alone count here: a week has 40 hours
TESTS: Mapping[str, Mapping[str, fc.ValveTest | None]] = {
    CONSTANT: {"none": None, "gentle, 45 min": GENTLE_TEST, "45 min": fc.ValveTest(minutes=45, **WEEKLY_SCHEDULE),
               "20 min": fc.ValveTest(**WEEKLY_SCHEDULE)},
    DESIGN: {"none": None, "gentle, 45 min": GENTLE_TEST},
    STEPPED: {"none": None, "gentle, 45 min": GENTLE_TEST},
    HEATING: {"none": None, "heating, 30 min": fc.ValveTest.heating(**WEEKLY_SCHEDULE)},
    WEATHER: {"none": None, "gentle, 45 min": GENTLE_TEST},
}  # fmt: skip


def days_in_sequence(kind: str, seed: int) -> fc.Boundary:
    """Make the days of a sequence of weeks."""
    return make_days(kind, [100 * seed + k for k in range(WEEKS * DAYS_A_WEEK)])


def simulate_weekly_test(kind: str, test: fc.ValveTest | None, seed: int = SEED, n: int = VALVES) -> xr.Dataset:
    """Simulate identification with this test, beside plain PI: (sample, day), a ``day`` being a sequence of them."""
    loop = population(seed, n, heating=kind == HEATING).assign(**loop_settings(kind))
    true = xr.DataArray(loop["backlash"]).values
    parts = []
    for sequence in range(SEQUENCES):
        days = days_in_sequence(kind, seed + sequence)
        options: dict[str, Any] = {"seed": seed + sequence, "carry_over": True}
        plain = fc.simulate(loop, days, **options)
        identified_loops = fc.simulate(loop.assign(**IDENTIFY_SETTINGS), days, test=test, **options)
        is_test_day = identified_loops.day.copy(data=np.arange(identified_loops.sizes["day"]) % DAYS_A_WEEK == 0)
        rise = identified_loops.rmse / plain.rmse - 1.0
        weekly_estimates = identified_loops.estimate_final.isel(day=slice(DAYS_A_WEEK - 1, None, DAYS_A_WEEK))
        first, last = (weekly_estimates.isel(day=k).reset_coords(drop=True) for k in (0, -1))
        parts.append(
            xr.Dataset(
                {
                    "first": first,
                    "last": last,
                    "highest": identified_loops.estimate_final.max("day"),
                    "rise": rise.where(~is_test_day).mean("day"),
                    "on_test_days": rise.where(is_test_day).mean("day"),
                },
            ).reset_coords(drop=True)
        )  # fmt: skip
    ds = xr.concat(parts, "day").transpose("sample", "day")
    return ds.assign(true=("sample", true))


HEAD = (
    "days", "test", "right after a week, worn valves", "right after two", "of the estimates right", "too large",
    "good valves accused", "RMSE of worn valves on other days: median, %", "on days of a test, %",
    "more than 1 % worse, worn", "more than 1 % worse, good",
)  # fmt: skip


def test_row(ds: xr.Dataset) -> list[str]:
    """Row of the effects of a test on the valves of a kind of day."""
    tolerance = np.maximum(SIZE_TOLERANCE * ds.true, GOOD_BACKLASH) + 1e-9
    is_worn, is_good = (ds.true > GOOD_BACKLASH) & (ds.last >= 0.0), (ds.true == 0.0) & (ds.last >= 0.0)
    is_right = {name: abs(ds[name] - ds.true) <= tolerance for name in ("first", "last")}
    has_estimate = ds["last"] > 0.0
    changes = [100 * float(ds[name].where(is_worn).median()) for name in ("rise", "on_test_days")]
    return [
        *(f"{share_of(is_right[name], is_worn)}" for name in is_right),
        share_of(is_right["last"],
                 is_worn & has_estimate).to_text(1) if bool((is_worn & has_estimate).any()) else "none",
        f"{share_of(ds.highest > ds.true + tolerance, is_worn)}",
        f"{int((ds.highest > GOOD_BACKLASH).where(is_good).sum())} of {int(is_good.sum())}",
        *(f"{change:+.1f}" for change in changes),
        f"{share_of(ds.rise > HARM_RISE, is_worn)}", f"{share_of(ds.rise > HARM_RISE, is_good)}",
    ]  # fmt: skip


def sample() -> None:
    """Run a sample of the study: days with a constant set-point, without a test."""
    compare_rows(
        "valve_test/valve_test_online",
        [[CONSTANT, "none", *test_row(simulate_weekly_test(CONSTANT, TESTS[CONSTANT]["none"]))]],
    )


def main() -> None:
    """Write the table."""
    rows = []
    for kind in kinds():
        for name, test in TESTS[kind].items():
            rows.append([kind, name, *test_row(simulate_weekly_test(kind, test))])
            print(rows[-1], flush=True)
    title = f'A weekly valve test and `estimator = "identify"`: {VALVES} valves, {SEQUENCES} sequences of {WEEKS} weeks'
    write_table("valve_test/valve_test_online", title, HEAD, rows)
