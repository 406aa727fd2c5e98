"""``sobol_indices``: which parameter of a population the spread of a result comes from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from fastcoil.errors import InputError, nearest
from fastcoil.outputs import METRICS, STATUS_OK

INDICES = ("first_order", "total")
EDGES = ("value", "low", "high")
_RESAMPLES = 1000


def sobol_indices(
    ds: xr.Dataset, metrics: Sequence[str] | None = None, *, drop_failed: bool = False, level: float = 0.95
) -> xr.Dataset:
    """First-order and total Sobol' indices of the sampled parameters, with bootstrap intervals.

    Parameters
    ----------
    ds
        The result of a study with ``[sample] method = "saltelli"``: dims ``sample`` and ``design``, and others.
    metrics
        Names of variables; ``rmse`` by default.
    drop_failed
        Whether samples in which a scenario failed, or has no such result, are left out; else they are refused.
    level
        Of the interval.

    Returns
    -------
    xarray.Dataset
        Each metric over (other dims, ``parameter``, ``index``: first_order or total, ``edge``: value, low, high), and
        ``n_samples``, how many base samples were used.  Estimators of Saltelli et al. (2010) and Jansen (1999),
        doi:10.1016/j.cpc.2009.09.018; NaN where the metric does not vary.

    Raises
    ------
    InputError
        For a result of another design, an unknown metric, or failed scenarios.
    """
    names = ["rmse"] if metrics is None else list(metrics)
    if not {"sample", "design"} <= set(ds.dims):
        raise InputError('the result has no dims sample and design: run a study with [sample] method = "saltelli"')
    unknown = [n for n in names if n not in ds.data_vars]
    if unknown:
        raise InputError([f"metrics: {n!r} is not in the result{nearest(str(n), METRICS)}" for n in unknown])
    if not 0.0 < level < 1.0:
        raise InputError(f"level = {level}: must lie between 0 and 1")
    parameters = [str(label) for label in ds["design"].values[2:]]
    ok = ds["status"] == STATUS_OK
    found = {}
    for name in names:
        values = ds[name].where(ok)
        missing = int(values.isnull().any("design").sum())
        if missing and not drop_failed:
            raise InputError(
                f"{name} is missing in {missing:,} of {values.isnull().any('design').size:,} samples, since a scenario "
                "failed or has no such result: give drop_failed=True to leave these samples out"
            )
        others = [d for d in values.dims if d not in ("sample", "design")]
        cells = values.transpose(*others, "sample", "design").values.reshape(-1, ds.sizes["sample"], ds.sizes["design"])
        shape = tuple(values.sizes[d] for d in others)
        indices = np.stack([_indices(cell, level) for cell in cells]).reshape(*shape, len(parameters), 2, 3)
        found[name] = ((*others, "parameter", "index", "edge"), indices)
        found[f"{name}_n_samples"] = (tuple(others), np.isfinite(cells).all(axis=2).sum(axis=1).reshape(shape))
    labels = {d: ds[d] for d in ds[names[0]].dims if d not in ("sample", "design")}
    return xr.Dataset(found, coords={**labels, "parameter": parameters, "index": list(INDICES), "edge": list(EDGES)})


def _indices(values: np.ndarray, level: float) -> np.ndarray:
    """(parameters, 2, 3) from one cell's values (samples, design)."""
    values = values[np.isfinite(values).all(axis=1)]
    n = values.shape[0]
    if n < 2:
        return np.full((values.shape[1] - 2, 2, 3), np.nan)
    # the estimators do not depend on the mean, but their scatter does
    values = values - values[:, :2].mean()
    rng = np.random.default_rng(0)
    weights = np.concatenate([np.ones((1, n)), rng.multinomial(n, np.full(n, 1.0 / n), size=_RESAMPLES)]) / n
    f_A, f_B, f_AB = values[:, 0], values[:, 1], values[:, 2:]
    mean = weights @ (0.5 * (f_A + f_B))
    variance = weights @ (0.5 * (f_A**2 + f_B**2)) - mean**2
    first = weights @ (f_B[:, None] * (f_AB - f_A[:, None]))
    total = weights @ (0.5 * (f_A[:, None] - f_AB) ** 2)
    varies = variance[:, None] > 1e-24 * max(1.0, float(np.max(values**2)))
    shares = np.stack([first, total], axis=-1) / np.where(varies, variance[:, None], np.nan)[..., None]
    low, high = np.quantile(shares[1:], [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)
    return np.stack([shares[0], low, high], axis=-1)
