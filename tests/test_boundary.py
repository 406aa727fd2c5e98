"""What a boundary promises: shapes, immutability, digests, round trips, and messages that name field, value, cure."""

import copy
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from scipy.signal import lfilter

from fastcoil.boundary import Boundary, days, moist_air
from fastcoil.boundary.days import constant_day, design_day, paper_day
from fastcoil.boundary.series import SERIES
from fastcoil.errors import InputError

DIGEST = "833d7cdae034ccc50d8af7c8ae5fe9cbcbc3e6d90c9daa8a685df525d604295a"
GOOD = {"m_a": 1.0, "T_a_in": 25.0, "W_a_in": 0.01, "T_w_in": 7.0, "T_set": np.full(60, 14.0)}


def problems(function, *args, **kwargs):
    with pytest.raises(InputError) as caught:
        function(*args, **kwargs)
    assert caught.value.exit_code == 2
    return caught.value.problems


def only_problem(function, *args, **kwargs):
    (problem,) = problems(function, *args, **kwargs)
    return problem


# ------------------------------------------------------------------------------------------------------ shapes


def test_every_series_is_float64_days_by_steps_and_read_only():
    boundary = Boundary(**GOOD)
    assert list(boundary.series) == list(SERIES)
    for values in boundary.series.values():
        assert values.shape == (1, 60)
        assert values.dtype == np.float64
        assert values.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            values[0, 0] = 1.0
    assert (boundary.series["noise"] == 0.0).all()
    assert (boundary.series["enabled"] == 1.0).all()
    assert (boundary.n_days, boundary.n_steps, boundary.hours) == (1, 60, 60 / 3600)
    assert boundary.has_day_dim is False
    np.testing.assert_array_equal(boundary.day, [0])


def test_a_boundary_cannot_be_changed():
    boundary = Boundary(**GOOD)
    with pytest.raises(AttributeError):
        boundary.day = [3]
    boundary.series["m_a"] = np.zeros((1, 60))
    assert (boundary.series["m_a"] == 1.0).all()


def test_the_users_array_stays_his_own():
    T_set = np.full(60, 14.0)
    boundary = Boundary(**GOOD | {"T_set": T_set})
    T_set[:] = 99.0
    assert (boundary.series["T_set"] == 14.0).all()


def test_numbers_series_and_days_broadcast_together():
    T_w_in = xr.DataArray([6.0, 8.0], dims="day", coords={"day": [4, 2]})
    T_a_in = xr.DataArray(np.arange(60.0) / 10, dims="elapsed_time")
    m_a = np.array([[1.0] * 60, [2.0] * 60])
    boundary = Boundary(**GOOD | {"T_w_in": T_w_in, "T_a_in": T_a_in, "m_a": m_a})
    assert boundary.has_day_dim
    np.testing.assert_array_equal(boundary.day, [4, 2])
    np.testing.assert_array_equal(boundary.series["T_w_in"][:, 7], [6.0, 8.0])
    np.testing.assert_array_equal(boundary.series["T_a_in"][1], np.arange(60.0) / 10)
    np.testing.assert_array_equal(boundary.series["m_a"][:, 59], [1.0, 2.0])


def test_a_transposed_dataarray_means_the_same():
    values = xr.DataArray(np.random.default_rng(0).uniform(0, 5, (3, 60)), dims=("day", "elapsed_time"))
    assert Boundary(**GOOD | {"m_a": values}) == Boundary(**GOOD | {"m_a": values.T})


def test_labels_alone_make_a_day_dim_and_one_number_does_not():
    assert Boundary(**GOOD, day=[9]).has_day_dim
    assert Boundary(**GOOD, day=[9, 1]).series["m_a"].shape == (2, 60)
    alone = Boundary(**GOOD, day=9)
    assert not alone.has_day_dim
    np.testing.assert_array_equal(alone.day, [9])


def test_a_dataarrays_declared_unit_is_honoured():
    fahrenheit = xr.DataArray(np.full(60, 77.0), dims="elapsed_time", attrs={"units": "degF"})
    np.testing.assert_allclose(Boundary(**GOOD | {"T_a_in": fahrenheit}).series["T_a_in"], 25.0, rtol=1e-14)
    wrong = fahrenheit.assign_attrs(units="Fahrenheit")
    message = only_problem(Boundary, **GOOD | {"T_a_in": wrong})
    assert "T_a_in" in message
    assert "'Fahrenheit'" in message
    assert "degF" in message


def test_mist_is_legal():
    assert Boundary(**GOOD | {"T_a_in": 5.0, "W_a_in": 0.02}).n_steps == 60


# -------------------------------------------------------------------------------------------- sameness, round trip


def test_equality_and_digest_follow_names_labels_and_samples():
    boundary = Boundary(**GOOD)
    assert boundary == Boundary(**GOOD)
    assert hash(boundary) == hash(Boundary(**GOOD))
    assert boundary != "boundary"
    others = [
        Boundary(**GOOD | {"T_a_in": np.nextafter(25.0, 26.0)}),
        Boundary(**GOOD | {"m_a": 7.0, "T_w_in": 1.0}),
        Boundary(**GOOD, day=1),
        Boundary(**GOOD, day=[0]),
        Boundary(**GOOD | {"T_set": np.full(61, 14.0)}),
    ]
    assert len({boundary.sha256, *(other.sha256 for other in others)}) == 6
    assert Boundary(**GOOD, noise=-0.0) == boundary


def test_the_digest_is_the_same_in_another_process():
    """A constant: change it only together with the version in the digest, because results carry it."""
    code = (
        "import numpy as np; from fastcoil.boundary import Boundary;"
        "print(Boundary(m_a=1, T_a_in=25, W_a_in=.0078125, T_w_in=7, T_set=np.arange(60) // 30 + 13., day=[3]).sha256)"
    )
    root = os.path.dirname(os.path.dirname(__file__))
    env = os.environ | {"PYTHONHASHSEED": "7", "PYTHONPATH": root}
    out = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert out.stdout.strip() == DIGEST


@pytest.mark.parametrize("seed", [1, [5, 3]])
def test_dataset_pickle_and_copy_round_trips(seed):
    boundary = paper_day(0.1, seed)
    for other in (
        Boundary.from_dataset(boundary.to_dataset()),
        pickle.loads(pickle.dumps(boundary)),
        copy.deepcopy(boundary),
    ):
        assert other == boundary
        np.testing.assert_array_equal(other.day, boundary.day)
        assert other.has_day_dim == boundary.has_day_dim
        assert not other.series["m_a"].flags.writeable


def test_netcdf_round_trip(tmp_path):
    pytest.importorskip("netCDF4")
    boundary = paper_day(0.05, [5, 3])
    boundary.to_dataset().to_netcdf(tmp_path / "day.nc")
    with xr.open_dataset(tmp_path / "day.nc") as ds:
        assert Boundary.from_dataset(ds) == boundary


def test_dataset_has_units_names_and_coordinates():
    ds = paper_day(0.1, [5, 3]).to_dataset()
    assert ds.sizes == {"day": 2, "elapsed_time": 360}
    assert ds.elapsed_time.attrs["units"] == "s"
    assert ds.elapsed_time.values[-1] == 359.0
    for name, series in SERIES.items():
        assert ds[name].attrs["units"] == series.unit
        assert ds[name].attrs["long_name"]
    assert ds.noise.attrs["units_metadata"] == "temperature: difference"
    assert paper_day(0.1).to_dataset().m_a.dims == ("elapsed_time",)


def test_one_day_cut_out_of_a_dataset_keeps_its_label():
    ds = paper_day(0.1, [5, 3]).to_dataset()
    one = Boundary.from_dataset(ds.isel(day=1))
    assert not one.has_day_dim
    np.testing.assert_array_equal(one.day, [3])
    np.testing.assert_array_equal(one.series["m_a"], ds.m_a.values[1:])


def test_from_dataset_ignores_other_variables_and_any_start():
    ds = paper_day(0.1).to_dataset()
    ds["T_outside"] = ("elapsed_time", np.full(360, np.nan))
    later = Boundary.from_dataset(ds.isel(elapsed_time=slice(100, None)))
    np.testing.assert_array_equal(later.series["m_a"][0], ds.m_a.values[100:])


def test_describe_and_repr_are_one_short_line():
    boundary = paper_day(0.5, range(3))
    assert boundary.describe().startswith("0.5 h x 3 days: m_a 1.0")
    assert "T_set 14 degC" in boundary.describe()
    assert "noise" not in boundary.describe()
    assert "\n" not in boundary.describe()
    assert repr(boundary) == f"<fastcoil.Boundary 0.5 h x 3 days, sha256 {boundary.sha256[:8]}>"


# --------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("m_a", -0.1, ["m_a = -0.1 kg s-1", "from 0 to 200"]),
        ("m_a", 1200.0, ["m_a = 1200 kg s-1", "unit"]),
        ("T_a_in", 77.0, ["T_a_in = 77 degC", "from -40 to 60", "unit"]),
        ("T_a_in", 298.15, ["T_a_in = 298.15 degC", "unit"]),
        ("W_a_in", 9.3, ["W_a_in = 9.3", "from 0 to 0.1"]),
        ("T_w_in", 0.0, ["T_w_in = 0 degC", "from 0.5 to 120"]),
        ("T_set", np.full(60, 95.0), ["T_set = 95 degC at second 0", "from -20 to 80"]),
        ("noise", -51.0, ["noise = -51 K", "from -50 to 50"]),
        ("enabled", 0.5, ["enabled = 0.5", "whole, from 0 to 1"]),
        ("T_a_in", float("nan"), ["T_a_in is nan", "fill or cut"]),
        ("T_w_in", float("inf"), ["T_w_in is inf", "fill or cut"]),
        ("T_w_in", -999.0, ["T_w_in = -999 degC", "missing value"]),
        ("T_a_in", "25", ["T_a_in = '25'", "give numbers"]),
        ("m_a", [[1.0], [1.0, 2.0]], ["m_a", "different length"]),
        ("m_a", True, ["m_a = True", "bool", "give numbers"]),
        ("m_a", [], ["m_a is empty", "at least one"]),
        ("m_a", np.ones((1, 1, 60)), ["m_a has 3 dimensions", "(days, seconds)"]),
        ("m_a", None, ["m_a is missing", "air flow", "kg s-1"]),
        ("m_a", xr.DataArray(np.ones(60), dims="time"), ["m_a", "('time',)", "elapsed_time"]),
        ("m_a", np.ones(59), ["T_set has 60 samples where m_a has 59", "as many"]),
    ],
)
def test_a_bad_series_is_named_with_its_value_and_the_cure(name, value, words):
    message = only_problem(Boundary, **GOOD | {name: value})
    for word in words:
        assert word in message, message


def test_the_first_offending_second_and_day_are_named():
    T_a_in = np.full((3, 60), 25.0)
    T_a_in[1, 40:43] = 61.0
    message = only_problem(Boundary, **GOOD | {"T_a_in": T_a_in}, day=[10, 20, 30])
    assert "T_a_in = 61 degC at second 40 of day 20" in message
    assert "(3 samples are so)" in message
    masked = np.ma.masked_equal(T_a_in[1], 61.0)
    assert "T_a_in is nan at second 40" in only_problem(Boundary, **GOOD | {"T_a_in": masked})


def test_all_mistakes_are_raised_at_once():
    found = problems(
        Boundary, m_a=-1.0, T_a_in=np.full(60, np.nan), W_a_in=0.01, T_w_in=np.full(61, 7.0), T_set="x", day=[1, 1]
    )
    assert len(found) == 5
    for name, text in zip(("T_set", "T_w_in", "day label 1", "m_a", "T_a_in"), found, strict=True):
        assert name in text


def test_numbers_alone_are_refused():
    assert "constant_day" in only_problem(Boundary, **GOOD | {"T_set": 14.0})


@pytest.mark.parametrize(
    ("day", "words"),
    [
        ([1, 1], ["day label 1", "twice"]),
        ([-1, 2], ["day = [-1, 2]", "from 0 to 4294967295"]),
        ([2**32, 2], ["4294967296", "from 0 to 4294967295"]),
        ([0.5, 2], ["day = [0.5, 2]", "whole"]),
        (["mon", "tue"], ["day = ['mon', 'tue']", "whole"]),
        ([True, False], ["day = [True, False]", "whole"]),
        ([1, 2, 3], ["3 labels for 2 days", "one label for each"]),
        ([], ["day = []", "one a day"]),
    ],
)
def test_bad_day_labels(day, words):
    message = only_problem(Boundary, **GOOD | {"m_a": np.ones((2, 60))}, day=day)
    for word in words:
        assert word in message


def test_days_that_disagree():
    two, three = np.ones((2, 60)), np.full((3, 60), 7.0)
    message = only_problem(Boundary, **GOOD | {"m_a": two, "T_w_in": three})
    assert "T_w_in has 3 days where m_a has 2" in message
    a = xr.DataArray([1.0, 2.0], dims="day", coords={"day": [1, 2]})
    b = xr.DataArray([7.0, 8.0], dims="day", coords={"day": [2, 1]})
    message = only_problem(Boundary, **GOOD | {"m_a": a, "T_w_in": b})
    assert "T_w_in has day [2 1] where m_a has [1 2]" in message


def test_from_dataset_is_strict():
    ds = paper_day(0.1).to_dataset()
    message = only_problem(Boundary.from_dataset, ds.isel(elapsed_time=slice(None, None, 5)))
    assert "elapsed_time has a step of 5 s after sample 0: give 1-s steps" in message
    gap = ds.isel(elapsed_time=[*range(50), *range(53, 360)])
    assert "elapsed_time has a step of 4 s after sample 49" in only_problem(Boundary.from_dataset, gap)
    message = only_problem(Boundary.from_dataset, ds.drop_vars("T_w_in"))
    assert "T_w_in is missing" in message
    assert "entering water temperature" in message
    assert "units" in only_problem(Boundary.from_dataset, ds.assign(m_a=ds.m_a.drop_attrs()))
    assert "coordinate" in only_problem(Boundary.from_dataset, ds.drop_vars("elapsed_time"))


# ------------------------------------------------------------------------------------------------- the paper's day


def test_paper_day_follows_its_formula():
    """Away from the noise: the mean over many seeds, whose standard error is known."""
    n = 40
    boundary = paper_day(16.0, range(n))
    h = np.arange(16 * 3600) / 3600
    D = np.array([np.sin(np.pi * ((x if x <= 8 else 16 - x) - 1) / 9) for x in h])
    expected = {
        "m_a": (1.15 + 0.18 * D, 0.015),
        "T_a_in": (25 + 1.5 * D, 0.10),
        "T_w_in": (7 + 0.4 * np.sin(2 * np.pi * h / 1.5), 0.05),
    }
    for name, (formula, std) in expected.items():
        error = np.abs(boundary.series[name].mean(axis=0) - formula)
        assert error.max() < 5.5 * std / np.sqrt(n)
    rh = boundary.series["W_a_in"] / moist_air.saturation_humidity_ratio(boundary.series["T_a_in"])
    # W/W_s differs from the relative humidity by the factor (p - p_s)/(p - p_w), 1.5 % here.
    assert np.abs(rh.mean(axis=0) - (0.56 - 0.05 * D)).max() < 0.012


def test_paper_day_mirrors_about_8_hours_and_repeats_after_16(monkeypatch):
    monkeypatch.setattr(days, "DRIFTS", {name: days.Drift(0.0, drift.tau) for name, drift in days.DRIFTS.items()})
    m_a = paper_day(40.0).series["m_a"][0]
    t = np.arange(0, 8 * 3600, 97)
    np.testing.assert_allclose(m_a[8 * 3600 + t], m_a[8 * 3600 - t], atol=1e-12)
    np.testing.assert_allclose(m_a[16 * 3600 + t], m_a[t], atol=1e-12)
    assert m_a[3600] == pytest.approx(1.15, abs=1e-15)
    assert m_a[5 * 3600 + 1800] == pytest.approx(1.15 + 0.18, abs=1e-12)


def test_paper_day_set_points_hold_30_minutes_and_repeat():
    T_set = paper_day(17.0).series["T_set"][0].reshape(-1, 1800)
    assert (T_set == T_set[:, :1]).all()
    holds = [14, 13, 15, 14, 12.5, 13.5, 15.5, 14.5, 13, 12, 14, 16, 15, 13.5, 12.5, 14]
    np.testing.assert_array_equal(T_set[:, 0], [*holds, *holds, 14, 13])


@pytest.mark.parametrize("hours", [1 / 3600, 0.01, 1.0, 7.5, 8.0 - 1 / 3600])
def test_a_shorter_day_is_the_beginning_of_a_longer_one(hours):
    short, long = paper_day(hours, [1, 77]), paper_day(8.0, [77, 5, 1])
    assert short.n_steps == round(hours * 3600)
    for name, values in short.series.items():
        np.testing.assert_array_equal(values[0], long.series[name][2, : short.n_steps])
        np.testing.assert_array_equal(values[1], long.series[name][0, : short.n_steps])


def test_a_seed_gives_the_same_day_alone_and_among_others():
    several = paper_day(0.5, range(10, 13))
    np.testing.assert_array_equal(several.day, [10, 11, 12])
    np.testing.assert_array_equal(paper_day(0.5, 11).series["T_w_in"][0], several.series["T_w_in"][1])
    assert paper_day(0.5, np.int64(11)) == paper_day(0.5, 11) != paper_day(0.5, 12)
    assert paper_day(0.5, [11]).has_day_dim
    assert not paper_day(0.5, 11).has_day_dim


@pytest.mark.parametrize("drift", days.DRIFTS.values(), ids=days.DRIFTS)
def test_noise_has_the_stated_deviation_from_the_first_second_on(drift):
    """Over 3000 seeds the standard error of a standard deviation is 1.3 %."""
    samples = np.array([days.smooth_noise(1, drift, (seed, 0))[0] for seed in range(3000)])
    assert samples.std() == pytest.approx(drift.std, rel=0.055)
    assert abs(samples.mean()) < 4 * drift.std / np.sqrt(3000)


def test_noise_has_the_autocorrelation_of_two_equal_filters():
    """In continuous time it is (1 + s/tau) exp(-s/tau)."""
    tau = 60
    x = days.smooth_noise(400_000, days.Drift(1.0, tau), (0, 0))
    for lag in (30, 60, 120):
        expected = (1 + lag / tau) * np.exp(-lag / tau)
        assert np.mean(x[lag:] * x[:-lag]) == pytest.approx(expected, abs=0.05)


def test_stationary_deviation_is_that_of_the_filters_impulse_response():
    k = 1 - np.exp(-1 / 60)
    impulse = lfilter([k], [1, k - 1], lfilter([k], [1, k - 1], np.eye(1, 4000)[0]))
    raw = np.random.default_rng(np.random.SeedSequence(3, spawn_key=(2,))).standard_normal(601)
    for_hand = 0.0, 0.0
    for x in raw:
        first = for_hand[0] + k * (x - for_hand[0])
        for_hand = first, for_hand[1] + k * (first - for_hand[1])
    expected = for_hand[1] / np.sqrt(np.sum(impulse**2))
    assert days.smooth_noise(1, days.Drift(1.0, 60), (3, 2))[0] == pytest.approx(expected, rel=1e-10)


def test_noise_of_two_series_and_of_two_seeds_is_uncorrelated():
    drift = days.Drift(1.0, 5)
    a, b, c = (days.smooth_noise(100_000, drift, stream) for stream in ((1, 0), (1, 1), (2, 0)))
    assert abs(np.mean(a * b)) < 0.04
    assert abs(np.mean(a * c)) < 0.04


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"hours": 0}, ["hours = 0 h", "above 0"]),
        ({"hours": -8}, ["hours = -8 h", "above 0"]),
        ({"hours": float("nan")}, ["hours = nan", "finite"]),
        ({"hours": "8"}, ["hours = '8'", "number"]),
        ({"hours": True}, ["hours = True", "number"]),
        ({"hours": None}, ["hours is missing"]),
        ({"hours": 1e-5}, ["hours = 1e-05", "whole number of seconds"]),
        ({"hours": 1 / 7000}, ["whole number of seconds"]),
        ({"hours": 1e6}, ["hours = 1e+06 h", "8760"]),
        ({"seed": -1}, ["seed = -1", "from 0 to 4294967295"]),
        ({"seed": 2**32}, ["seed = 4294967296", "from 0 to 4294967295"]),
        ({"seed": True}, ["seed = True", "whole number"]),
        ({"seed": "1"}, ["seed = '1'", "whole number"]),
        ({"seed": 1.0}, ["seed = 1.0", "whole number"]),
        ({"seed": None}, ["seed = None", "whole number"]),
        ({"seed": [1, 2.5]}, ["seed = 2.5", "whole number"]),
        ({"seed": [4, 1, 4]}, ["seed", "4 twice", "distinct"]),
        ({"seed": []}, ["seed is empty"]),
        ({"seed": range(10**12)}, ["seed", "more than 1736 days", "give fewer"]),
    ],
)
def test_paper_day_refuses(arguments, words):
    message = only_problem(paper_day, **arguments)
    for word in words:
        assert word in message, message


# --------------------------------------------------------------------------------------- constant and design days


def test_constant_day_is_constant_and_the_centre_of_paper_day():
    boundary = constant_day(0.5)
    for values in boundary.series.values():
        assert np.ptp(values) == 0.0
    first = {name: values[0, 0] for name, values in boundary.series.items()}
    assert first == {
        "m_a": 1.15,
        "T_a_in": 25.0,
        "W_a_in": float(moist_air.humidity_ratio(25.0, 0.56)),
        "T_w_in": 7.0,
        "T_set": 14.0,
        "noise": 0.0,
        "enabled": 1.0,
    }
    assert constant_day(0.5, W_a_in=0.01).series["W_a_in"][0, 0] == 0.01
    assert constant_day(0.5, T_set=np.linspace(13, 14, 1800)).n_steps == 1800


def test_constant_day_refuses():
    assert "give one of them" in only_problem(constant_day, W_a_in=0.01, relative_humidity=0.5)
    assert "relative_humidity = 56" in only_problem(constant_day, relative_humidity=56)
    found = problems(constant_day, m_a=-1.0, T_w_in=280.0, T_set=[14.0, 15.0])
    assert any("T_set has 2 samples" in text or "where T_set has 2" in text for text in found)
    assert any("T_w_in = 280 degC" in text for text in found)
    assert any("m_a = -1" in text for text in found)


def test_design_day_outdoors_follows_the_handbooks_profile():
    """With outdoor air only, the entering air is the outdoor air."""
    cooling = design_day(24.0, outdoor_fraction=1.0, start_hour=0.0).series
    T = cooling["T_a_in"][0]
    assert T.max() == pytest.approx(33.3, abs=1e-10)
    assert T.max() - T.min() == pytest.approx(10.5, abs=1e-10)
    assert T[14 * 3600] == T[15 * 3600] == T.max()
    assert np.argmin(T) == 5 * 3600
    assert T[9 * 3600] == pytest.approx(33.3 - 0.55 * 10.5, abs=1e-10)
    assert T[9 * 3600 + 1800] == pytest.approx(33.3 - (0.55 + 0.38) / 2 * 10.5, abs=1e-10)
    assert T[0] == pytest.approx(33.3 - 0.82 * 10.5, abs=1e-10)
    # Independent value of the humidity ratio: PsychroLib at 33.3/23.7 degC, 98 934 Pa.
    np.testing.assert_allclose(cooling["W_a_in"], 0.014935627057992496, rtol=1e-9)


def test_design_day_in_heating_is_coldest_at_hour_5():
    flat = design_day(24.0, "heating", outdoor_fraction=1.0).series["T_a_in"]
    np.testing.assert_allclose(flat, -20.0, atol=1e-10)
    T = design_day(24.0, "heating", outdoor_fraction=1.0, T_daily_range=8.0, start_hour=0.0).series["T_a_in"][0]
    assert np.argmin(T) == 5 * 3600
    assert T.min() == pytest.approx(-20.0, abs=1e-10)
    assert T.max() == pytest.approx(-12.0, abs=1e-10)


def test_design_day_mixes_with_return_air_and_starts_at_its_hour():
    mixed, outdoors = (design_day(2.0, outdoor_fraction=x, start_hour=23.0).series for x in (0.3, 1.0))
    whole = design_day(24.0, outdoor_fraction=1.0, start_hour=0.0).series["T_a_in"][0]
    np.testing.assert_allclose(outdoors["T_a_in"][0], np.roll(whole, 3600)[:7200], atol=1e-9)
    W_return = moist_air.humidity_ratio(24.0, 0.5, days.DESIGN_PRESSURE)
    np.testing.assert_allclose(mixed["W_a_in"], 0.3 * outdoors["W_a_in"] + 0.7 * W_return, rtol=1e-12)
    assert (mixed["T_a_in"] < 0.3 * outdoors["T_a_in"] + 0.7 * 24.0 + 0.1).all()


def test_design_day_outdoor_air_is_at_most_saturated():
    series = design_day(24.0, T_design=20.0, T_wet_bulb=19.5, T_daily_range=15.0, outdoor_fraction=1.0).series
    saturated = moist_air.saturation_humidity_ratio(series["T_a_in"], days.DESIGN_PRESSURE)
    assert (series["W_a_in"] <= saturated * (1 + 1e-12)).all()
    assert (series["W_a_in"] > 0.999 * saturated).any()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"mode": "cool"}, ["mode = 'cool'", "'cooling' or 'heating'"]),
        ({"hours": 0}, ["hours = 0 h"]),
        ({"outdoor_fraction": 30}, ["outdoor_fraction = 30", "from 0 to 1"]),
        ({"T_design": 92.0}, ["T_design = 92 degC", "from -40 to 60"]),
        ({"T_wet_bulb": 35.0}, ["T_wet_bulb = 35 degC", "T_design = 33.3"]),
        ({"start_hour": 25}, ["start_hour = 25 h", "from 0 to 24"]),
        ({"RH_return": 50}, ["RH_return = 50", "from 0 to 1"]),
        ({"pressure": 101.3}, ["pressure = 101.3 Pa"]),
        ({"T_w_in": 44.6 + 273}, ["T_w_in = 317.6 degC"]),
    ],
)
def test_design_day_refuses(arguments, words):
    message = only_problem(design_day, **arguments)
    for word in words:
        assert word in message, message
