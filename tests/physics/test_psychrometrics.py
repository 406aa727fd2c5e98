"""Moist air against Hyland and Wexler's formula, published values and PsychroLib."""

import numpy as np
import pytest
import reference

from fastcoil.physics.psychrometrics import enthalpy_difference, saturation_humidity_ratio, saturation_pressure

TEMPERATURES = np.concatenate([np.linspace(0.01, 50.0, 5003), [0.0101, 49.9999]]).tolist()
PRESSURES = [60e3, 80e3, 98e3, 101325.0, 108e3]


def test_saturation_pressure_is_hyland_wexlers():
    for T in TEMPERATURES:
        assert saturation_pressure(T) == pytest.approx(reference.saturation_pressure(T), rel=5e-11)


@pytest.mark.parametrize("pressure", PRESSURES)
def test_saturation_humidity_ratio_is_within_1e_9(pressure):
    for T in TEMPERATURES:
        exact = reference.saturation_humidity_ratio(T, pressure)
        assert saturation_humidity_ratio(T, pressure) == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(("T", "clamped"), [(-40.0, 0.01), (0.0, 0.01), (50.5, 50.0), (1e300, 50.0)])
def test_saturation_is_clamped_to_0_01_to_50_degrees(T, clamped):
    assert saturation_humidity_ratio(T, 101325.0) == saturation_humidity_ratio(clamped, 101325.0)


def test_saturation_of_nan_is_nan():
    assert np.isnan(saturation_humidity_ratio(np.nan, 101325.0))
    assert np.isnan(saturation_humidity_ratio(10.0, np.nan))


def test_saturation_humidity_ratio_rises_with_temperature():
    W_s = [saturation_humidity_ratio(T, 101325.0) for T in sorted(TEMPERATURES)]
    assert np.all(np.diff(W_s) > 0.0)


@pytest.mark.parametrize(
    ("T", "W_s", "h_s"),
    [
        (5, 5.402, 18.590),
        (10, 7.630, 29.285),
        (15, 10.647, 42.016),
        (20, 14.695, 57.419),
        (25, 20.081, 76.307),
        (30, 27.203, 99.732),
    ],
)
def test_published_saturation_values(T, W_s, h_s):
    found = saturation_humidity_ratio(float(T), 101325.0)
    assert round(1000.0 * found, 3) == W_s
    assert round(enthalpy_difference(float(T), found, 0.0, 0.0), 3) == h_s


@pytest.mark.parametrize("pressure", PRESSURES)
def test_saturation_humidity_ratio_is_psychrolibs(psychrolib, pressure):
    # the same formula and molar masses, so only the approximation and round-off differ
    for T in np.linspace(0.02, 50.0, 501).tolist():
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
    for T_dp in np.linspace(1.0, 30.0, 59).tolist():
        W = psychrolib.GetSatHumRatio(T_dp, 101325.0)
        assert W > saturation_humidity_ratio(T_dp - 1e-6, 101325.0)
        assert not W > saturation_humidity_ratio(T_dp + 1e-6, 101325.0)
