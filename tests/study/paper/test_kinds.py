"""Kinds of days: what they share, and what tells them apart."""

from __future__ import annotations

import numpy as np

import fastcoil as fc
from fastcoil.study.paper import grid as kinds

SEEDS = (5, 6)


def test_days_of_all_kinds_share_air_flow_water_and_the_seeds_of_the_noise():
    days = [make(1, SEEDS) for make in kinds.KINDS.values()]
    for other in days[1:]:
        assert other.day.tolist() == days[0].day.tolist() == list(SEEDS)
        for name in ("m_a", "T_w_in", "sensor_noise"):
            if name in other.series:
                np.testing.assert_array_equal(other.series[name], days[0].series[name])


def test_the_first_kind_is_the_paper_s_and_only_there_the_set_point_steps():
    assert next(iter(kinds.KINDS)) == "stepped"
    paper = fc.paper_day(hours=2, seed=SEEDS)
    for name, make in kinds.KINDS.items():
        day = make(2, SEEDS)
        if name == "stepped":
            assert all(np.array_equal(day.series[n], paper.series[n]) for n in paper.series)
        else:
            assert (day.series["T_set"] == kinds.T_SET).all()


def test_a_design_day_is_milder_than_the_extreme_and_differs_by_seed():
    one, other = kinds.design(8, SEEDS).series["T_a_in"]
    extreme = fc.design_day(hours=8, outdoor_fraction=max(kinds.OUTDOOR_FRACTIONS)).series["T_a_in"][0]
    assert not np.allclose(one, other)
    for air in (one, other):
        assert (air < extreme).all()
        assert (air > kinds.T_SET + 5).all()
    given = fc.design_day(hours=8, T_design=kinds.EXTREME[0], T_wet_bulb=kinds.EXTREME[1])
    for name in ("T_a_in", "W_a_in"):
        np.testing.assert_array_equal(given.series[name], fc.design_day(hours=8).series[name])


def test_every_kind_has_words_of_its_own():
    said = [kinds.words(make) for make in kinds.KINDS.values()]
    assert len(set(said)) == len(said)
    assert all(len(text) > 20 and not text.endswith(".") for text in said)
