"""Dead band, compensation and buffer from the noise: as in the reference, in any block, and in a replay to the bit."""

import numpy as np
import pytest
from helpers.twins import assert_equal_to_reference

import fastcoil as fc
from fastcoil.loops.scenarios import parameter_columns
from fastcoil.model.engine.controller import ControllerFeatures, control_stage
from fastcoil.model.engine.lanes import cut_into_blocks, parameter_matrix
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.numerics.stages import BUILT_IN

pytestmark = pytest.mark.kernel

SIGNALS = ["u", "integral", "command", "mode", "estimate"]
WIDE_BUFFER = {"buffer_swing": 10.0, "plant_gain": 20.0}
"""A limit of half the stroke, which no buffer of these loops reaches."""
MEASURED_BUFFER = {"buffer_ratio": 6.0, "buffer_noise": "measured", **WIDE_BUFFER}
PARTS = {
    "dead band": {"error_dead_band": 0.3},
    "additive": {"compensation": "additive"},
    "smooth": {"compensation": "smooth"},
    "buffer from the given noise": {"buffer_ratio": 5.0},
    "buffer at least so large": {"buffer_ratio": 5.0, "buffer": 0.006},
    "buffer up to a swing": {"buffer_ratio": 30.0, "buffer_swing": 0.1, "plant_gain": 25.0},
    "buffer from the measured noise": MEASURED_BUFFER,
    "all together": {
        **MEASURED_BUFFER, "buffer_swing": 0.15, "plant_gain": 20.0, "compensation": "additive", "error_dead_band": 0.1,
    },
    "smooth with a dead band": {"compensation": "smooth", "smooth_rate": 1e-3, "error_dead_band": 0.1},
}  # fmt: skip
LOOP = {"backlash_estimate": 0.06, "noise_std": 0.03, "sensor_resolution": 0.02}


PRESETS, NOISES, SAMPLE_TIMES = ("lbnl", "paper_like", "g36", "paper_like_fast"), (0.03, 0.1, 0.0), (None, 7.0, 1.0)
CLOSED_LOOP_CASES = [(part, PRESETS[k % 3], NOISES[k % 2], SAMPLE_TIMES[k % 3 - k % 2]) for k, part in enumerate(PARTS)]


def with_pause(boundary, start=1000, end=1600):
    """The day with a pause that begins and ends between samples."""
    enabled = np.ones(boundary.n_steps)
    enabled[start + 7 : end + 11] = 0.0
    series = {name: values[0] for name, values in boundary.series.items()}
    return fc.Boundary(**series | {"enabled": enabled}, day=7)


@pytest.mark.parametrize(("part", "preset", "noise_std", "sample_time"), CLOSED_LOOP_CASES)
def test_every_part_equals_the_reference(part, preset, noise_std, sample_time, one_hour_day, run_reference):
    times = {} if sample_time is None else {"sample_time": sample_time}
    loop = fc.Loop.preset(preset).assign(backlash_estimate=0.06, noise_std=noise_std, **PARTS[part], **times)
    day, options = with_pause(one_hour_day), {"warm_up": 600, "seed": 11}
    ds = fc.simulate(loop, day, traces=list(TRACES), **options)
    assert_equal_to_reference(ds, *run_reference(loop, day, **options))


@pytest.mark.parametrize("part", PARTS)
def test_every_part_changes_the_commands_and_is_replayed_to_the_bit(part, half_hour_day):
    loop, day = fc.Loop(**LOOP, **PARTS[part]), with_pause(half_hour_day, 600, 800)
    ds = fc.simulate(loop, day, traces=["T_measured", *SIGNALS], warm_up=0, seed=3)
    log = ds[["T_measured"]].rename(T_measured="T_sup")
    log["T_set"], log["enabled"] = day.to_dataset()["T_set"], day.to_dataset()["enabled"]
    replayed = fc.replay(loop, log)
    for name in SIGNALS:
        np.testing.assert_array_equal(replayed[name], ds[name], err_msg=name)
    plain = fc.replay(fc.Loop(**LOOP), log)
    assert not np.array_equal(plain["command"], replayed["command"])


def test_a_lane_has_the_same_bits_beside_lanes_with_other_parts(half_hour_day):
    """Every part, and none, in one block; each alone in a block with that part only."""
    rows = [{}, *PARTS.values(), {"sample_time": 7.0}, {"sample_time": 7.0, **PARTS["smooth with a dead band"]}]
    names = ("error_dead_band", "compensation", "buffer", "buffer_ratio", "buffer_noise", "buffer_swing")
    names += ("sample_time", "smooth_rate")
    common = LOOP | {"plant_gain": 20.0}
    zipped = {n: ("tuning", [row.get(n, fc.Loop()[n]) for row in rows]) for n in names}
    day, options = with_pause(half_hour_day, 600, 800), {"traces": ["T_sup", *SIGNALS], "warm_up": 100}
    together = fc.simulate(fc.Loop(**common, **zipped), day, **options)
    for k in range(len(rows)):
        alone = fc.simulate(fc.Loop(**common, **{n: values[k] for n, (_, values) in zipped.items()}), day, **options)
        for name in [*METRICS, "T_sup", *SIGNALS]:
            np.testing.assert_array_equal(together[name].isel(tuning=k), alone[name], err_msg=f"{rows[k]} {name}")


@pytest.mark.parametrize(
    ("parameters", "features"),
    [
        ({}, []),
        ({"buffer_ratio": 6.0, "noise_std": 0.1}, []),
        ({"sensor_resolution": 0.1}, ["has_resolution"]),
        (PARTS["smooth with a dead band"], ["has_dead_band", "is_smooth"]),
        ({**MEASURED_BUFFER, "compensation": "additive"}, ["is_additive", "measures_noise"]),
    ],
)
def test_a_block_has_compiled_what_its_lanes_need_and_no_more(parameters, features):
    loop = fc.Loop(**parameters)
    ((_, block),) = cut_into_blocks(parameter_matrix(parameter_columns(loop, loop.sizes, np.arange(1))))
    assert block.config.control == control_stage(ControllerFeatures(**dict.fromkeys(features, True)))
    assert (block.config.control == BUILT_IN) == (not features)


@pytest.mark.parametrize("compensation", ["additive", "smooth"])
def test_without_an_estimate_every_compensation_is_the_plain_pi(compensation, half_hour_day):
    loop = fc.Loop(buffer=0.0, noise_std=0.02)
    plain = fc.simulate(loop, half_hour_day, traces=["command"], warm_up=100)
    compensated = fc.simulate(loop.assign(compensation=compensation), half_hour_day, traces=["command"], warm_up=100)
    np.testing.assert_array_equal(compensated.command, plain.command)


@pytest.mark.parametrize("noise_std", [0.02, 0.1])
@pytest.mark.parametrize("preset", ["lbnl", "g36"])
def test_a_buffer_from_measured_noise_works_like_one_from_the_known_noise(preset, noise_std, working_day):
    """Set-point steps every half hour, which a mean of squares would take for noise, do not widen it much."""
    loop = fc.Loop.preset(preset).assign(backlash_estimate=0.065, noise_std=noise_std, buffer_ratio=6.0)
    ds = fc.simulate(loop.assign(buffer_noise=["given", "measured"], **WIDE_BUFFER), working_day)
    plain = fc.simulate(loop.assign(buffer_ratio=0.0), working_day)
    given, measured = ds.switch_frequency.values
    assert measured < 0.3 * float(plain.switch_frequency)
    assert measured == pytest.approx(given, rel=0.2, abs=0.3)
    assert ds.rmse[1] < 1.02 * ds.rmse[0]
