"""Comparison with ``reference``, the model in plain Python."""

import numpy as np

from fastcoil.model.metric_table import METRICS, TRACES


def assert_traces_equal(ds, traces, tolerance=1e-9):
    """Assert that all traces are those of the reference, to a tolerance in their unit; modes exactly."""
    for name in TRACES:
        atol = 0.0 if name == "mode" else tolerance
        np.testing.assert_allclose(ds[name].values, traces[name], rtol=0.0, atol=atol, err_msg=name)


def assert_equal_to_reference(ds, traces, metrics):
    """Assert that all traces and metrics are those of the reference, to 1e-9 in their unit."""
    assert_traces_equal(ds, traces)
    assert int(ds.status) == metrics["status"] == 0
    for name in METRICS:
        np.testing.assert_allclose(ds[name].values, metrics[name], rtol=0.0, atol=1e-9, err_msg=name)
