"""How precisely a study knows the mean of a metric, and whether it has drawn enough samples.

Points of a Sobol' design are not independent: their scatter does not give the error of their mean.  A study with
``[run] precision`` draws independent designs instead, batches of ``size`` samples each, and the scatter of their means
gives Student's interval.  Means of small batches are skewed where a metric jumps, and a scatter that is small by chance
ends a study too early.  So there are 32 batches at least, the interval takes the largest scatter that agrees with the
one seen (95 % bound), and it is judged only when there are half as many batches again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.model.metric_table import METRICS, STATUS_NOT_RUN
from fastcoil.model.parameter_table import CHANCE_DIMS

MIN_BATCHES = 32  # always drawn
DEFAULT_MAX_BATCHES = 128  # where ``most`` is not given


@dataclass(frozen=True)
class Precision:
    """The required half-width of the 95 % interval of a metric's mean, in each case: over all dims but those of chance.

    half_width: in the unit of the metric, or a share of the mean if ``relative``.  baseline: dim and label with which
    the other cases are compared; the interval is then that of the difference, or of the relative change.  size: samples
    of a batch.  most: samples at which the study ends, however wide the interval is.
    """

    metric: str
    half_width: float
    relative: bool
    baseline: Mapping[str, Any]
    size: int
    most: int

    @property
    def batch_counts(self) -> list[int]:
        """Numbers of batches after which the interval is judged."""
        counts, last = [MIN_BATCHES], self.most // self.size
        while counts[-1] < last:
            counts.append(min(counts[-1] * 3 // 2, last))
        return counts

    def half_widths(self, ds: xr.Dataset) -> tuple[xr.DataArray, int]:
        """Return the half-width of each case, from the leading batches that are complete, and their number.

        Failed scenarios are left out; NaN where a batch has no value, or with fewer than two batches.
        """
        values = xr.DataArray(ds[self.metric].variable)
        is_complete = (ds["status"] != STATUS_NOT_RUN).all([d for d in values.dims if d != "sample"]).values
        n = int(is_complete.size if is_complete.all() else is_complete.argmin()) // self.size
        if n < 2:
            return xr.DataArray(np.nan), n
        chance = [d for d in values.dims if d in CHANCE_DIMS and d != "sample"]
        values = values.isel(sample=slice(n * self.size))
        means = (values.mean(chance) if chance else values).coarsen(sample=self.size).mean()
        reference, ratio = means, xr.DataArray(0.0)
        if self.baseline:
            reference = means.isel({d: int(np.argmax(ds[d].values == label)) for d, label in self.baseline.items()})
            ratio = xr.DataArray(1.0)
        scale = abs(reference.mean("sample", skipna=False)) if self.relative else xr.DataArray(1.0)
        with np.errstate(all="ignore"):  # infinite values, a mean of 0
            if self.baseline and self.relative:
                ratio = (means.mean("sample") / reference.mean("sample")).where(scale > 0.0, 0.0)
            scatter = (means - ratio * reference).std("sample", ddof=1, skipna=False)
            halves = _half_width_per_std(n) * scatter / scale
        return halves.where(scatter != 0.0, 0.0), n

    def reached_half_width(self, ds: xr.Dataset) -> float:
        """The half-width of the least certain case."""
        return float(self.half_widths(ds)[0].max(skipna=False))

    def is_enough(self, ds: xr.Dataset) -> bool:
        """Whether a result is as precise as asked, or has the most samples."""
        halves, n = self.half_widths(ds)
        return n == self.batch_counts[-1] or n in self.batch_counts and self.reached_half_width(ds) <= self.half_width

    def result_attributes(self, ds: xr.Dataset) -> dict[str, str]:
        """What was reached, for the attributes of a result."""
        half_width = self.reached_half_width(ds)
        reached = {"half_width": half_width, "samples": ds.sizes["sample"], "reached": half_width <= self.half_width}
        return {"precision_reached": json.dumps(reached)}

    def describe_plan(self, scenarios_per_batch: int) -> str:
        """Describe how many samples a study draws."""
        counts = MIN_BATCHES, self.batch_counts[-1]
        first, last = (f"{n * self.size:,} samples ({n * scenarios_per_batch:,} scenarios)" for n in counts)
        return f"{self._goal_text}: {first} first, half as many again until it is reached, {last} at most"

    def describe_progress(self, ds: xr.Dataset) -> str:
        """State the half-width that was reached and the required one, in short."""
        return f"± {self._format(self.reached_half_width(ds))} (± {self._format(self.half_width)} asked)"

    def describe_result(self, ds: xr.Dataset) -> str:
        """State the half-width that was reached and the required one in a sentence."""
        halves, n = self.half_widths(ds)
        if n < 2:
            return f"Precision: {self._goal_text}; its first batches are not complete."
        least = f" in the least certain of {halves.size} cases" if halves.size > 1 else ""
        reached = self.reached_half_width(ds)
        text = f"Precision: {self._goal_text}; ± {self._format(reached)}{least} from {n * self.size:,} samples"
        if reached <= self.half_width:
            return f"{text}."
        return f"{text}, the most allowed: raise most, or half_width." if self.is_enough(ds) else f"{text}: draw more."

    @property
    def _goal_text(self) -> str:
        against = "".join(f" against {dim} = {label}" for dim, label in self.baseline.items())
        return f"mean of {self.metric}{against} to ± {self._format(self.half_width)} (95 %)"

    def _format(self, half_width: float) -> str:
        unit = "" if METRICS[self.metric].unit == "1" else f" {METRICS[self.metric].unit}"
        return f"{100.0 * half_width:.3g} %" if self.relative else f"{half_width:.3g}{unit}"

    @property
    def text(self) -> str:
        """JSON for the attributes of a result."""
        return json.dumps(asdict(self))


def read_precision(ds: xr.Dataset) -> Precision | None:
    """Return the precision that the study of a result required; None if it required none."""
    return Precision(**json.loads(ds.attrs["precision"])) if "precision" in ds.attrs else None


def _half_width_per_std(n: int) -> float:
    """Half-width of the interval of a mean of ``n`` values by their standard deviation."""
    from scipy.special import chdtri, stdtrit

    largest = np.sqrt((n - 1) / chdtri(n - 1, 0.95))
    return float(stdtrit(n - 1, 0.975) * largest / np.sqrt(n))
