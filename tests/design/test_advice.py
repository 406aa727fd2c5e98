"""Which cures are tried, what is said of them, and which is recommended."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from fastcoil.design.advice import AS_IS, Cure, cures_of, hunts_uncounted, recommended, swings_at, verdict, with_cures
from fastcoil.design.operating_points import operating_points


def outcome(*rows):
    """(rmse, hunts, swing, margin) of each cure, all of status ok."""
    rmse, hunts, swing, margin = map(list, zip(*rows, strict=True))
    nothing = [0] * len(rows)
    found = {"rmse": rmse, "hunts": hunts, "hunting_swing": swing, "margin": margin, "status": nothing}
    found["n_hunting"] = nothing
    return xr.Dataset({name: ("cure", values) for name, values in found.items()}).assign(uncounted=False)


HUNTING = (0.4, 1.0, 1.0, 2.0)
NAMES = [AS_IS, "lower_kp", "longer_ti", "inverse", "repaired_valve"]


QUIET = (0.4, 0.0, 0.1, 0.4)


@pytest.mark.parametrize(
    ("now", "then", "words"),
    [
        (HUNTING, (0.3, 0.0, 0.1, 0.7), "cures it"),
        (HUNTING, (0.5, 0.0, 0.1, 0.7), "cures it, at a larger error"),
        (HUNTING, (0.4, 1.0, 1.05, 2.0), "still hunts"),
        (HUNTING, (0.3, 1.0, 0.3, 2.0), "still hunts, but less"),
        (HUNTING, (0.6, 1.0, 1.5, 2.0), "still hunts, and worse"),
        (QUIET, (0.41, 0, 0.1, 0), "no gain"),
        (QUIET, (0.3, 0, 0, 0), "better"),
        (QUIET, (0.5, 0, 0, 0), "worse"),
        (QUIET, (0.3, 1, 1, 2), "makes it hunt"),
    ],
)
def test_what_is_said_of_a_cure(now, then, words):
    assert verdict(outcome(now, then), 1) == words


def test_a_cure_that_could_not_be_simulated_says_so_and_is_not_recommended():
    ds = outcome(HUNTING, (np.nan, np.nan, np.nan, 0.1))
    ds["status"][1] = 2
    assert verdict(ds, 1) == "failed"
    assert recommended(ds, NAMES[:2]) == 0


def test_of_the_cures_the_least_error_is_recommended_a_repair_or_too_large_a_margin_last():
    gains = [(0.3, 0.0, 0.1, 0.7), (0.25, 0.0, 0.1, 0.7)]
    rest = [(0.1, 0.0, 0.1, 2.0), (0.05, 0.0, 0.1, 0.1)]
    assert NAMES[recommended(outcome(HUNTING, *gains, *rest), NAMES)] == "longer_ti"
    assert NAMES[recommended(outcome(HUNTING, HUNTING, HUNTING, *rest), NAMES)] == "inverse"
    assert NAMES[recommended(outcome(HUNTING, HUNTING, HUNTING, HUNTING, rest[1]), NAMES)] == "repaired_valve"
    assert recommended(outcome(HUNTING, HUNTING, HUNTING, HUNTING, HUNTING), NAMES) == 0


def test_a_loop_that_does_not_hunt_is_left_alone_for_less_than_5_per_cent_and_no_repair_is_recommended():
    quiet, nearly, repaired = ((error, 0.0, 0.1, 0.4) for error in (0.4, 0.39, 0.1))
    assert recommended(outcome(quiet, quiet, nearly, quiet, repaired), NAMES) == 0
    assert recommended(outcome(quiet, quiet, (0.3, 0, 0, 0), nearly, repaired), NAMES) == NAMES.index("longer_ti")


def test_where_theory_cannot_tell_no_gains_are_proposed():
    assert [cure.name for cure in cures_of(fc.Loop(), None)] == [AS_IS, "dead_band", "repaired_valve"]
    good = fc.Loop(backlash=0.0, error_dead_band=0.3)
    assert [cure.name for cure in cures_of(good, None)] == [AS_IS]


def test_each_cure_changes_its_own_parameters_only():
    cures = [Cure(AS_IS, "", {}), Cure("a", "", {"kp": 0.01}), Cure("b", "", {"plant_gain": 20.0, "buffer_swing": 0.1})]
    swept = with_cures(fc.Loop(kp=0.05, buffer_ratio=6.0), cures)
    assert swept["kp"].values.tolist() == [0.05, 0.01, 0.05]
    assert swept["buffer_swing"].values.tolist() == [0.0, 0.0, 0.1]
    assert swept.sizes == {"cure": 3}
    assert with_cures(fc.Loop(), cures[:1]) == fc.Loop()


def test_a_loop_that_hunts_for_a_part_of_the_day_is_cured_by_what_is_predicted_to_stop_it():
    part = (0.4, 0.0, 1.0, 1.3)
    ds = outcome(part, (0.3, 0.0, 0.1, 0.7), (0.2, 0.0, 0.5, 1.2))
    ds["n_hunting"][:] = [6, 0, 3]
    assert verdict(ds, 1) == "better"
    ds = ds.assign(uncounted=True)
    assert [verdict(ds, k) for k in (1, 2)] == ["cures it", "still hunts, but less"]
    assert recommended(ds, NAMES[:3]) == 1


def test_the_swing_at_an_operating_point_is_that_of_its_settled_seconds():
    T_set = np.repeat([14.0, 15.0], 1800)
    day = fc.Boundary(m_a=1.2, T_a_in=25.0, W_a_in=0.01, T_w_in=7.0, T_set=T_set)
    points = operating_points(day, warm_up=600)
    t = np.arange(0, 3600, 2)
    T_sup = (
        T_set[t] + 0.3 * np.sin(t / 30.0) + np.where((t >= 1800) & (t < 2400), 5.0, 0.0) + np.where(t < 600, 9.0, 0.0)
    )
    now = xr.Dataset({"T_sup": ("elapsed_time", T_sup)}, coords={"elapsed_time": t})
    assert swings_at(points, day, now) == pytest.approx([0.6, 0.6], abs=1e-3)
    short = operating_points(day, warm_up=0, at=2000)
    assert np.isnan(swings_at(short, day, now)).all()


def test_hunting_that_is_not_counted_shows_by_swings_where_it_is_predicted():
    def uncounted(swings, hunts=0.0, amplitude=1.0):
        cycles = SimpleNamespace(amplitude=np.full(5, amplitude))
        prediction = SimpleNamespace(hunting=np.array([0, 1]), reached=np.arange(5), cycles=cycles)
        return hunts_uncounted(prediction, np.array(swings), xr.Dataset({"hunts": hunts}))

    assert uncounted([1.0, np.nan, 0.5, 0.6, 0.4])
    assert not uncounted([1.0, 1.0, 0.5, 0.6, 0.4], hunts=1.0), "then it is counted"
    assert not uncounted([0.6, 0.6, 0.5, 0.5, 0.5])
    assert not uncounted([np.nan, np.nan, 0.1, 0.1, 0.1])
    assert uncounted([1.5, 1.5, 1.5, 1.5, 1.5]), "of the size predicted"
    assert not uncounted([0.2, 0.2, 0.2, 0.2, 0.2], amplitude=0.1), "too small to matter"
