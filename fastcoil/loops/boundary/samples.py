"""Labelled days of series with their clock, as everyone reads them: from memory, or made day by day."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import NDArray

from fastcoil.base.arguments import whole_of
from fastcoil.base.arrays import Array
from fastcoil.loops.boundary.clock import Clock, Times
from fastcoil.loops.boundary.in_words import extent, html_of, text_of
from fastcoil.loops.boundary.rearranged import Parts
from fastcoil.loops.boundary.series import BOUNDARY_SERIES
from fastcoil.loops.boundary.source import Source


class Samples:
    """The series, the labels and the clock of days; immutable."""

    _source: Source
    _clock: Clock
    _by_air: bool

    @classmethod
    def of(cls, source: Source, clock: Clock, by_air: bool = False) -> Self:
        """A boundary of checked samples; ``by_air``: whether the air flow alone decides on ``enabled``."""
        self = cls.__new__(cls)
        self._source, self._clock, self._by_air = source, clock, by_air
        return self

    @property
    def source(self) -> Source:
        """Where the samples come from."""
        return self._source

    @property
    def series(self) -> dict[str, Array]:
        """All series by name, each float64 (n_days, n_steps), read-only; all days of a stream are made for it."""
        return self._source.series

    def of_day(self, k: int) -> dict[str, Array]:
        """The series of one day by position, each float64 (n_steps,), read-only."""
        return self._source.of_day(whole_of("k", k, 0, self.n_days - 1))

    @property
    def extremes(self) -> dict[str, tuple[float, float]]:
        """Least and largest value of each series; a stream makes all its days for it, once."""
        return self._source.extremes

    @property
    def is_streamed(self) -> bool:
        """Whether days are made when they are needed, and not held in memory."""
        return self._source.is_streamed

    @property
    def day(self) -> NDArray[np.int64]:
        """Labels of the days, (n_days,), read-only."""
        return self._source.day

    @property
    def has_day_dim(self) -> bool:
        """Whether results have a dim ``day``."""
        return self._source.has_day_dim

    @property
    def start(self) -> Times | None:
        """Date and time of the first sample of each day, (n_days,) datetime64[s]; None if unknown."""
        return None if self._clock.start is None else self._clock.start.copy()

    @property
    def time_zone(self) -> str:
        """The time zone of ``start``; blank if unknown."""
        return self._clock.time_zone

    @property
    def clock(self) -> Clock:
        """``start`` and ``time_zone``."""
        return self._clock

    @property
    def n_days(self) -> int:
        return self.day.size

    @property
    def n_steps(self) -> int:
        """Number of 1-s steps."""
        return self._source.n_steps

    @property
    def hours(self) -> float:
        return self.n_steps / 3600

    @property
    def sha256(self) -> str:
        """Digest of the day labels and of every name and sample; the clock does not count."""
        return self._source.sha256

    @property
    def day_sha256(self) -> list[str]:
        """Digest of each day's label and samples."""
        return self._source.day_sha256

    def describe(self) -> str:
        """One line: the length, the days, and the range of every series that is not at its default."""
        found = []
        for name, (low, high) in self.extremes.items():
            unit = BOUNDARY_SERIES[name].unit
            if not low == high == BOUNDARY_SERIES[name].default:
                span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
                found.append(f"{name} {span}{'' if unit == '1' else ' ' + unit}")
        return f"{extent(self._source, self._clock)}: {', '.join(found)}"

    def __repr__(self) -> str:
        return text_of(self._source, self._clock)

    def _repr_html_(self) -> str:
        return html_of(self._source, self._clock)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Samples):
            return NotImplemented
        return self is other or (np.array_equal(self.day, other.day) and self.sha256 == other.sha256)

    def __hash__(self) -> int:
        return hash(self.sha256)

    @property
    def parts(self) -> Parts:
        """Samples, clock, and whether the air flow alone decides on ``enabled``."""
        return Parts(self._source, self._clock, self._by_air)
