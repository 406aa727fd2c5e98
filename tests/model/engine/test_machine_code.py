"""Machine code of the kernel: sections are vectorised, one signature serves all runs, no index is out of bounds."""

import os
import platform
import re
import subprocess
import sys

import numpy as np
import pytest
from helpers.full import full_except

import fastcoil as fc
from fastcoil.model.estimators.registry import ESTIMATORS
from fastcoil.model.numerics.jit import FLAGS

ARITHMETIC = r"\tv?(?:add|sub|mul|div|sqrt|min|max|fn?m(?:add|sub)\d+)"
# Most scalar operations for each packed one: none in a loop over lanes of one array; ln m_a, taken out of its
# loop; and, where two arrays might overlap, the whole loop once more, which never runs.
SCALAR_SHARE = {
    "control, all parts": 0,
    "actuate with zones and slips": 0,
    "actuate with wear": 0,
    "deliver": 0,
    "air_side": 0.3,
    "march_water": 1.1,
    "march_air": 1.1,
    "account_second": 1.1,
}


def section_assembly(name):
    """Assembly of one section, compiled alone with the flags of the kernel."""
    import numba
    from numba import types as T

    from fastcoil.model.engine import controller, metrics, plant

    f, i, b, A = T.float64, T.int64, T.boolean, T.Array(T.float64, 1, "C")
    section, signature = {
        "control, all parts": (
            controller.make_control(controller.ControllerFeatures(*(True for _ in controller.PLAIN_CONTROLLER))),
            (A, i, f, f, b, f),
        ),
        "actuate with zones and slips": (plant.make_actuate(plant.ActuatorFeatures(True, True, True, False)), (A, b)),
        "actuate with wear": (plant.make_actuate(plant.ActuatorFeatures(wears=True)), (A, b)),
        "deliver": (plant.update_water_flow, (A, b)),
        "air_side": (plant.update_air_effectiveness, (A, f)),
        "march_water": (plant.march_water, (A, A, i, b, T.Array(b, 1, "C"))),
        "march_air": (plant.march_air, (A, A, i, b, b, f, f, f, b, f, T.Array(b, 1, "C"))),
        "account_second": (metrics.accumulate_second, (A, A, i, i, f, f, f, i)),
    }[name]
    return next(iter(numba.njit(signature, **FLAGS)(getattr(section, "py_func", section)).inspect_asm().values()))


@pytest.mark.kernel
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads x86-64 assembly")
@pytest.mark.parametrize("name", full_except(SCALAR_SHARE, ["march_water"]))
def test_sections_are_vectorised(name):
    import llvmlite.binding

    assembly = section_assembly(name)
    packed = re.findall(ARITHMETIC + r"pd\t.*", assembly)
    scalar = re.findall(ARITHMETIC + r"sd\t.*", assembly)
    assert len(packed) > 15
    assert len(scalar) <= SCALAR_SHARE[name] * len(packed)
    if llvmlite.binding.get_host_cpu_features().get("avx2"):
        assert sum("%ymm" in line or "%zmm" in line for line in packed) > 0.9 * len(packed)
    assert not re.search(r"\$_?(exp|log|pow|sin|cos|floor|fmod)\b", assembly)


@pytest.mark.kernel
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads x86-64 assembly")
@pytest.mark.parametrize("name", full_except(["hagglund", "gradient"], ["gradient"]))
def test_stages_of_estimators_are_vectorised(name, monkeypatch):
    """Scalar is only the loop once more for rows that might overlap, which never do.  Vectors are as wide as can be."""
    import llvmlite.binding

    from fastcoil.model.engine.rules import estimator_stage
    from fastcoil.model.numerics import stages

    compiled = []
    monkeypatch.setattr(stages, "kernel_folder", lambda _: None)  # what comes from the cache has no assembly
    monkeypatch.setattr(stages, "_COMPILED_STAGES", compiled)
    (estimator,) = (e for e in ESTIMATORS if e is not None and e.name == name)
    estimator_stage.__wrapped__(estimator)
    assembly = compiled[0]._library.get_asm_str()
    packed = re.findall(ARITHMETIC + r"pd\t.*", assembly)
    assert len(packed) > 40
    if llvmlite.binding.get_host_cpu_features().get("avx512f"):
        assert sum("%zmm" in line for line in packed) > 0.9 * len(packed)
    assert len(re.findall(ARITHMETIC + r"sd\t.*", assembly)) <= 1.2 * len(packed)
    assert not re.search(r"\$_?(exp|log|pow|sin|cos|floor|fmod)\b", assembly)


@pytest.mark.kernel
def test_one_compiled_signature_serves_every_kind_of_run(half_hour_day):
    from fastcoil.model.engine.emulator import emulate
    from fastcoil.model.engine.lanes import compile_kernel

    days = fc.paper_day(hours=0.1, seed=[1, 2])
    compile_kernel()
    fc.simulate(fc.Loop(), half_hour_day, warm_up=60)
    fc.simulate(fc.Loop(), days, warm_up=60, command=np.full((2, 360), 0.3), traces=["T_c", "wet_volumes"])
    fc.simulate(fc.Loop(noise_std=[0.0, 0.1], n_volumes=4), days, warm_up=0, seed=2**63 + 1, replicates=2)
    assert len(emulate.signatures) == 1


# In the interpreter NumPy checks every index.  Small runs of all kernels, with everything switched on.
EVERY_KERNEL = """
import numpy as np
import fastcoil as fc
from fastcoil.model.engine.recorded import run_coil
from fastcoil.model.engine.lanes import compile_kernel
from fastcoil.model.engine.lanes import blocks, parameter_matrix, work_space
from fastcoil.model.engine.at_rest import linearise_step
from fastcoil.model.engine.recorded import run_replay
from fastcoil.model.engine.rows import LANES
from fastcoil.model.engine.at_rest import STEADY, find_rest, rest_curve
from fastcoil.model.engine.at_rest import FEW, respond
from fastcoil.model.engine.recorded import valve_flows
from fastcoil.model.metric_table import TRACES
from fastcoil.loops.scenarios import columns_of

np.seterr(all="ignore")
compile_kernel()
learner = {"learning_step": 0.01, "learning_early_trip": 1, "sample_time": 5}
remedies = {"error_dead_band": 0.1, "buffer_ratio": 6.0, "buffer_noise": "measured", "sample_time": 3}
remedies |= {"buffer_swing": 0.2, "plant_gain": 20.0}
for compensation in ("additive", "smooth"):
    loop = fc.Loop(**remedies, compensation=compensation, noise_std=0.1, n_volumes=1)
    ds = fc.simulate(loop, fc.paper_day(hours=10 / 3600, seed=1), warm_up=2, n_jobs=1)
    assert not ds.status.any()
test = fc.ValveTest(start=3, settle=0.0, minutes=0.1, excursion=50.0)
for compensation in ("inverse", "additive", "smooth"):
    loop = fc.Loop(compensation=compensation, backlash_estimate=0.05, sample_time=1, n_volumes=1)
    ds = fc.simulate(loop, fc.paper_day(hours=10 / 3600, seed=1), warm_up=2, test=test, traces=["test"], n_jobs=1)
    assert ds.test_aborted == 0 and ds.test.sum() == 6
valve = {"neutral_zone": 0.01, "slip_jump": 0.02, "leakage": 0.0}
loop = fc.Loop(**learner, **valve, noise_std=0.1, n_volumes=[1, 3], air_march=["lagged", "quasistatic"])
day = fc.paper_day(hours=12 / 3600, seed=1)
ds = fc.simulate(loop, day, warm_up=2, traces=list(TRACES), trace_interval=5, n_jobs=1)
assert ds.sizes["elapsed_time"] == 3 and not ds.status.any()
own = {"hagglund_least_half_periods": 5, "estimator": ["hagglund", "gradient"], "plant_gain": 25.0}
ds = fc.simulate(fc.Loop(**own, sample_time=1), day, warm_up=2, n_jobs=1)
assert not ds.status.any()
matrix = parameter_matrix(columns_of(loop, loop.sizes, np.arange(4)))
found = run_coil(matrix, np.tile([1.0, 25.0, 0.01, 7.0, 0.5], (4, 1)), np.array([0, 3]))
assert [part.shape for part in found] == [(2, 4)] * 3
assert run_replay(matrix, np.tile([15.0, 14.0, 1.0, 1.2], (7, 1)), 3)["u"].shape == (3, 4)
openings, flows = np.empty((3, 1)), np.empty((3, 1))
sets = np.array([[0.07], [2.0], [0.7], [9.0], [0.38]])
valve_flows(np.array([0.2, 0.2, 0.5]), np.array([0, 0, 1]), sets, np.zeros((2, 1)), openings, flows)
still = fc.Loop(n_volumes=1)
((_, block),) = blocks(parameter_matrix(columns_of(still, still.sizes, np.arange(1))))
S, V, *_ = work_space(block)
found, entering = np.empty((len(STEADY), LANES)), np.tile([[1.0], [25.0], [0.01], [7.0]], LANES)
find_rest(block.rows, block.common, entering, np.full(LANES, 50.0), S, V, found)
at_rest, curve = V.copy(), np.empty((1, LANES))
for n_steps in (2, FEW + 3):
    response, ends = np.empty((n_steps, LANES)), np.empty(LANES, np.int64)
    respond(block.rows, block.common, entering, found, at_rest, S, V, 1.0, response, ends)
    assert (ends == 2).all()
linearise_step(block.rows, block.common, entering, found, at_rest, S, V, np.empty((4, 4, LANES)), curve.repeat(4, 0))
rest_curve(block.rows, block.common, entering, np.array([0.5]), S, V, curve)
print("within bounds")
"""


def test_no_kernel_reads_out_of_bounds(tmp_path):
    env = os.environ | {"NUMBA_DISABLE_JIT": "1", "XDG_CACHE_HOME": str(tmp_path)}
    process = subprocess.run([sys.executable, "-c", EVERY_KERNEL], env=env, capture_output=True, text=True, check=False)
    assert process.stdout == "within bounds\n", process.stderr
