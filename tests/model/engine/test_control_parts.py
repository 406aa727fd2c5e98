"""Dead band, compensation and buffer from the noise: equal to their twins, alike in any block, replayed to the bit."""

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.loops.scenarios import columns_of
from fastcoil.model.engine.controller import PLAIN, Control, control_stage
from fastcoil.model.engine.lanes import blocks, parameter_matrix
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.numerics.stages import BUILT_IN

pytestmark = pytest.mark.kernel

SIGNALS = ["u", "integral", "command", "mode", "estimate"]
WIDE = {"buffer_swing": 10.0, "plant_gain": 20.0}
"""Up to half the stroke: no buffer of these loops gets there."""
MEASURED = {"buffer_ratio": 6.0, "buffer_noise": "measured", **WIDE}
PARTS = {
    "dead band": {"error_dead_band": 0.3},
    "additive": {"compensation": "additive"},
    "smooth": {"compensation": "smooth"},
    "buffer from the given noise": {"buffer_ratio": 5.0},
    "buffer at least so large": {"buffer_ratio": 5.0, "buffer": 0.006},
    "buffer up to a swing": {"buffer_ratio": 30.0, "buffer_swing": 0.1, "plant_gain": 25.0},
    "buffer from the measured noise": MEASURED,
    "all at once": {
        **MEASURED, "buffer_swing": 0.15, "plant_gain": 20.0, "compensation": "additive", "error_dead_band": 0.1,
    },
    "smooth with a dead band": {"compensation": "smooth", "smooth_rate": 1e-3, "error_dead_band": 0.1},
}  # fmt: skip
LOOP = {"backlash_estimate": 0.06, "noise_std": 0.03, "sensor_resolution": 0.02}


PRESETS, NOISES, TIMES = ("lbnl", "paper_like", "g36", "paper_like_fast"), (0.03, 0.1, 0.0), (None, 7.0, 1.0)
CLOSED = [(part, PRESETS[k % 3], NOISES[k % 2], TIMES[k % 3 - k % 2]) for k, part in enumerate(PARTS)]


def off_and_on(boundary, first=1000, last=1600):
    """The day with a time without operation, which ends and begins between samples."""
    enabled = np.ones(boundary.n_steps)
    enabled[first + 7 : last + 11] = 0.0
    series = {name: values[0] for name, values in boundary.series.items()}
    return fc.Boundary(**series | {"enabled": enabled}, day=7)


@pytest.mark.parametrize(("part", "preset", "noise_std", "sample_time"), CLOSED)
def test_every_part_equals_its_twin_in_the_closed_loop(part, preset, noise_std, sample_time, hour, run_reference):
    times = {} if sample_time is None else {"sample_time": sample_time}
    loop = fc.Loop.preset(preset).assign(backlash_estimate=0.06, noise_std=noise_std, **PARTS[part], **times)
    day, options = off_and_on(hour), {"warm_up": 600, "seed": 11}
    ds = fc.simulate(loop, day, traces=list(TRACES), **options)
    traces, metrics = run_reference(loop, day, **options)
    for name in TRACES:
        atol = 0.0 if name == "mode" else 1e-9
        np.testing.assert_allclose(ds[name].values, traces[name], rtol=0.0, atol=atol, err_msg=name)
    for name in METRICS:
        np.testing.assert_allclose(ds[name].values, metrics[name], rtol=0.0, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("part", PARTS)
def test_every_part_changes_the_commands_and_is_replayed_to_the_bit(part, short):
    """As the inverse is: the same control at the same seconds."""
    loop, day = fc.Loop(**LOOP, **PARTS[part]), off_and_on(short, 600, 800)
    ds = fc.simulate(loop, day, traces=["T_measured", *SIGNALS], warm_up=0, seed=3)
    log = ds[["T_measured"]].rename(T_measured="T_sup")
    log["T_set"], log["enabled"] = day.to_dataset()["T_set"], day.to_dataset()["enabled"]
    found = fc.replay(loop, log)
    for name in SIGNALS:
        np.testing.assert_array_equal(found[name], ds[name], err_msg=name)
    plain = fc.replay(fc.Loop(**LOOP), log)
    assert not np.array_equal(plain["command"], found["command"])


def test_a_lane_has_the_same_bits_beside_lanes_with_other_parts(short):
    """Every part, and none, in one block; each alone in a block that has compiled no more than it needs."""
    rows = [{}, *PARTS.values(), {"sample_time": 7.0}, {"sample_time": 7.0, **PARTS["smooth with a dead band"]}]
    names = ("error_dead_band", "compensation", "buffer", "buffer_ratio", "buffer_noise", "buffer_swing")
    names += ("sample_time", "smooth_rate")
    common = LOOP | {"plant_gain": 20.0}
    zipped = {n: ("tuning", [row.get(n, fc.Loop()[n]) for row in rows]) for n in names}
    day, options = off_and_on(short, 600, 800), {"traces": ["T_sup", *SIGNALS], "warm_up": 100}
    together = fc.simulate(fc.Loop(**common, **zipped), day, **options)
    for k in range(len(rows)):
        alone = fc.simulate(fc.Loop(**common, **{n: values[k] for n, (_, values) in zipped.items()}), day, **options)
        for name in [*METRICS, "T_sup", *SIGNALS]:
            np.testing.assert_array_equal(together[name].isel(tuning=k), alone[name], err_msg=f"{rows[k]} {name}")


def control_of(**parameters):
    """The stage that a block with these parameters calls."""
    loop = fc.Loop(**parameters)
    ((_, block),) = blocks(parameter_matrix(columns_of(loop, loop.sizes, np.arange(1))))
    return block.common.control


def test_a_block_has_compiled_what_its_lanes_need_and_no_more():
    assert control_of() == control_of(buffer_ratio=6.0, noise_std=0.1) == control_stage(PLAIN) == BUILT_IN
    assert control_of(**PARTS["smooth with a dead band"]) == control_stage(Control(has_dead_band=True, is_smooth=True))
    assert control_of(sensor_resolution=0.1) == control_stage(Control(has_resolution=True))
    assert control_of(**MEASURED, compensation="additive") == control_stage(
        Control(is_additive=True, measures_noise=True)
    )


@pytest.mark.parametrize("compensation", ["additive", "smooth"])
def test_without_an_estimate_every_compensation_is_the_plain_pi(compensation, short):
    loop = fc.Loop(buffer=0.0, noise_std=0.02)
    plain = fc.simulate(loop, short, traces=["command"], warm_up=100)
    other = fc.simulate(loop.assign(compensation=compensation), short, traces=["command"], warm_up=100)
    np.testing.assert_array_equal(other.command, plain.command)


@pytest.mark.parametrize("noise_std", [0.02, 0.1])
@pytest.mark.parametrize("preset", ["lbnl", "g36"])
def test_a_buffer_from_measured_noise_works_like_one_from_the_known_noise(preset, noise_std, working_day):
    """Set-point steps every half hour, which a mean of squares would take for noise, do not widen it much."""
    loop = fc.Loop.preset(preset).assign(backlash_estimate=0.065, noise_std=noise_std, buffer_ratio=6.0)
    ds = fc.simulate(loop.assign(buffer_noise=["given", "measured"], **WIDE), working_day)
    plain = fc.simulate(loop.assign(buffer_ratio=0.0), working_day)
    given, measured = ds.switch_frequency.values
    assert measured < 0.3 * float(plain.switch_frequency)
    assert measured == pytest.approx(given, rel=0.2, abs=0.3)
    assert ds.rmse[1] < 1.02 * ds.rmse[0]
