"""The series that act on the loop from outside, second by second: entering air and water, set-point, noise."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastcoil.arguments import instance_of
from fastcoil.arrays import Array
from fastcoil.boundary.series import (
    BOUNDARY_SERIES,
    Given,
    Values,
    carried_labels,
    common_size,
    label_array,
    read,
    value_problems,
)
from fastcoil.errors import InputError, collecting
from fastcoil.logs.series import Series
from fastcoil.logs.units import DIFFERENCE

if TYPE_CHECKING:
    import xarray as xr


class Boundary:
    """The series that act on the loop, in 1-s samples, on one day or several; immutable.

    Parameters
    ----------
    m_a, T_a_in, W_a_in, T_w_in, T_set
        Air flow [kg/s], temperature [degC] and humidity ratio [kg/kg dry air] of the entering air,
        temperature of the entering water [degC], set-point [degC].  ``W_a_in`` above saturation at ``T_a_in``
        is legal (mist): sensors report it, and the coil model takes any humidity ratio.
    noise
        Recorded noise, added to the measured temperature every second [K]; none if left out.
    enabled
        1 where the loop is in operation, 0 where not; 1 throughout if left out.
    backlash_scale
        What the backlash of every loop is multiplied by, such as 2 from the second at which a linkage comes loose; 1
        throughout if left out.
    day
        Labels of the days: distinct whole numbers from 0 to 2**32 - 1; 0, 1, 2, ... if left out.  They, not
        the order, seed the noise of a day.  One number labels a boundary without a dim ``day``.

    Each series is a number, a 1-D array of 1-s samples, a 2-D array (day, second) or a DataArray with dims
    ``elapsed_time`` and/or ``day``; at least one must have samples, and all the same number.  A
    DataArray that declares ``units`` is converted from them.  All mistakes are raised together, in one
    `InputError`.
    """

    def __init__(
        self,
        *,
        m_a: Values,
        T_a_in: Values,
        W_a_in: Values,
        T_w_in: Values,
        T_set: Values,
        noise: Values = None,
        enabled: Values = None,
        backlash_scale: Values = None,
        day: Values = None,
    ) -> None:
        arguments = {
            "m_a": m_a,
            "T_a_in": T_a_in,
            "W_a_in": W_a_in,
            "T_w_in": T_w_in,
            "T_set": T_set,
            "noise": noise,
            "enabled": enabled,
            "backlash_scale": backlash_scale,
        }
        problems: list[str] = []
        given: dict[str, Given] = {}
        for name, series in BOUNDARY_SERIES.items():
            with collecting(problems):
                given[name] = read(series, arguments[name])
        n_steps = common_size("elapsed_time", "samples", given, problems)
        n_days = common_size("day", "days", given, problems)
        if n_steps is None and not problems:
            problems.append("every series is a number: give at least one as 1-s samples, or use constant_day")
        labels = carried_labels(given, problems) if day is None else label_array(day, problems)
        if labels is None:
            labels = np.arange(n_days) if n_days else np.asarray(0)
        elif n_days is not None and labels.size != n_days:
            problems.append(f"day has {labels.size} labels for {n_days} days: give one label for each day")
        for name, one in given.items():
            problems += value_problems(BOUNDARY_SERIES[name], one, labels)
        if problems:
            # Series that share a coordinate share its mistakes.
            raise InputError(list(dict.fromkeys(problems)))
        self._has_day_dim = bool(n_days or labels.ndim)
        self._day = _frozen(np.atleast_1d(labels).astype(np.int64))
        shape = self._day.size, n_steps or 0
        self._series = {name: _frozen(one.spread(*shape)) for name, one in given.items()}

    @property
    def series(self) -> dict[str, Array]:
        """All eight series by name, each float64 (n_days, n_steps), read-only."""
        return dict(self._series)

    @property
    def day(self) -> NDArray[np.int64]:
        """Labels of the days, (n_days,), read-only."""
        return self._day

    @property
    def has_day_dim(self) -> bool:
        """Whether results have a dim ``day``."""
        return self._has_day_dim

    @property
    def n_days(self) -> int:
        return self._day.size

    @property
    def n_steps(self) -> int:
        """Number of 1-s steps."""
        return int(self._series["m_a"].shape[1])

    @property
    def hours(self) -> float:
        return self.n_steps / 3600

    @functools.cached_property
    def sha256(self) -> str:
        """Digest of the day labels and of every name and sample."""
        digest = hashlib.sha256(f"boundary 1 {self._has_day_dim} {self.n_days} {self.n_steps}".encode())
        digest.update(self._day.astype("<i8").tobytes())
        for name, values in self._series.items():
            if name == "backlash_scale" and (values == 1.0).all():
                continue  # as before there was this series
            digest.update(name.encode())
            digest.update(values.astype("<f8", copy=False).tobytes())
        return digest.hexdigest()

    def describe(self) -> str:
        """One line: the length, the days, and the range of every series that is not at its default."""
        ranges = []
        for name, values in self._series.items():
            low, high, unit = values.min(), values.max(), BOUNDARY_SERIES[name].unit
            if not low == high == BOUNDARY_SERIES[name].default:
                span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
                ranges.append(f"{name} {span}{'' if unit == '1' else ' ' + unit}")
        return f"{self._extent}: {', '.join(ranges)}"

    @property
    def _extent(self) -> str:
        return f"{self.hours:g} h" + (f" x {self.n_days} days" if self._has_day_dim else "")

    def __repr__(self) -> str:
        return f"<fastcoil.Boundary {self._extent}, sha256 {self.sha256[:8]}>"

    def __eq__(self, other: object) -> bool:
        return self.sha256 == other.sha256 if isinstance(other, Boundary) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.sha256)

    def __reduce__(self) -> tuple[Callable[[], Boundary], tuple[()]]:
        # Through the constructor, because a pickled array comes back writeable.
        return functools.partial(Boundary, **self._rows(), day=self._rows_of(self._day)), ()

    def _rows_of(self, values: NDArray[Any]) -> NDArray[Any]:
        return values if self._has_day_dim else values[0]

    def _rows(self) -> dict[str, Array]:
        return {name: self._rows_of(values) for name, values in self._series.items()}

    def to_dataset(self) -> xr.Dataset:
        """The series as a Dataset with dims (``day``,) ``elapsed_time``, units and long names."""
        import xarray as xr

        dims = ("day", "elapsed_time") if self._has_day_dim else ("elapsed_time",)
        rows = self._rows().items()
        variables = {name: (dims, values.copy(), _attributes(BOUNDARY_SERIES[name])) for name, values in rows}
        seconds = np.arange(self.n_steps, dtype=np.float64)
        return xr.Dataset(
            variables,
            {
                "elapsed_time": ("elapsed_time", seconds, {"units": "s", "long_name": "time since the start"}),
                "day": (dims[:-1], self._rows_of(self._day), {"long_name": "label of the day"}),
            },
        )

    @classmethod
    def from_dataset(cls, ds: xr.Dataset) -> Boundary:
        """Inverse of `to_dataset`; ignores variables of other names.

        Strict: ``elapsed_time`` in steps of 1 s (from any start), and a ``units`` attribute on every series.
        """
        import xarray as xr

        instance_of("ds", ds, xr.Dataset, "give a Dataset, as of to_dataset")
        problems = [
            f"{name} has no units attribute: set ds[{name!r}].attrs['units'] ({series.known_units})"
            for name, series in BOUNDARY_SERIES.items()
            if name in ds and "units" not in ds[name].attrs
        ]
        if "elapsed_time" in ds.dims and "elapsed_time" not in ds.coords:
            problems.append("elapsed_time has no coordinate: give ds['elapsed_time'] the seconds 0, 1, ...")
        with collecting(problems):
            boundary = cls(**{name: ds.get(name) for name in BOUNDARY_SERIES})
        if problems:
            raise InputError(problems)
        return boundary

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        *,
        units: Mapping[str, str] | None = None,
        columns: Mapping[str, str] | None = None,
        constants: Mapping[str, float] | None = None,
        pressure: float = 101325.0,
        start: float = 0.0,
        hours: float | None = None,
        max_gap: float | None = None,
        time_format: str | None = None,
    ) -> Boundary:
        """Read the trend log of a building into 1-s samples.

        The header names each column and its unit: ``m_a [kg/s]``, ``T_a_in [degF]``; a volume flow of air is taken at
        1.2 kg/m3.  Time is ``elapsed_time [s]`` (min, h) or ``timestamp``; humidity is ``W_a_in``, ``RH_a_in`` or
        ``T_dp_in``.  Samples are 1 s apart or more; between them ``T_set`` and ``enabled``
        hold, the others run straight.

        Parameters
        ----------
        path
            A CSV file.  What is not self-evident about how it was read, such as the order of day and month, is said in
            a warning.
        units
            Units by series, for headers without one: ``{"T_a_in": "degF"}``.
        columns
            Headers by series, where they differ: ``{"T_a_in": "AHU1 MAT [degF]"}``.  Columns of other names are then
            ignored.
        constants
            Numbers for series that the log lacks, in the units of `Boundary`; relative humidity as a fraction, dew
            point in degC.
        pressure
            Barometric pressure, for relative humidity and dew point [Pa].
        start, hours
            Hours from the first row to the first sample; how many hours to take, up to the last row if left out.
        max_gap
            Longest step to be bridged [s]; three times the median step if left out, and more in a log whose rows were
            written when a value changed; all its values hold until the next.
        time_format
            How ``timestamp`` is written: a pattern such as ``"%d/%m/%Y %H:%M"``, ``"excel"`` for serial days,
            ``"epoch"`` for seconds or milliseconds since 1970.  If left out it is recognised, or refused where two
            readings fit.

        Raises
        ------
        InputError
            With one sentence for each mistake in the file or the arguments: column, row, cure.
        """
        from fastcoil.boundary.trend_log import trend_log_series

        return cls(
            **trend_log_series(
                path,
                units=units,
                columns=columns,
                constants=constants,
                pressure=pressure,
                start=start,
                hours=hours,
                max_gap=max_gap,
                time_format=time_format,
            )
        )


def _attributes(series: Series) -> dict[str, str]:
    attrs = {"units": series.unit, "long_name": series.long_name}
    # CF-1.11: a difference in K is not a temperature in K.
    return attrs | {"units_metadata": "temperature: difference"} if series.units is DIFFERENCE else attrs


def _frozen(values: NDArray[Any]) -> NDArray[Any]:
    values.flags.writeable = False
    return values
