"""Moist air against PsychroLib (an independent implementation of the same handbook) and closed forms."""

import numpy as np
import pytest

from fastcoil.model import moist_air

PRESSURES = (101325.0, 98934.0, 70e3)
ABOVE_FREEZING = np.linspace(0.02, 50.0, 60)


def apply_elementwise(function, *arrays):
    return np.array([function(*map(float, row)) for row in zip(*np.broadcast_arrays(*arrays), strict=True)])


def test_saturation_is_hyland_wexlers_over_ice_below_the_triple_point_and_over_water_above(psychrolib):
    T = np.concatenate([np.linspace(-40.0, 60.0, 301), [-1e-6, 0.0, 0.003, 0.0099, 0.0101]])
    p_s = apply_elementwise(psychrolib.GetSatVapPres, T)
    np.testing.assert_allclose(moist_air.saturation_pressure(T), p_s, rtol=1e-12)
    W_s = apply_elementwise(lambda t: psychrolib.GetSatHumRatio(t, 98e3), T)
    np.testing.assert_allclose(moist_air.saturation_humidity_ratio(T, 98e3), W_s, rtol=1e-10)


def test_humidity_in_frost_is_by_convention_over_supercooled_water():
    """Relative humidity and dew point of weather files; a coil's metal is saturated over ice, up to 22 % less."""
    T = np.linspace(-20.0, 0.0, 21)
    saturated = moist_air.humidity_ratio(T, 1.0)
    np.testing.assert_allclose(saturated, moist_air.humidity_ratio_from_dew_point(T), rtol=1e-14)
    np.testing.assert_allclose(moist_air.humidity_ratio_from_wet_bulb(T, T), saturated, rtol=1e-9)
    share = moist_air.saturation_humidity_ratio(T) / saturated
    assert np.all(np.diff(share) > 0.0)
    assert share[0] == pytest.approx(0.822, abs=2e-3)
    assert share[-1] == pytest.approx(1.0, abs=1e-4)


def test_liquid_pressure_below_freezing_is_that_of_supercooled_water():
    """Murphy & Koop (2005), eq (10), is another correlation: they agree within 0.3 % down to -30 degC."""
    T = np.linspace(-30.0, 0.0, 31)
    K = T + 273.15
    cold_part = np.tanh(0.0415 * (K - 218.8)) * (53.878 - 1331.22 / K - 9.44523 * np.log(K) + 0.014025 * K)
    expected = np.exp(54.842763 - 6763.22 / K - 4.210 * np.log(K) + 0.000367 * K + cold_part)
    np.testing.assert_allclose(moist_air.liquid_saturation_pressure(T), expected, rtol=3e-3)


@pytest.mark.parametrize("pressure", PRESSURES)
def test_humidity_ratios_are_those_of_psychrolib(psychrolib, pressure):
    T, rh = (grid.ravel() for grid in np.meshgrid(ABOVE_FREEZING, [0.05, 0.5, 1.0]))
    wet_bulb = T - 3.0 * (1.0 - rh)
    above = wet_bulb > 0.01
    cases = (
        ("humidity_ratio", psychrolib.GetHumRatioFromRelHum, T, rh),
        ("saturation_humidity_ratio", psychrolib.GetSatHumRatio, T),
        ("humidity_ratio_from_dew_point", psychrolib.GetHumRatioFromTDewPoint, T),
        ("humidity_ratio_from_wet_bulb", psychrolib.GetHumRatioFromTWetBulb, T[above], wet_bulb[above]),
    )
    for name, function, *arguments in cases:
        expected = apply_elementwise(lambda *a, of=function: of(*a, pressure), *arguments)
        np.testing.assert_allclose(getattr(moist_air, name)(*arguments, pressure), expected, rtol=1e-10, err_msg=name)


@pytest.mark.parametrize("pressure", PRESSURES)
def test_dew_point_is_that_of_psychrolib_and_inverts_saturation(psychrolib, pressure):
    W = moist_air.saturation_humidity_ratio(ABOVE_FREEZING, pressure)
    dew_point = moist_air.dew_point(W, pressure)
    np.testing.assert_allclose(dew_point, ABOVE_FREEZING, atol=1e-10)
    # PsychroLib iterates to 1e-3 K only.
    expected = apply_elementwise(lambda t, w: psychrolib.GetTDewPointFromHumRatio(t, w, pressure), ABOVE_FREEZING, W)
    np.testing.assert_allclose(dew_point, expected, atol=2e-3)


def test_dew_point_inverts_saturation_in_frost_and_in_dry_air():
    T = np.linspace(-60.0, 0.0, 25)
    np.testing.assert_allclose(moist_air.dew_point(moist_air.humidity_ratio(T, 1.0)), T, atol=1e-9)
    assert moist_air.dew_point(0.0) == moist_air.dew_point(1e-7) < -80.0


@pytest.mark.parametrize("pressure", PRESSURES)
def test_wetting_point_inverts_saturation_over_ice_and_over_water(pressure):
    T = np.concatenate([np.linspace(-85.0, 60.0, 146), [0.0, 0.0099, 0.0101]])
    W_s = moist_air.saturation_humidity_ratio(T, pressure)
    T_wetting = moist_air.wetting_point(W_s, pressure)
    np.testing.assert_allclose(T_wetting, T, atol=2e-7)
    above = T_wetting > 0.1
    np.testing.assert_array_equal(T_wetting[above], moist_air.dew_point(W_s, pressure)[above])


def test_enthalpy_is_that_of_psychrolib_and_temperature_inverts_it(psychrolib):
    T, W = (grid.ravel() for grid in np.meshgrid(np.linspace(-20.0, 60.0, 17), [0.0, 0.005, 0.02]))
    h = moist_air.enthalpy(T, W)
    np.testing.assert_allclose(h, apply_elementwise(psychrolib.GetMoistAirEnthalpy, T, W) / 1000, rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(moist_air.temperature_from_enthalpy(h, W), T, atol=1e-11)


@pytest.mark.parametrize("pressure", PRESSURES)
def test_saturation_enthalpy_slope_is_the_derivative(pressure):
    def h_s(T):
        return moist_air.enthalpy(T, moist_air.saturation_humidity_ratio(T, pressure))

    T, step = np.concatenate([np.linspace(-40.0, -0.01, 30), ABOVE_FREEZING]), 1e-3
    difference = (h_s(T + step) - h_s(T - step)) / (2 * step)
    np.testing.assert_allclose(moist_air.saturation_enthalpy_slope(T, pressure), difference, rtol=1e-7)


def test_mixing_keeps_water_and_enthalpy_and_its_ends():
    t, w = moist_air.mix(0.25, -10.0, 0.001, 24.0, 0.009)
    assert w == pytest.approx(0.25 * 0.001 + 0.75 * 0.009, rel=1e-14)
    h = 0.25 * (1.006 * -10 + 0.001 * (2501 - 18.6)) + 0.75 * (1.006 * 24 + 0.009 * (2501 + 1.86 * 24))
    assert 1.006 * t + w * (2501 + 1.86 * t) == pytest.approx(h, rel=1e-14)
    # Moist air has the larger heat capacity, so the mixture lies a little to its side of the straight line.
    assert 0.0 < t - (0.75 * 24 - 0.25 * 10) < 0.1
    np.testing.assert_allclose(moist_air.mix([1.0, 0.0], -10.0, 0.001, 24.0, 0.009), [[-10, 24], [0.001, 0.009]])
