"""``simulate``: the shape and words of a result, what is refused, and what leaves a result the same."""

import json
import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from fastcoil import plan as plan_module
from fastcoil import results
from fastcoil.boundary import moist_air
from fastcoil.errors import StorageError
from fastcoil.outputs import METRICS, STATUS_MEANINGS, TRACES
from fastcoil.parameter_table import PARAMETERS
from fastcoil.stability import check_stability

pytestmark = pytest.mark.kernel

SWEEP = {"backlash": [0.0, 0.07, 0.15], "kp": ("tuning", [0.01, 0.03]), "ti": ("tuning", [20.0, 8.0])}


@pytest.fixture(scope="module")
def days():
    return fc.paper_day(hours=0.25, seed=[4, 1])


@pytest.fixture(scope="module")
def swept(days):
    loop = fc.Loop(**SWEEP, noise_std=0.02, n_volumes=[4, 8])
    names = ["T_sup", "mode", "T_c"]
    return fc.simulate(loop, days, traces=names, trace_interval=50, warm_up=100, replicates=2, seed=7)


def refused(*args, **options):
    with pytest.raises(fc.InputError) as caught:
        fc.simulate(*args, **options)
    assert caught.value.exit_code == 2
    return caught.value.problems


# The Dataset


def test_dims_are_those_of_the_sweep_and_the_day_and_the_replicates(swept):
    assert dict(swept.sizes) == {
        "day": 2,
        "backlash": 3,
        "tuning": 2,
        "n_volumes": 2,
        "replicate": 2,
        "elapsed_time": 18,
        "volume": 8,
    }
    dims = ("day", "backlash", "tuning", "n_volumes", "replicate")
    assert all(swept[name].dims == dims for name in [*METRICS, "status"])
    assert swept.T_sup.dims == (*dims, "elapsed_time")
    assert swept.T_c.dims == (*dims, "volume", "elapsed_time")


def test_coordinates_are_labels_and_the_parameters_along_them(swept):
    assert swept.day.values.tolist() == [4, 1]
    assert swept.backlash.values.tolist() == [0.0, 0.07, 0.15]
    assert swept.kp.dims == swept.ti.dims == ("tuning",)
    assert swept.ti.values.tolist() == [20.0, 8.0]
    assert swept.replicate.values.tolist() == [0, 1]
    assert swept.volume.values.tolist() == list(range(1, 9))
    assert swept.elapsed_time.values.tolist() == list(range(0, 900, 50))
    assert swept.rmse.sel(backlash=0.07, day=1, n_volumes=8).sizes == {"tuning": 2, "replicate": 2}


def test_variables_are_metrics_status_and_the_traces_asked_for(swept):
    assert set(swept.data_vars) == {*METRICS, "status", "T_sup", "mode", "T_c"}
    assert list(fc.simulate(fc.Loop(), fc.paper_day(hours=0.1), warm_up=0).data_vars) == [*METRICS, "status"]


def test_everything_has_a_unit_and_a_long_name(swept):
    for name, output in (METRICS | {n: TRACES[n] for n in ("T_sup", "mode", "T_c")}).items():
        attrs = swept[name].attrs
        assert (attrs["units"], attrs["long_name"]) == (output.unit, output.long_name)
        assert (attrs.get("units_metadata") == "temperature: difference") == output.difference
    for name in swept.coords:
        assert swept[name].attrs["long_name"]
    assert swept.kp.attrs["units"] == PARAMETERS["kp"].unit == "K-1"
    assert swept.elapsed_time.attrs["units"] == "s"


def test_status_has_cf_flags(swept):
    assert swept.status.dtype == np.int8
    assert swept.status.attrs["flag_values"].tolist() == list(range(5))
    assert swept.status.attrs["flag_meanings"].split() == list(STATUS_MEANINGS)
    assert np.all(swept.status == 0)


def test_provenance_names_no_user_and_no_path(swept):
    attrs = swept.attrs
    assert json.loads(attrs["parameters"]) == fc.Loop(**SWEEP, noise_std=0.02, n_volumes=[4, 8]).constants
    assert (attrs["seed"], attrs["warm_up_s"], attrs["Conventions"]) == ("7", 100, "CF-1.11")
    assert len(attrs["content_sha256"]) == len(attrs["boundary_sha256"]) == 64
    text = " ".join(map(str, attrs.values()))
    assert str(Path.home()) not in text
    assert os.getcwd() not in text


def test_volumes_a_scenario_does_not_have_are_missing(swept):
    few, many = swept.T_c.sel(n_volumes=4), swept.T_c.sel(n_volumes=8)
    assert np.all(np.isnan(few.sel(volume=slice(5, None))))
    assert np.all(np.isfinite(few.sel(volume=slice(4))))
    assert np.all(np.isfinite(many))


@pytest.mark.parametrize("interval", [1, 7, 60, 900])
def test_trace_interval_takes_the_sample_at_that_second(days, interval):
    every = fc.simulate(fc.Loop(), days, traces=["T_sup", "wet_volumes", "T_w"], warm_up=100)
    some = fc.simulate(fc.Loop(), days, traces=["T_sup", "wet_volumes", "T_w"], warm_up=100, trace_interval=interval)
    assert some.sizes["elapsed_time"] == -(-900 // interval)
    xr.testing.assert_equal(some, every.isel(elapsed_time=slice(None, None, interval)))


def test_each_trace_alone_is_the_trace_among_others(days):
    together = fc.simulate(fc.Loop(), days, traces=list(TRACES), warm_up=100)
    backwards = fc.simulate(fc.Loop(), days, traces=list(TRACES)[::-1], warm_up=100)
    for name in TRACES:
        alone = fc.simulate(fc.Loop(), days, traces=[name], warm_up=100)
        assert alone[name].identical(together[name])
        assert backwards[name].identical(together[name])


# Open loop


def test_open_loop_has_no_controller(short):
    command = np.linspace(0.0, 1.0, short.n_steps)
    ds = fc.simulate(fc.Loop(backlash=[0.0, 0.1]), short, command=command, traces=list(TRACES), warm_up=60)
    for name in ("u", "integral", "estimate"):
        assert np.all(np.isnan(ds[name]))
    assert ds["mode"].dtype == np.int8
    assert np.all(ds["mode"] == 0)
    assert np.all(np.isnan(ds.switch_frequency))
    assert np.all(np.isnan(ds.estimate_final))
    np.testing.assert_array_equal(ds.command.values, np.broadcast_to(command, (2, short.n_steps)))
    np.testing.assert_array_equal(ds.opening.sel(backlash=0.0).values, command)
    assert "command_sha256" in ds.attrs


def test_each_day_may_have_its_own_command(days):
    commands = np.array([[0.2] * 900, [0.6] * 900])
    ds = fc.simulate(fc.Loop(), days, command=commands, traces=["command"], warm_up=60)
    np.testing.assert_array_equal(ds.command.values, commands)
    same = fc.simulate(fc.Loop(), days, command=commands[0], traces=["command"], warm_up=60)
    np.testing.assert_array_equal(same.command.values, np.full((2, 900), 0.2))


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (np.zeros(899), ["shape (899,)", "(900,)", "(2, 900)"]),
        (np.zeros((3, 900)), ["shape (3, 900)"]),
        (0.5, ["shape ()"]),
        (np.r_[np.zeros(400), 1.1, np.zeros(499)], ["1.1 at second 400", "0 to 1"]),
        (np.r_[np.zeros(400), np.nan, np.zeros(499)], ["nan at second 400", "0 to 1"]),
        (np.full(900, -0.01), ["-0.01 at second 0", "0 to 1"]),
        ("half", ["command"]),
    ],
)
def test_bad_command(days, command, words):
    (problem,) = refused(fc.Loop(), days, command=command, warm_up=60)
    assert problem.startswith("command")
    assert all(word in problem for word in words)


# Refusals


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"traces": ["T_supp"]}, ["'T_supp'", "'T_sup'", "wet_volumes"]),
        ({"traces": ["T_sup", "T_sup"]}, ["T_sup", "twice"]),
        ({"traces": [None]}, ["None", "not a trace"]),
        ({"trace_interval": 0}, ["trace_interval = 0", "at least 1"]),
        ({"trace_interval": 901}, ["trace_interval = 901", "at most 900"]),
        ({"trace_interval": 2.0}, ["trace_interval = 2.0", "whole"]),
        ({"warm_up": -1}, ["warm_up = -1", "at least 0"]),
        ({"warm_up": True}, ["warm_up = True", "whole"]),
        ({"warm_up": 900}, ["900 s", "warm-up"]),
        ({"seed": -1}, ["seed = -1"]),
        ({"seed": 2**64}, ["seed", str(2**64 - 1)]),
        ({"seed": "7"}, ["seed = '7'", "whole"]),
        ({"replicates": 0}, ["replicates = 0"]),
        ({"n_jobs": 0}, ["n_jobs = 0"]),
        ({"n_jobs": True}, ["n_jobs = True"]),
    ],
)
def test_bad_options_are_named_with_the_cure(days, options, words):
    (problem,) = refused(fc.Loop(), days, **{"warm_up": 60} | options)
    assert all(word in problem for word in words), problem


@pytest.mark.parametrize("traces", [None, [["T_sup"]]])
def test_traces_that_are_no_list_of_names(days, traces):
    assert refused(fc.Loop(), days, traces=traces, warm_up=60)


def test_all_bad_options_are_reported_at_once(days):
    assert len(refused(fc.Loop(), days, traces=["u", "u", "v"], trace_interval=0, seed=-1, replicates=1.5)) == 5


def test_the_default_warm_up_refuses_a_shorter_boundary(days):
    (problem,) = refused(fc.Loop(), days)
    assert "900 s" in problem
    assert "1800 s" in problem


def test_other_things_than_a_loop_and_a_boundary(days):
    assert "dict" in refused({}, days)[0]
    assert "paper_day" in refused(fc.Loop(), days.to_dataset())[0]


def test_seeds_up_to_64_bits_are_taken(days):
    loop = fc.Loop(noise_std=0.1, sample_time=5)
    found = {float(fc.simulate(loop, days, warm_up=60, seed=seed).rmse[0]) for seed in (0, 1, 2**32, 2**64 - 1)}
    assert len(found) == 4


@pytest.mark.parametrize(
    "loop",
    [
        fc.Loop(backlash=np.linspace(0, 0.9, 10**6), kp=np.linspace(0, 1, 10**6)),
        fc.Loop(**{name: np.linspace(1.0, 2.0, 1000) for name in ("kp", "ti", "beta1", "cp_a")}),
    ],
)
def test_a_million_million_scenarios_are_refused_without_allocating(loop, days):
    (problem,) = refused(loop, days, warm_up=60)
    assert "2,000,000,000,000 scenarios" in problem
    assert "GiB" in problem
    assert "fewer" in problem


TOGETHER = {
    "learner": {
        "learning_step": np.linspace(0.01, 0.1, 200),
        "backlash_estimate": np.linspace(0.0, 0.1, 200),
        "learning_cap": np.linspace(0.1, 0.2, 200),
    },
    "ratio": {"estimate_ratio": np.linspace(0.0, 1.0, 3000), "backlash": np.linspace(0.0, 0.1, 3000)},
}


@pytest.mark.parametrize("name", TOGETHER)
def test_nor_is_anything_allocated_to_check_parameters_together(name, days, monkeypatch):
    monkeypatch.setattr(plan_module, "available_memory", lambda: 10**6)
    loop = fc.Loop(**TOGETHER[name])
    tracemalloc.start()
    try:
        assert "scenarios need" in refused(loop, days, warm_up=60)[0]
        assert tracemalloc.get_traced_memory()[1] < 2e6
    finally:
        tracemalloc.stop()


def test_traces_count_towards_the_memory(days, monkeypatch):
    monkeypatch.setattr(plan_module, "available_memory", lambda: 10**6)
    loop = fc.Loop(backlash=np.linspace(0.0, 0.1, 20))
    fc.simulate(loop, days, warm_up=60)
    (problem,) = refused(loop, days, warm_up=60, traces=["T_c"])
    assert "trace_interval" in problem


# Stability


def gamma_and_lambda(day, **coil):
    """γ and λ at full opening, by hand, for a coil of paper_like."""
    p = {n: PARAMETERS[n].default for n in PARAMETERS} | coil
    scale = 8.0 / p["n_volumes"]
    m_w = p["m_max"] * (1 + p["valve_a"] * np.exp(-p["valve_b"] * (1 - p["valve_c"]))) ** (-1 / p["valve_a"])
    m_a = day.series["m_a"].max()
    G_w = (1 - np.exp(-p["beta1"] * scale * m_w ** p["beta2"])) * m_w * p["cp_w"]
    G_a = (1 - np.exp(-p["beta3"] * scale * m_a ** p["beta4"])) * m_a * p["cp_a"]
    dew_point = moist_air.dew_point(day.series["W_a_in"].max(), p["pressure"])
    slope = moist_air.saturation_enthalpy_slope(dew_point, p["pressure"])
    G_wet = (1 - np.exp(-p["beta5"] * scale * m_a ** p["beta6"])) * m_a * slope
    return m_w * p["cp_w"] / (scale * p["C_w"]), (max(G_a, G_wet) + G_w) / (scale * p["C_c"])


COILS = [
    {},
    {"beta1": 0.2, "beta2": -0.1, "beta3": 0.3, "beta4": -0.3, "beta5": 0.6, "beta6": -0.2, "pressure": 95e3,
     "cp_w": 3.9, "cp_a": 1.1, "m_max": 1.7, "valve_a": 1.2, "valve_b": 5.0, "valve_c": 0.5, "n_volumes": 6},
]  # fmt: skip


@pytest.mark.parametrize("coil", COILS)
def test_the_border_of_stability_of_the_water(days, coil):
    limit = gamma_and_lambda(days, C_w=1.0, **coil)[0]
    fc.simulate(fc.Loop(C_w=limit * (1 + 1e-9), **coil), days, warm_up=60)
    (problem,) = refused(fc.Loop(C_w=limit * (1 - 1e-9), **coil), days, warm_up=60)
    assert "unstable" in problem
    assert "γ = " in problem
    assert "λ = " not in problem
    assert f"n_volumes = {coil.get('n_volumes', 8) - 1} or less is stable" in problem
    assert f"raise C_w from {limit:g}" in problem


@pytest.mark.parametrize("coil", COILS)
def test_the_border_of_stability_of_the_metal(days, coil):
    limit = gamma_and_lambda(days, C_c=1.0, **coil)[1]
    fc.simulate(fc.Loop(C_c=limit * (1 + 1e-9), **coil), days, warm_up=60)
    (problem,) = refused(fc.Loop(C_c=limit * (1 - 1e-9), **coil), days, warm_up=60)
    assert "λ = " in problem
    assert "γ = " not in problem
    assert "raise C_c from" in problem


def test_the_border_of_stability_with_an_installed_valve(days):
    """At full opening the water flow of such a valve is ``m_full``."""
    valve = {"rangeability": 50.0, "authority": 0.3, "m_full": 1.7}
    limit = 1.7 * 4.186
    fc.simulate(fc.Loop(C_w=limit * (1 + 1e-9), **valve), days, warm_up=60)
    assert "γ = " in refused(fc.Loop(C_w=limit * (1 - 1e-9), **valve), days, warm_up=60)[0]


def test_a_coil_that_cannot_get_wet_has_the_dry_border():
    day = fc.constant_day(hours=0.25, W_a_in=0.004)
    fc.simulate(fc.Loop(C_c=3.0), day, warm_up=60)
    with pytest.raises(fc.InputError, match="λ"):
        check_stability(plan_module.Layout(fc.Loop(C_c=3.0), fc.constant_day(hours=0.25, W_a_in=0.015)))


@pytest.mark.parametrize("n_volumes", [9, 12, 64])
def test_largest_stable_number_of_volumes(days, n_volumes):
    (problem,) = refused(fc.Loop(n_volumes=n_volumes), days, warm_up=60)
    assert "n_volumes = 8 or less is stable" in problem
    assert f"n_volumes={n_volumes}" in problem


def test_the_advice_works_when_followed(days):
    (problem,) = refused(fc.Loop(n_volumes=11, C_c=2.0), days, warm_up=60)
    C_w, C_c = (
        float(problem.split(f"raise {name} from")[1].split("at least ")[1].split()[0]) for name in ("C_w", "C_c")
    )
    fc.simulate(fc.Loop(n_volumes=11, C_w=C_w, C_c=C_c), days, warm_up=60)
    refused(fc.Loop(n_volumes=11, C_w=0.99 * C_w, C_c=C_c), days, warm_up=60)
    refused(fc.Loop(n_volumes=11, C_w=C_w, C_c=0.99 * C_c), days, warm_up=60)


def test_one_unstable_scenario_refuses_the_study_and_is_counted(days):
    (problem,) = refused(fc.Loop(C_w=[8.8, 9.0, 1.0], backlash=[0.0, 0.1], kp=[0.01, 0.02, 0.03]), days, warm_up=60)
    assert "12 of 36 scenarios" in problem
    assert "C_w=1" in problem


def test_the_unstable_place_is_named_by_its_label(days):
    (problem,) = refused(fc.Loop(C_c=("backlash", [9.0, 1.0]), backlash=[0.03, 0.15]), days, warm_up=60)
    assert "backlash=0.15" in problem


# Sameness


def test_content_hash_does_not_depend_on_the_threads(days, swept):
    loop = fc.Loop(**SWEEP, noise_std=0.02, n_volumes=[4, 8])
    for n_jobs in (1, 2, 3):
        options = {"traces": ["T_sup", "mode", "T_c"], "trace_interval": 50, "warm_up": 100, "replicates": 2, "seed": 7}
        assert fc.simulate(loop, days, n_jobs=n_jobs, **options).content_sha256 == swept.content_sha256


@pytest.mark.parametrize("change", [{"seed": 8}, {"warm_up": 101}, {"trace_interval": 25}, {"traces": ["T_sup"]}])
def test_content_hash_depends_on_what_was_simulated(days, swept, change):
    options = {"traces": ["T_sup", "mode", "T_c"], "trace_interval": 50, "warm_up": 100, "replicates": 2, "seed": 7}
    other = fc.simulate(fc.Loop(**SWEEP, noise_std=0.02, n_volumes=[4, 8]), days, **options | change)
    assert other.content_sha256 != swept.content_sha256


def test_adding_sweep_values_changes_no_scenario(days):
    few = fc.simulate(fc.Loop(backlash=[0.02, 0.07], noise_std=0.05), days, traces=["T_sup"], warm_up=60)
    more = fc.simulate(
        fc.Loop(noise_std=[0.0, 0.05], backlash=[0.15, 0.07, 0.0, 0.02], action=["heating", "cooling"]),
        fc.paper_day(hours=0.25, seed=[1, 9, 4]),
        traces=["T_sup"],
        warm_up=60,
        replicates=3,
    ).sel(noise_std=0.05, backlash=[0.02, 0.07], action="cooling", day=[4, 1], replicate=0)
    for name in [*METRICS, "T_sup"]:
        np.testing.assert_array_equal(more[name].values, few[name].values, err_msg=name)


def test_adding_a_day_changes_no_scenario():
    loop = fc.Loop(noise_std=0.05)
    one = fc.simulate(loop, fc.paper_day(hours=0.25, seed=1), warm_up=60)
    two = fc.simulate(loop, fc.paper_day(hours=0.25, seed=[1, 2]), warm_up=60)
    assert float(two.rmse.sel(day=1)) == float(one.rmse)


def test_a_result_survives_netcdf(tmp_path, swept):
    results.save(swept, tmp_path / "results.nc")
    back = results.load(tmp_path / "results.nc")
    assert back.content_sha256 == swept.content_sha256
    xr.testing.assert_identical(back.drop_attrs(), swept.drop_attrs())
    assert all(back[name].attrs["units"] == swept[name].attrs["units"] for name in METRICS)
    assert [path.name for path in tmp_path.iterdir()] == ["results.nc"]
    assert fc.Loop.from_dataset(back).sizes == fc.Loop.from_dataset(swept).sizes


def test_words_and_open_loops_survive_netcdf(tmp_path, days):
    loop = fc.Loop(action=["cooling", "heating"], kp=xr.DataArray([0.1, 0.2], dims="case", coords={"case": ["a", "ß"]}))
    ds = fc.simulate(loop, days, command=np.full(900, 0.3), traces=["mode"], warm_up=60)
    results.save(ds, tmp_path / "results.nc")
    back = results.load(tmp_path / "results.nc")
    assert back.case.values.tolist() == ["a", "ß"]
    assert back.content_sha256 == ds.content_sha256


def damaged_value(ds):
    ds.rmse[0, 1, 0, 1, 0] += 1e-15


def damaged_label(ds):
    ds["backlash"] = [0.0, np.nextafter(0.07, 1.0), 0.15]


def damaged_unit(ds):
    ds.rmse.attrs["units"] = "degC"


def damaged_parameter(ds):
    ds.attrs["parameters"] = ds.attrs["parameters"].replace("8.8", "8.9")


@pytest.mark.parametrize("damage", [damaged_value, damaged_label, damaged_unit, damaged_parameter])
def test_a_changed_file_is_detected(tmp_path, swept, damage):
    changed = swept.copy(deep=True)
    damage(changed)
    results.save(changed, tmp_path / "results.nc")
    with pytest.raises(StorageError, match="not as it was written"):
        results.load(tmp_path / "results.nc")


@pytest.mark.parametrize("keep", [0.0, 0.01, 0.5])
def test_a_cut_file_is_detected(tmp_path, swept, keep):
    path = tmp_path / "results.nc"
    results.save(swept, path)
    image = path.read_bytes()
    path.write_bytes(image[: int(keep * len(image))])
    with pytest.raises(StorageError, match=r"results\.nc"):
        results.load(path)


def test_a_missing_file_and_an_unwritable_place(tmp_path, swept):
    with pytest.raises(fc.InputError, match="does not exist"):
        results.load(tmp_path / "none.nc")
    with pytest.raises(StorageError, match="cannot be written"):
        results.save(swept, tmp_path / "no folder" / "results.nc")


def test_saving_over_a_result_leaves_one_of_the_two(tmp_path, swept):
    path = tmp_path / "results.nc"
    results.save(swept, path)
    other = fc.simulate(fc.Loop(), fc.paper_day(hours=0.1), warm_up=0)
    results.save(other, path)
    assert results.load(path).content_sha256 == other.content_sha256


# What fails


def test_a_controller_gone_nan_is_flagged(short):
    ds = fc.simulate(fc.Loop(ti=1e-320, sensor_resolution=0.5), short, traces=["u"], warm_up=60)
    assert int(ds.status) != 0


def test_fc_simulate_stays_a_function():
    code = "import fastcoil as fc; fc.open_study; print(callable(fc.simulate))"
    command = [sys.executable, "-c", code]
    found = subprocess.run(command, capture_output=True, text=True, check=True, env=os.environ)
    assert found.stdout.strip() == "True"
