"""What several test files share: ready-made days, one way to run the reference, and what the interpreter skips."""

import numpy as np
import pytest
import reference
from hypothesis import settings

# compiling a formula inside an example takes longer than hypothesis' deadline
settings.register_profile("fastcoil", deadline=None, derandomize=True, database=None)
settings.load_profile("fastcoil")


def pytest_configure(config):
    config.addinivalue_line("markers", "kernel: runs the lane kernel, which only the compiler makes fast enough")


def pytest_collection_modifyitems(items):
    from fastcoil.numerics.jit import JIT_ENABLED

    if not JIT_ENABLED:
        skip = pytest.mark.skip(reason="the lane kernel is too slow without the compiler (NUMBA_DISABLE_JIT=1)")
        for item in items:
            if item.get_closest_marker("kernel"):
                item.add_marker(skip)


@pytest.fixture(scope="session")
def hour():
    """One hour of the paper's kind of day: one set-point change, coil partly wet."""
    import fastcoil as fc

    return fc.paper_day(hours=1, seed=1)


@pytest.fixture(scope="session")
def working_day():
    """Eight hours of the paper's kind of day."""
    import fastcoil as fc

    return fc.paper_day(hours=8, seed=1)


@pytest.fixture(scope="session")
def short():
    """Half an hour of the paper's kind of day."""
    import fastcoil as fc

    return fc.paper_day(hours=0.5, seed=1)


@pytest.fixture(scope="session")
def run_reference():
    """Return a function that runs one loop through ``reference.py``: (traces as arrays like the package's, metrics).

    ``exact`` takes reference.py's own Hyland-Wexler saturation instead of the package's.
    """
    from fastcoil.physics.psychrometrics import saturation_humidity_ratio

    def run(loop, boundary, *, exact=False, **options):
        given = dict(loop.constants)
        if "rangeability" in given:
            curve = reference.valve_from_authority(*(given[n] for n in ("rangeability", "authority", "m_full")))
            given |= zip(("m_max", "valve_a", "valve_b", "valve_c"), curve, strict=True)
        if "estimate_ratio" in given:
            given["backlash_estimate"] = given["estimate_ratio"] * given["backlash"]
        parameters = {name: given[name] for name in reference.PAPER_LIKE}
        series = {name: values[0].tolist() for name, values in boundary.series.items()}
        saturation = None if exact else saturation_humidity_ratio
        traces, metrics = reference.simulate(
            parameters, series, day=int(boundary.day[0]), saturation=saturation, **options
        )
        return {name: np.array(values, dtype=float).T for name, values in traces.items()}, metrics

    return run
