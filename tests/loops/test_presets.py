"""Presets: the design table, what ``fc.presets`` shows of them, and unknown names."""

import pytest

import fastcoil as fc
from fastcoil.loops.presets import COOLING, NOT_THE_FIT, PRESETS
from fastcoil.model.parameter_table import PARAMETERS

COMMON = {
    "C_w": 8.8, "beta1": 0.32, "beta2": -0.20, "beta3": 0.40, "beta4": -0.45, "beta5": 0.42, "beta6": -0.42,
    "cp_w": 4.186, "cp_a": 1.02, "pressure": 101325.0, "n_volumes": 8, "air_march": "lagged", "T_initial": 20.0,
    "m_max": 2.0, "valve_a": 0.7, "valve_b": 9.0, "valve_c": 0.38,
    "rangeability": None, "authority": None, "m_full": None, "backlash": 0.07,
    "command_resolution": 0.0, "noise_std": 0.0, "sensor_resolution": 0.0, "action": "cooling",
    "backlash_estimate": 0.0, "estimate_ratio": None, "buffer": 1e-9, "learning_step": 0.0, "learning_interval": 1800.0,
    "learning_ratio": 2.0, "learning_floor": 0.0, "learning_cap": 0.25, "learning_stop": "never",
    "learning_min_switches": 0.0, "learning_max_reference": 1.0, "learning_early_trip": 0.0, "learning_growth": 1.0,
    "learning_shrink": 1.0, "learning_final": 1.0, "learning_reference": 0.0, "learning_error_ratio": 0.0,
}  # fmt: skip
HEATING = {
    "cp_w": 4.186, "cp_a": 1.02, "pressure": 101325.0, "m_max": None, "valve_a": None, "valve_b": None, "valve_c": None,
    "rangeability": 50.0, "authority": 0.5, "m_full": 0.5, "leakage": 0.001, "sensor_time_constant": 30.0,
    "stroke_time": 90.0, "kp": 0.025, "ti": 80.0, "sample_time": 10.0, "action": "heating",
}  # fmt: skip
HEATING_COILS = {
    "heating": {"C_w": 2.2, "C_c": 2.5, "beta1": 0.24, "beta3": 0.10, "beta5": 0.105},
    "heating_45": {"C_w": 4.4, "C_c": 5.0, "beta1": 0.28, "beta3": 0.20, "beta5": 0.21},
}
VARYING = ("C_c", "kp", "ti", "sample_time", "sensor_time_constant", "stroke_time")
DESIGN_TABLE = {
    "paper_like": (30.0, 0.03, 8.0, 30.0, 0.0, 0.0),
    "paper_like_fast": (10.0, 0.05, 5.0, 10.0, 0.0, 0.0),
    "lbnl": (10.0, 0.018, 30.0, 15.0, 30.0, 90.0),
    "g36": (10.0, 0.05, 600.0, 5.0, 30.0, 90.0),
}


@pytest.mark.parametrize("name", DESIGN_TABLE)
def test_presets_are_the_design_table(name):
    loop = fc.Loop.preset(name)
    others = {p.name: p.default for p in PARAMETERS.values()}  # what came later, and is off by default
    assert {p: loop[p] for p in PARAMETERS} == others | COMMON | dict(zip(VARYING, DESIGN_TABLE[name], strict=True))


@pytest.mark.parametrize("name", HEATING_COILS)
def test_heating_presets_are_the_documented_table(name):
    loop = fc.Loop.preset(name)
    others = {p.name: p.default for p in PARAMETERS.values()}
    assert {p: loop[p] for p in PARAMETERS} == others | COMMON | HEATING | HEATING_COILS[name]


def test_every_preset_is_tested_and_the_default_is_paper_like():
    assert [*PRESETS] == [*DESIGN_TABLE, *HEATING_COILS]
    assert [*COOLING] == [*DESIGN_TABLE]
    assert fc.Loop() == fc.Loop.preset("paper_like")


def test_presets_hold_the_differences_from_the_defaults():
    for name, preset in fc.presets().items():
        loop = fc.Loop.preset(name)
        assert preset.name == name
        differs = {p: loop[p] for p in PARAMETERS if loop[p] != PARAMETERS[p].default}
        assert preset.values == {p: value for p, value in differs.items() if value is not None}


def test_presets_are_printed_with_text_differences_and_units():
    lines = repr(fc.presets()).splitlines()
    assert lines[0].split()[0] == "paper_like"
    assert "the defaults" in lines[1]
    assert "ASHRAE Guideline 36" in next(line for line in lines if line.startswith("g36"))
    assert any("kp = 0.018 K-1, ti = 30.0 s, sample_time = 15.0 s" in line for line in lines)
    assert lines[-1] == NOT_THE_FIT


def test_what_a_caller_does_with_presets_changes_none():
    fc.presets().clear()
    assert [*fc.presets()] == [*PRESETS]
    assert [*PRESETS] == [*DESIGN_TABLE, *HEATING_COILS]


def test_unknown_preset():
    with pytest.raises(fc.InputError, match=r"'paperlike'.*'paper_like'.*lbnl, g36, heating"):
        fc.Loop.preset("paperlike")


@pytest.mark.parametrize("name", [None, ["lbnl"]])
def test_a_preset_is_a_word(name):
    with pytest.raises(fc.InputError):
        fc.Loop.preset(name)
