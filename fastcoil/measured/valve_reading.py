"""The result of reading a valve test: backlash, plant, cause; its words, its TOML and its page."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fastcoil.base.figures import BLUE, FAINT, GREY, RED, YELLOW, apply_style, wrapped
from fastcoil.base.results import Result, toml_table
from fastcoil.measured.diagnosis import ABOVE, draw_profile, gap_as_toml, gap_in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NEGLIGIBLE = 1e-6  # probability of a size


@dataclass(frozen=True, repr=False)
class ValveReading(Result):
    """What a valve test shows of its valve and loop.

    Attributes
    ----------
    source
        Name of the log.
    backlash, interval
        Most probable backlash and its 95 % interval, fractions of stroke.
    identified, reason
        Whether the backlash is right, to 20 % of itself or 1 % of the stroke, with 95 % probability; why not, and what
        to do, else empty.
    gain, lag, dead_time
        Change of the temperature per stroke of the stem where the test was made, K, sum of the lags and dead time, s,
        of the most probable model.
    held_swing, held_for
        Highest less lowest temperature in the second half of the hold at the start of the test, K; that half, s.
    cause, because
        Why the loop hunted before the test, as in a ``Diagnosis``, and a sentence; ``unknown`` where less than an hour
        before the test is logged.
    explained
        Share of the variance of the temperature that the command explains.
    minutes
        How long the test took.
    profile
        Dataset over ``backlash``: the ``probability`` of each size.
    signals
        Dataset over ``elapsed_time``, from ten minutes before the test to ten after it: ``T_sup``, ``command``,
        ``stem`` (its place behind the most probable gap), ``model`` (temperature without drift) and ``test``.
    notes
        How the log was read, and what was assumed.
    """

    source: str
    backlash: float
    interval: tuple[float, float]
    identified: bool
    reason: str
    gain: float
    lag: float
    dead_time: float
    held_swing: float
    held_for: float
    cause: str
    because: str
    explained: float
    minutes: float
    profile: xr.Dataset
    signals: xr.Dataset
    notes: list[str]

    def summary(self) -> list[str]:
        """The reading in words, line by line."""
        return [
            f"{self.source}: a valve test of {self.minutes:.0f} min",
            gap_in_words(self),
            f"Plant: {self.gain:.3g} K per stroke, lags of {self.lag:.0f} s, dead time {self.dead_time:.0f} s; "
            f"the temperature moved by {self.held_swing:.2g} K while the command was held",
            f"Cause of the swing before the test: {self.cause}: {self.because}",
            *(f"Note: {note}" for note in self.notes),
        ]

    @apply_style()
    def plot(self) -> "Figure":
        """The reading on one page, as a matplotlib ``Figure``."""
        from matplotlib.figure import Figure

        ds, width = self.signals, 7.5
        fig = Figure(figsize=(width, 6.4), layout="constrained")
        above, middle, below = fig.subplots(3, 1, height_ratios=(1.2, 1.0, 1.0))
        minutes = (ds["elapsed_time"] - ds["elapsed_time"].values[ds["test"].values > 0][0]) / 60.0
        above.plot(minutes, ds["T_sup"], color=BLUE, lw=1.0, label="supply air")
        above.plot(minutes, ds["model"], color=YELLOW, lw=1.0, label="model, without drift")
        middle.plot(minutes, 100 * ds["command"], color=RED, lw=1.0, label="command")
        middle.plot(minutes, 100 * ds["stem"], color=GREY, lw=1.0, label="stem behind the gap")
        for axes in (above, middle):
            axes.axvspan(0.0, self.minutes, color=FAINT, lw=0)
            axes.legend(ncols=2, **ABOVE)
            axes.margins(x=0.01)
        above.set(ylabel="temperature [°C]")
        above.tick_params(labelbottom=False)
        middle.set(xlabel="minutes from the start of the test", ylabel="of the stroke [%]")
        draw_profile(below, self)
        lines = [wrapped(line, width, 9) for line in self.summary() if not line.startswith("Note: ")]
        fig.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=9)
        return fig

    def to_toml(self, path: str | Path | None = None) -> str:
        """The backlash as TOML, written to ``path`` if one is given; for ``include`` in the ``[loop]`` of a study file.

        ``[loop]`` has the backlash if it is identified, and nothing else; ``[fit]`` is for readers, its posterior
        also for ``fit`` in the ``[sample]`` of a study file.
        """
        numbers = {
            name: getattr(self, name) for name in ("gain", "lag", "dead_time", "held_swing", "held_for", "minutes")
        }
        more: list[str] = []
        if self.identified:
            at = np.flatnonzero(self.profile["probability"].values > _NEGLIGIBLE)
            seen = self.profile.isel(backlash=slice(at[0], at[-1] + 1))
            more = toml_table("fit.posterior", {n: seen[n].values.tolist() for n in ("backlash", "probability")})
        return gap_as_toml(self, "valve-test", "valve test", numbers, more, path)
