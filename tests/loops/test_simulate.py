"""``simulate``: the shape and words of a result, and what leaves a result the same."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import fastcoil as fc
from fastcoil.loops import simulate
from fastcoil.model.metric_table import METRICS, STATUS_MEANINGS, TRACES
from fastcoil.model.parameter_table import PARAMETERS

pytestmark = pytest.mark.kernel


def test_dims_are_those_of_the_sweep_and_the_day_and_the_replicates(swept_result):
    dims = ("day", "backlash", "tuning", "n_volumes", "replicate")
    sizes = dict(zip(dims, (2, 3, 2, 2, 2), strict=True))
    assert dict(swept_result.sizes) == sizes | {"elapsed_time": 18, "volume": 8}
    assert all(swept_result[name].dims == dims for name in [*METRICS, "status"])
    assert swept_result.T_sup.dims == (*dims, "elapsed_time")
    assert swept_result.T_c.dims == (*dims, "volume", "elapsed_time")


def test_coordinates_are_labels_and_the_parameters_along_them(swept_result):
    assert swept_result.day.values.tolist() == [4, 1]
    assert swept_result.backlash.values.tolist() == [0.0, 0.07, 0.15]
    assert swept_result.kp.dims == swept_result.ti.dims == ("tuning",)
    assert swept_result.ti.values.tolist() == [20.0, 8.0]
    assert swept_result.replicate.values.tolist() == [0, 1]
    assert swept_result.volume.values.tolist() == list(range(1, 9))
    assert swept_result.elapsed_time.values.tolist() == list(range(0, 900, 50))
    assert swept_result.rmse.sel(backlash=0.07, day=1, n_volumes=8).sizes == {"tuning": 2, "replicate": 2}


def test_everything_has_a_unit_and_a_long_name(swept_result):
    for name, output in (METRICS | {n: TRACES[n] for n in ("T_sup", "mode", "T_c")}).items():
        attrs = swept_result[name].attrs
        assert (attrs["units"], attrs["long_name"]) == (output.unit, output.long_name)
        assert (attrs.get("units_metadata") == "temperature: difference") == output.difference
    assert (swept_result.status.dtype, np.all(swept_result.status == 0)) == (np.int8, True)
    assert swept_result.status.attrs["flag_values"].tolist() == list(range(5))
    assert swept_result.status.attrs["flag_meanings"].split() == list(STATUS_MEANINGS)
    for name in swept_result.coords:
        assert swept_result[name].attrs["long_name"]
    kp = PARAMETERS["kp"]
    assert swept_result.kp.attrs == {"long_name": kp.label, "units": "K-1", "comment": kp.text}
    assert swept_result.elapsed_time.attrs["units"] == "s"


def test_provenance_names_no_user_and_no_path(swept_result, sweep):
    attrs = swept_result.attrs
    assert json.loads(attrs["parameters"]) == fc.Loop(**sweep, noise_std=0.02, n_volumes=[4, 8]).constants
    assert (attrs["seed"], attrs["warm_up_s"], attrs["Conventions"]) == ("7", 100, "CF-1.11")
    assert len(attrs["content_sha256"]) == len(attrs["boundary_sha256"]) == 64
    text = " ".join(map(str, attrs.values()))
    assert str(Path.home()) not in text
    assert os.getcwd() not in text


def test_volumes_a_scenario_does_not_have_are_missing(swept_result):
    few, many = swept_result.T_c.sel(n_volumes=4), swept_result.T_c.sel(n_volumes=8)
    assert np.all(np.isnan(few.sel(volume=slice(5, None))))
    assert np.all(np.isfinite(few.sel(volume=slice(4))))
    assert np.all(np.isfinite(many))


@pytest.mark.parametrize("interval", [1, 7, 60, 900])
def test_trace_interval_takes_the_sample_at_that_second(days, interval):
    options = {"traces": ["T_sup", "wet_volumes", "T_w"], "warm_up": 100}
    every, some = (fc.simulate(fc.Loop(), days, **options, trace_interval=n) for n in (1, interval))
    assert some.sizes["elapsed_time"] == -(-900 // interval)
    xr.testing.assert_equal(some, every.isel(elapsed_time=slice(None, None, interval)))


def test_each_trace_alone_is_the_trace_among_others(days):
    together = fc.simulate(fc.Loop(), days, traces=list(TRACES), warm_up=100)
    backwards = fc.simulate(fc.Loop(), days, traces=list(TRACES)[::-1], warm_up=100)
    for name in TRACES:
        assert backwards[name].identical(together[name])
    for name in ("T_sup", "mode", "T_c"):
        alone = fc.simulate(fc.Loop(), days, traces=[name], warm_up=100)
        assert alone[name].identical(together[name])


def test_open_loop_has_no_controller(half_hour_day):
    command = np.linspace(0.0, 1.0, half_hour_day.n_steps)
    ds = fc.simulate(fc.Loop(backlash=[0.0, 0.1]), half_hour_day, command=command, traces=list(TRACES), warm_up=60)
    for name in ("u", "integral", "estimate", "switch_frequency", "estimate_final"):
        assert np.all(np.isnan(ds[name])), name
    assert ds["mode"].dtype == np.int8
    assert np.all(ds["mode"] == 0)
    np.testing.assert_array_equal(ds.command.values, np.broadcast_to(command, (2, half_hour_day.n_steps)))
    np.testing.assert_array_equal(ds.opening.sel(backlash=0.0).values, command)
    assert "command_sha256" in ds.attrs


def test_each_day_may_have_its_own_command(days):
    commands = np.array([[0.2] * 900, [0.6] * 900])
    ds = fc.simulate(fc.Loop(), days, command=commands, traces=["command"], warm_up=60)
    np.testing.assert_array_equal(ds.command.values, commands)
    same = fc.simulate(fc.Loop(), days, command=commands[0], traces=["command"], warm_up=60)
    np.testing.assert_array_equal(same.command.values, np.full((2, 900), 0.2))


@pytest.mark.parametrize("change", [{"seed": 8}, {"warm_up": 101}, {"trace_interval": 25}, {"traces": ["T_sup"]}])
def test_content_hash_depends_on_what_was_simulated(days, swept_result, sweep, change):
    options = {"traces": ["T_sup", "mode", "T_c"], "trace_interval": 50, "warm_up": 100, "replicates": 2, "seed": 7}
    changed = fc.simulate(fc.Loop(**sweep, noise_std=0.02, n_volumes=[4, 8]), days, **options | change)
    assert changed.content_sha256 != swept_result.content_sha256


@pytest.mark.filterwarnings("ignore:action")
def test_adding_sweep_values_changes_no_scenario(days):
    few = fc.simulate(fc.Loop(backlash=[0.02, 0.07], noise_std=0.05), days, traces=["T_sup"], warm_up=60)
    loop = fc.Loop(noise_std=[0.0, 0.05], backlash=[0.15, 0.07, 0.0, 0.02], action=["heating", "cooling"])
    three = fc.paper_day(hours=0.25, seed=[1, 9, 4])
    more = fc.simulate(loop, three, traces=["T_sup"], warm_up=60, replicates=3)
    more = more.sel(noise_std=0.05, backlash=[0.02, 0.07], action="cooling", day=[4, 1], replicate=0)
    for name in [*METRICS, "T_sup"]:
        np.testing.assert_array_equal(more[name].values, few[name].values, err_msg=name)


def test_a_controller_gone_nan_is_flagged(half_hour_day):
    ds = fc.simulate(fc.Loop(ti=1e-320, sensor_resolution=0.5), half_hour_day, traces=["u"], warm_up=60)
    assert int(ds.status) != 0


def test_how_many_parameters_exist_at_a_time_changes_nothing(days, monkeypatch):
    loop = fc.Loop(noise_std=0.02, backlash=np.linspace(0.0, 0.1, 35), learning_step=[0.0, 0.005])
    whole = fc.simulate(loop, days, warm_up=60, replicates=2, n_jobs=1)
    monkeypatch.setattr(simulate, "SCENARIOS_AT_ONCE", 64)
    assert fc.simulate(loop, days, warm_up=60, replicates=2, n_jobs=1).content_sha256 == whole.content_sha256
