"""``sobol_indices``: which parameters drive the spread of a result over a population."""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base import arguments
from fastcoil.base.errors import InputError, Problem, short_repr
from fastcoil.loops.scenarios import check_counted_result
from fastcoil.model.metric_table import METRICS, STATUS_OK, metric_hint

INDICES = ("first_order", "total")
EDGES = ("value", "low", "high")
_N_RESAMPLES = 1000
_CHANCE_CORRELATION_STDS = 5.0  # of the rank correlation of independent numbers


def sobol_indices(
    ds: xr.Dataset, metrics: str | Sequence[str] | None = None, *, drop_failed: bool = False, level: float = 0.95
) -> xr.Dataset:
    """Estimate first-order and total Sobol' indices of the sampled parameters, with bootstrap intervals.

    Parameters
    ----------
    ds
        The result of a study with ``[sample] method = "saltelli"``, with dims ``sample`` and ``design``.  ``design``
        must have ``A``, ``B`` and the parameters whose indices you want, in any order.  Its labels ``A`` and ``B`` are
        two independent samples; label ``kp`` is ``A`` with the column of ``kp`` taken from ``B`` (A_B of Saltelli et
        al.), all other parameters as in ``A``.
    metrics
        Name or names of variables; ``rmse`` by default.
    drop_failed
        Leave out samples in which a scenario failed or has no such result; otherwise they are refused.
    level
        Level of the intervals.

    Returns
    -------
    xarray.Dataset
        Each metric over (other dims, ``parameter``, ``index``: first_order or total, ``edge``: value, low, high), and
        ``METRIC_n_samples``, the number of base samples used.  Estimators of Saltelli et al. (2010) and Jansen (1999),
        doi:10.1016/j.cpc.2009.09.018; NaN where the metric does not vary, or fewer than two samples are left.

    Raises
    ------
    InputError
        For a result of another design, correlated parameters, an unknown metric, or failed scenarios.

    Examples
    --------
    >>> import fastcoil as fc
    >>> shapes = {"kp": {"uniform": [0.01, 0.03]}, "backlash": {"uniform": [0.0, 0.1]}}
    >>> loop = fc.Loop().assign(**fc.sample(4, method="saltelli", **shapes))
    >>> ds = fc.simulate(loop, fc.paper_day(hours=0.6), warm_up=600, n_jobs=1)
    >>> fc.sobol_indices(ds).rmse.dims
    ('parameter', 'index', 'edge')
    """
    with arguments.argument_checks() as check:
        check(check_counted_result, ds)
        names = check(arguments.require_names, "metrics", "rmse" if metrics is None else metrics)
        drop_failed = check(arguments.require_flag, "drop_failed", drop_failed)
        level = check(arguments.require_confidence_level, level)
    if not {"sample", "design"} <= set(ds.dims):
        sentence = 'the result has no dims sample and design: run a study with [sample] method = "saltelli"'
        raise InputError(sentence, "ds", "shape")
    labels = [str(label) for label in ds["design"].values]
    parameters = [label for label in labels if label not in ("A", "B")]
    if not parameters or sorted(labels) != sorted({"A", "B", *parameters}):
        cure = "must have A, B and at least one parameter, each of them once"
        raise InputError(f"design = {', '.join(labels)}: {cure}", "design", "shape")
    problems: list[Problem] = []
    for name in names:
        if name not in ds.data_vars:
            sentence = f"metrics: {short_repr(name)} is not in the result{metric_hint(name)}"
            problems.append(Problem(sentence, "metrics", "name"))
        elif not _is_metric(ds[name]):
            sentence = f"metrics: {name!r} is not a quantity over sample and design: give a metric such as rmse"
            problems.append(Problem(sentence, "metrics", "unsupported"))
    arguments.raise_problems(problems)
    _require_independence(ds.sel(design="A"), parameters)
    variables = {}
    coords: dict[Any, Any] = {"parameter": parameters, "index": list(INDICES), "edge": list(EDGES)}
    for name in names:
        values = ds[name].where(ds["status"] == STATUS_OK).sel(design=["A", "B", *parameters])
        missing = values.isnull().any("design")
        if bool(missing.any()) and not drop_failed:
            sentence = f"{name} is missing in {int(missing.sum()):,} of {missing.size:,} samples, because a scenario "
            sentence += "failed or has no such result: give drop_failed=True to leave these samples out"
            raise InputError(sentence, "drop_failed", "data")
        others = [d for d in values.dims if d not in ("sample", "design")]
        shape = [values.sizes[d] for d in others]
        cells = values.transpose(*others, "sample", "design").values.reshape(-1, ds.sizes["sample"], len(labels))
        indices = np.stack([_estimate_indices(cell, level) for cell in cells]).reshape(*shape, len(parameters), 2, 3)
        variables[name] = ((*others, "parameter", "index", "edge"), indices)
        variables[f"{name}_n_samples"] = (tuple(others), np.isfinite(cells).all(axis=2).sum(axis=1).reshape(shape))
        coords |= {d: ds[d] for d in others}
    return xr.Dataset(variables, coords=coords)


def _require_independence(sample: xr.Dataset, parameters: Sequence[str]) -> None:
    """Refuse parameters of a sample whose ranks correlate by more than chance."""
    drawn = [n for n in parameters if n in sample.coords and sample[n].dims == ("sample",)]
    numbers = [n for n in drawn if sample[n].dtype.kind in "fiu"]
    for a, b in combinations(numbers, 2):
        ranks = [np.unique(sample[n].values, return_inverse=True)[1] for n in (a, b)]
        with np.errstate(invalid="ignore"):  # one that does not vary
            rho = float(np.asarray(np.corrcoef(ranks))[0, 1])
        if abs(rho) * np.sqrt(sample.sizes["sample"]) > _CHANCE_CORRELATION_STDS:
            sentence = f"{a} and {b} are correlated (rank correlation {rho:.2f}), and Sobol' indices share the spread"
            cure = "among independent parameters alone: draw them without correlation"
            raise InputError(f"{sentence} {cure}", a, "data")


def _is_metric(values: xr.DataArray) -> bool:
    """Whether these are numbers over the design, not flags."""
    flags = values.name == "status" or values.name in METRICS and METRICS[str(values.name)].flags
    return not flags and values.dtype.kind in "fiu" and {"sample", "design"} <= set(values.dims)


def _estimate_indices(values: np.ndarray, level: float) -> np.ndarray:
    """Estimate the indices of one cell, (parameters, 2, 3), from its values (samples, design)."""
    values = values[np.isfinite(values).all(axis=1)]
    n = values.shape[0]
    if n < 2:
        return np.full((values.shape[1] - 2, 2, 3), np.nan)
    # the mean does not change the estimators, but does change their scatter
    values = values - values[:, :2].mean()
    rng = np.random.default_rng(0)
    weights = np.concatenate([np.ones((1, n)), rng.multinomial(n, np.full(n, 1.0 / n), size=_N_RESAMPLES)]) / n
    f_A, f_B, f_AB = values[:, 0], values[:, 1], values[:, 2:]
    mean = weights @ (0.5 * (f_A + f_B))
    variance = weights @ (0.5 * (f_A**2 + f_B**2)) - mean**2
    first = weights @ (f_B[:, None] * (f_AB - f_A[:, None]))
    total = weights @ (0.5 * (f_A[:, None] - f_AB) ** 2)
    varies = variance[:, None] > 1e-24 * max(1.0, float(np.max(values**2)))
    shares = np.stack([first, total], axis=-1) / np.where(varies, variance[:, None], np.nan)[..., None]
    low, high = np.quantile(shares[1:], [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)
    return np.stack([shares[0], low, high], axis=-1)
