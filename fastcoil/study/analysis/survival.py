"""Quantiles of times that some runs did not reach: Kaplan and Meier's estimator."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base import arguments
from fastcoil.base.errors import InputError, short_repr


def time_quantiles(
    times: Any, q: float | Sequence[float] = 0.5, *, over: str | Sequence[str] = "day", until: Any = None
) -> xr.DataArray:
    """Estimate quantiles of times, some of which were not reached within the run.

    The time in which half of the loops have found their gap is known although some never do: these count as later than
    all others, where ``ds.learn_time_reached.median("day")`` would leave them out.

    Parameters
    ----------
    times
        DataArray of times, such as ``ds.time_identified``; NaN where the time was not reached.
    q
        Quantile or quantiles, shares of the runs.
    over
        Dim or dims of the runs.
    until
        How long each run was watched, in the unit of the times: a number, or a DataArray over dims of ``times``.
        Without it, all runs are equally long.

    Returns
    -------
    xarray.DataArray
        The quantiles over the other dims, and ``quantile`` for several; ``inf`` where they lie beyond what was watched.

    Raises
    ------
    InputError
        For a dim that ``times`` does not have, a quantile outside 0 to 1, or a time beyond ``until``.

    Notes
    -----
    Kaplan and Meier (1958), doi:10.1080/01621459.1958.10501452.  Scenarios that failed have NaN too: select those of
    status 0 first.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> hours = xr.DataArray([2.0, 4.5, np.nan, 3.0], dims="day")
    >>> fc.time_quantiles(hours, [0.5, 0.75, 0.9]).values
    array([3. , 4.5, inf])
    """
    with arguments.argument_checks() as check:
        times = check(arguments.require_instance, "times", times, xr.DataArray, "give a DataArray of times")
        dims = check(arguments.require_names, "over", over)
    if times.dtype.kind not in "iuf":
        raise InputError(f"times is of type {times.dtype}: give seconds or hours as numbers", "times", "type")
    arguments.require_no_unit("q", q, "give shares")
    shares = np.asarray(q)
    if shares.dtype.kind != "f" or shares.size == 0 or not ((shares > 0.0) & (shares < 1.0)).all():
        raise InputError(f"q = {short_repr(q)}: give shares between 0 and 1, such as 0.5", "q", "value")
    if until is not None and not isinstance(until, xr.DataArray):
        until = arguments.require_number("until", until, "give a number, or a DataArray over dims of times", least=0.0)
    elif (unit := arguments.carried_unit("until", until)) not in (None, arguments.carried_unit("times", times)):
        raise InputError(f"until is in {unit}: give it in the unit of times", "until", "unit")
    for dim in dims:
        arguments.require_choice("over", dim, [str(d) for d in times.dims])
    ends = xr.DataArray(np.inf if until is None else until).broadcast_like(times)
    if bool((times > ends).any()):
        raise InputError(
            "until lies before a time that was reached: give how long each run was watched", "until", "value"
        )
    others = [d for d in times.dims if d not in dims]
    n_runs = int(np.prod([times.sizes[d] for d in dims]))
    stacked = [values.transpose(*others, *dims).values.reshape(-1, n_runs) for values in (times, ends)]
    quantiles = np.array([_kaplan_meier(t, end, np.atleast_1d(shares)) for t, end in zip(*stacked, strict=True)])
    shape = [times.sizes[d] for d in others]
    coords = {n: c for n, c in times.coords.items() if {*c.dims} <= {*others}} | {"quantile": np.atleast_1d(shares)}
    result = xr.DataArray(quantiles.reshape(*shape, -1), coords, [*others, "quantile"], times.name, times.attrs)
    return result if shares.ndim else result.isel(quantile=0)


def _kaplan_meier(times: np.ndarray, ends: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return quantiles of the times of one population; NaN is a time beyond its end."""
    is_reached = ~np.isnan(times)
    last = np.where(is_reached, times, ends)
    order = np.lexsort((~is_reached, last))  # a time that is reached when another run ends comes first
    is_reached, last = is_reached[order], last[order]
    at_risk = last.size - np.arange(last.size)
    reached_share = 1.0 - np.cumprod(np.where(is_reached, 1.0 - 1.0 / at_risk, 1.0))
    reached = reached_share[is_reached]
    places = np.searchsorted(reached, q - 1e-9)
    quantiles: np.ndarray = np.append(last[is_reached], np.inf)[np.minimum(places, reached.size)]
    return quantiles
