"""Moist air against Hyland and Wexler's formula, published values and PsychroLib."""

import hashlib

import numpy as np
import pytest
import reference

from fastcoil.model.physics import enthalpy_difference, saturation_humidity_ratio, saturation_pressure

EDGES = [edge + d for edge in (-20.0, 0.0, 0.01, 50.0, 60.0) for d in (-1e-4, -1e-12, 0.0, 1e-12, 1e-4)]
TEMPERATURES = np.concatenate([np.linspace(-20.0, 60.0, 4003), EDGES]).tolist()
PRESSURES = [60e3, 80e3, 98e3, 101325.0, 108e3]


def test_saturation_pressure_is_hyland_wexlers():
    for T in TEMPERATURES:
        if -20.0 <= T <= 60.0:
            assert saturation_pressure(T) == pytest.approx(reference.saturation_pressure(T), rel=5e-11)


@pytest.mark.parametrize("pressure", PRESSURES)
def test_saturation_humidity_ratio_is_within_1e_9(pressure):
    for T in TEMPERATURES:
        exact = reference.saturation_humidity_ratio(T, pressure)
        assert saturation_humidity_ratio(T, pressure) == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(("T", "clamped"), [(-20.1, -20.0), (-1e300, -20.0), (60.5, 60.0), (1e300, 60.0)])
def test_saturation_is_clamped_to_minus_20_to_60_degrees(T, clamped):
    assert saturation_humidity_ratio(T, 101325.0) == saturation_humidity_ratio(clamped, 101325.0)


def test_saturation_of_nan_is_nan():
    assert np.isnan(saturation_humidity_ratio(np.nan, 101325.0))
    assert np.isnan(saturation_humidity_ratio(10.0, np.nan))


def test_saturation_humidity_ratio_rises_with_temperature():
    within = np.sort([T for T in TEMPERATURES if -20.0 <= T <= 60.0])
    # formulas and polynomials meet at 0.01 and 50 degC to parts in 1e8
    W_s = [saturation_humidity_ratio(T, 101325.0) for T in within[np.diff(within, prepend=-21.0) > 1e-5].tolist()]
    assert np.all(np.diff(W_s) > 0.0)


@pytest.mark.kernel
def test_between_0_01_and_50_degrees_saturation_is_what_it_always_was():
    """To the last bit: W_s at 5,003 temperatures, as version 0.1 gave it."""
    W_s = np.array([saturation_humidity_ratio(T, 101325.0) for T in np.linspace(0.01, 50.0, 5003).tolist()])
    assert hashlib.sha256(W_s.astype("<f8").tobytes()).hexdigest()[:16] == "95dd2b4834d08762"


def test_published_saturation_values():
    T = [5.0, 10.0, 15.0, 20.0, 25.0, 30.0]
    W_s = [saturation_humidity_ratio(each, 101325.0) for each in T]
    h_s = [enthalpy_difference(*pair, 0.0, 0.0) for pair in zip(T, W_s, strict=True)]
    assert [round(1000.0 * each, 3) for each in W_s] == [5.402, 7.630, 10.647, 14.695, 20.081, 27.203]
    assert [round(each, 3) for each in h_s] == [18.590, 29.285, 42.016, 57.419, 76.307, 99.732]


@pytest.mark.parametrize("pressure", PRESSURES)
def test_saturation_humidity_ratio_is_psychrolibs(psychrolib, pressure):
    # the same formula and molar masses, so only the approximation and round-off differ
    for T in (*np.linspace(-20.0, 60.0, 161).tolist(), 0.0, 0.003, 0.0099, 0.0101):
        expected = psychrolib.GetSatHumRatio(T, pressure)
        assert saturation_humidity_ratio(T, pressure) == pytest.approx(expected, rel=1e-9)


def test_enthalpy_is_psychrolibs(psychrolib):
    for T in np.linspace(-20.0, 60.0, 41).tolist():
        for W in np.linspace(0.0005, 0.05, 34).tolist():
            expected = psychrolib.GetMoistAirEnthalpy(T, W) / 1000.0
            assert enthalpy_difference(T, W, 0.0, 0.0) == pytest.approx(expected, rel=1e-14, abs=1e-13)
            difference = expected - psychrolib.GetMoistAirEnthalpy(12.0, 0.008) / 1000.0
            assert enthalpy_difference(T, W, 12.0, 0.008) == pytest.approx(difference, rel=1e-14, abs=1e-13)


def test_air_is_wet_exactly_below_its_dew_point(psychrolib):
    for T_dp in np.linspace(-19.0, 59.0, 157).tolist():
        W = psychrolib.GetSatHumRatio(T_dp, 101325.0)
        assert W > saturation_humidity_ratio(T_dp - 1e-6, 101325.0)
        assert not W > saturation_humidity_ratio(T_dp + 1e-6, 101325.0)
