"""Machine code of the kernel: sections are vectorised, one signature serves all runs, no index is out of bounds."""

import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.full import full_except
from helpers.rules import first_order

import fastcoil as fc
from fastcoil.model.estimators.registry import ESTIMATORS
from fastcoil.model.numerics.jit import FLAGS

ARITHMETIC = r"\tv?(?:add|sub|mul|div|sqrt|min|max|fn?m(?:add|sub)\d+)"
# Most scalar operations for each packed one: none in a loop over lanes of one array; ln m_a, taken out of its
# loop; and, where two arrays might overlap, the whole loop once more, which never runs.
SCALAR_SHARE = {
    "control, all parts": 0,
    "actuate without wear": 0,
    "actuate with wear": 0,
    "update_water_flow": 0,
    "update_air_effectiveness": 0.3,
    "march_lagged_water": 1.1,
    "march_lagged_air": 1.1,
    "pass_air": 1.1,
    "exchange_heat": 1.1,
    "accumulate_second": 1.1,
    "watch_swing": 1.1,
}


def section_assembly(name):
    """Assembly of one section, compiled alone with the flags of the kernel."""
    import numba
    from numba import types as T

    from fastcoil.model.engine import coil, controller, metrics, valve

    all_features = controller.ControllerFeatures(**dict.fromkeys(controller.ControllerFeatures.__annotations__, True))
    without_wear = valve.ActuatorFeatures(
        has_resolution=True, has_neutral_zone=True, has_positioner=True, has_stick_slip=True
    )
    f, i, b, A = T.float64, T.int64, T.boolean, T.Array(T.float64, 1, "C")
    section, signature = {
        "control, all parts": (controller.make_control(all_features), (A, i, f, f, b, f)),
        "actuate without wear": (valve.make_actuate(without_wear), (A, b)),
        "actuate with wear": (valve.make_actuate(valve.ActuatorFeatures(has_wear=True)), (A, b)),
        "update_water_flow": (valve.update_water_flow, (A, b, b)),
        "update_air_effectiveness": (coil.update_air_effectiveness, (A, f)),
        "march_lagged_water": (coil.march_lagged_water, (A, A, i, b, T.Array(b, 1, "C"))),
        "march_lagged_air": (coil.march_lagged_air, (A, A, i, b, f, f, f, f, f, T.Array(b, 1, "C"))),
        "pass_air": (coil.pass_air, (A, A, i, f, f, b, T.Array(b, 1, "C"))),
        "exchange_heat": (coil.exchange_heat, (A, A, i, f, T.Array(b, 1, "C"))),
        "accumulate_second": (metrics.accumulate_second, (A, A, A, i, f, f, f, i)),
        "watch_swing": (metrics.watch_swing, (A, A, i, i, T.UniTuple(f, 5), T.UniTuple(f, 5), T.Array(f, 2, "C"))),
    }[name]
    return next(iter(numba.njit(signature, **FLAGS)(getattr(section, "py_func", section)).inspect_asm().values()))


def assert_vectorised(assembly, least, scalar_share, feature, registers):
    """Require so many packed operations, few scalar ones, wide registers where the processor has the feature."""
    import llvmlite.binding

    packed = re.findall(ARITHMETIC + r"pd\t.*", assembly)
    assert len(packed) > least
    assert len(re.findall(ARITHMETIC + r"sd\t.*", assembly)) <= scalar_share * len(packed)
    if llvmlite.binding.get_host_cpu_features().get(feature):
        assert sum(any(each in line for each in registers) for line in packed) > 0.9 * len(packed)
    assert not re.search(r"\$_?(exp|log|pow|sin|cos|floor|fmod)\b", assembly)


needs_x86 = pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads x86-64 assembly")


@pytest.mark.kernel
@needs_x86
@pytest.mark.parametrize("name", full_except(SCALAR_SHARE, ["pass_air"]))
def test_sections_are_vectorised(name):
    assert_vectorised(section_assembly(name), 15, SCALAR_SHARE[name], "avx2", ("%ymm", "%zmm"))


@pytest.mark.kernel
@needs_x86
@pytest.mark.parametrize("name", full_except(["hagglund", "gradient"], ["gradient"]))
def test_stages_of_estimators_are_vectorised(name, monkeypatch):
    """Scalar is only the loop once more for rows that might overlap, which never do.  Vectors are as wide as can be."""
    from fastcoil.model.engine.rules import estimator_stage
    from fastcoil.model.numerics import stages

    compiled = []
    monkeypatch.setattr(stages, "kernel_folder", lambda _: None)  # what comes from the cache has no assembly
    monkeypatch.setattr(stages, "_COMPILED_STAGES", compiled)
    (estimator,) = (e for e in ESTIMATORS if e is not None and e.name == name)
    estimator_stage.__wrapped__(estimator)
    assert_vectorised(compiled[0]._library.get_asm_str(), 40, 1.2, "avx512f", ("%zmm",))


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


def run_every_kernel():
    """Small runs of all kernels with every feature."""
    from fastcoil.loops.scenarios import parameter_columns
    from fastcoil.model.engine import at_rest
    from fastcoil.model.engine.lanes import compile_kernel, default_block, parameter_matrix, work_space
    from fastcoil.model.engine.recorded import run_coil, run_replay, valve_flows
    from fastcoil.model.engine.rows import LANES
    from fastcoil.model.metric_table import TRACES

    def run(seconds=10, **options):
        loop, options = fc.Loop(**options.pop("loop")), {"warm_up": 2, "n_jobs": 1} | options
        ds = fc.simulate(loop, fc.paper_day(hours=seconds / 3600, seed=1), **options)
        assert not ds.status.any()
        return ds, loop

    np.seterr(all="ignore")
    compile_kernel()
    remedies = {"error_dead_band": 0.1, "buffer_ratio": 6.0, "buffer_noise": "measured", "sample_time": 3}
    remedies |= {"buffer_swing": 0.2, "plant_gain": 20.0, "noise_std": 0.1, "n_volumes": 1}
    test = fc.ValveTest(start=3, settle=0.0, minutes=0.1, excursion=50.0)
    for compensation in ("inverse", "additive", "smooth"):
        run(loop={**remedies, "compensation": compensation})
        loop = {"compensation": compensation, "backlash_estimate": 0.05, "sample_time": 1, "n_volumes": 1}
        ds, _ = run(loop=loop, test=test, traces=["test"])
        assert ds.test_aborted == 0
        assert ds.test.sum() == 6
    learner = {"learning_step": 0.01, "learning_early_trip": 1, "sample_time": 5, "noise_std": 0.1}
    valve = {"neutral_zone": 0.01, "slip_jump": 0.02, "leakage": 0.0}
    coils = {"n_volumes": [1, 3], "air_march": ["lagged", "quasistatic"]}
    ds, loop = run(12, loop=learner | valve | coils, traces=list(TRACES), trace_interval=5)
    assert ds.sizes["elapsed_time"] == 3
    estimators = {"hagglund_least_half_periods": 5, "estimator": ["hagglund", "gradient"], "plant_gain": 25.0}
    run(12, loop=estimators | {"sample_time": 1})
    room = {"controlled": ["T_sup", "T_room"], "room_capacity": 400.0, "curve": ["richards", "linear"]}
    run(loop=room | {"positioner_band": 0.01, "stroke_time": 60.0})
    run(loop={"plant": first_order, "dead_time": [0, 3]}, traces=["T_sup", "T_w"])

    matrix = parameter_matrix(parameter_columns(loop, loop.sizes, np.arange(4)))
    results = run_coil(matrix, np.tile([1.0, 25.0, 0.01, 7.0, 0.5], (4, 1)), np.array([0, 3]))
    assert [part.shape for part in results] == [(2, 4)] * 3
    assert run_replay(matrix, np.tile([15.0, 14.0, 1.0, 1.2], (7, 1)), 3)["u"].shape == (3, 4)
    sets = np.array([[0.07], [2.0], [0.7], [9.0], [0.38]])
    start, flows = np.zeros((2, 1)), np.empty((3, 1))
    valve_flows(np.array([0.2, 0.2, 0.5]), np.array([0, 0, 1]), sets, start, np.empty((3, 1)), flows)

    block = default_block()
    entering = np.tile([[1.0], [25.0], [0.01], [7.0], [0.8]], LANES)
    S, V, *_ = work_space(block)
    steady, plant = np.empty((len(at_rest.STEADY_ROWS), LANES)), (block.rows, block.config, entering)
    at_rest.find_rest(*plant, np.full(LANES, 50.0), S, V, steady)
    V_at_rest = V.copy()
    for n_steps in (2, at_rest.TAIL_STEPS + 3):
        response, ends = np.empty((n_steps, LANES)), np.empty(LANES, np.int64)
        at_rest.simulate_step_response(*plant, steady, V_at_rest, S, V, 1.0, response, ends)
        assert (ends == 2).all()
    at_rest.rest_curve(*plant, np.array([0.5]), S, V, np.empty((1, LANES)))


def test_no_kernel_reads_out_of_bounds(tmp_path):
    """In the interpreter NumPy checks every index."""
    folders = [Path(__file__).parent, Path(__file__).parents[2], *filter(None, [os.environ.get("PYTHONPATH")])]
    env = {"NUMBA_DISABLE_JIT": "1", "XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": os.pathsep.join(map(str, folders))}
    code = "import test_machine_code; test_machine_code.run_every_kernel()"
    subprocess.run([sys.executable, "-c", code], env=os.environ | env, check=True)
