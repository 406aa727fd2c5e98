"""A first-order low-pass filter.  SciPy's ``lfilter`` gives the same bits, but importing it delays every start."""

from __future__ import annotations

from fastcoil.model.numerics.jit import kernel


@kernel
def low_pass(x, decay, y):
    """Filter x, (n,), into y, (n,): y[t] = decay y[t - 1] + (1 - decay) x[t], with y = 0 before the first sample.

    decay = e^(-dt/τ); x and y may be the same array.
    """
    gain = 1.0 - decay
    remembered = 0.0
    for t in range(x.size):
        y[t] = gain * x[t] + remembered
        remembered = decay * y[t]
