"""What ``fc.tune`` refuses, each in one sentence and before anything runs."""

import numpy as np
import pytest
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.design.tuning_plan import parse_axes

DAYS = fc.paper_day(hours=0.6, seed=[1, 2])


@pytest.mark.parametrize(
    ("search", "field", "code"),
    [
        ({}, "search", "missing"),
        ({"kpp": (1, 2)}, "kpp", "name"),
        ({"backlash": (0, 0.1)}, "backlash", "name"),
        ({"law": (0, 1)}, "law", "unsupported"),
        ({"kp": 0.1}, "kp", "type"),
        ({"kp": (0.1, "0.2")}, "kp", "type"),
        ({"kp": (0.2, 0.1)}, "kp", "value"),
        ({"ti": (0, 100)}, "ti", "value"),
        ({"sample_time": (1.5, 30)}, "sample_time", "value"),
        ({"backlash_estimate": (0, 0.1), "estimate_ratio": (0, 1)}, "estimate_ratio", "conflict"),
    ],
)
def test_what_cannot_be_searched(search, field, code):
    assert_refused(field, code, parse_axes, search, fc.Loop())


def test_a_searched_parameter_has_no_dim_of_its_own_but_may_differ_between_valves():
    swept_alone = fc.Loop(kp=[0.01, 0.02], backlash=("sample", [0.0, 0.1]))
    assert_refused("kp", "conflict", parse_axes, {"kp": (0.005, 0.1)}, swept_alone)
    of_valves = fc.Loop(kp=("sample", [0.01, 0.02]), backlash=("sample", [0.0, 0.1]))
    assert [axis.name for axis in parse_axes({"kp": (0.005, 0.1)}, of_valves)] == ["kp"]


def test_axes_are_logarithmic_where_their_ends_are_positive_and_far_apart():
    bounds = {"kp": (0.01, 1.0), "ti": (10, 20), "buffer": (0, 0.01), "sample_time": (1, 60)}
    wide, narrow, from_0, whole = parse_axes(bounds, fc.Loop())
    middle = np.array([0.5])
    assert wide.values(middle) == pytest.approx([0.1])
    assert narrow.values(middle) == pytest.approx([15.0])
    assert from_0.values(middle) == pytest.approx([0.005])
    assert whole.values(middle) == 8.0
    for axis in (wide, narrow, from_0, whole):
        assert axis.values(np.array([0.0, 1.0])).tolist() == [axis.low, axis.high]
        assert axis.share(float(axis.values(middle)[0])) == pytest.approx(0.5, abs=0.01)
        lower = "" if axis in (from_0, whole) else "lower"  # no parameter of these two may be lower
        assert (axis.end(axis.low), axis.end(axis.high)) == (lower, "upper")
    assert wide.values(np.array([0.12345]))[0] == float(f"{0.01 * 100**0.12345:.4g}"), "what is quoted is what is tried"


@pytest.mark.parametrize(
    ("change", "field", "code"),
    [
        ({"loop": 3}, "loop", "type"),
        ({"boundary": None}, "boundary", "type"),
        ({"objective": "rms"}, "objective", "choice"),
        ({"evaluations": 0}, "evaluations", "value"),
        ({"limits": {"hunts": 5}}, "hunts", "value"),
        ({"limits": {"share_off": (12.0, "mean")}}, "share_off", "value"),
        ({"boundary": DAYS.isel(0)}, "holdout", "missing"),
        ({"n_jobs": 0}, "n_jobs", "value"),
        ({"progress": 3}, "progress", "type"),
        ({"warm_up": 9999}, "boundary", "data"),
    ],
)
def test_every_mistake_is_reported_in_a_sentence(change, field, code):
    arguments = {"loop": fc.Loop(), "boundary": DAYS, "search": {"kp": (0.01, 0.1)}} | change
    assert_refused(field, code, fc.tune, **arguments)
