"""Logs in disorder: what shows in them is no fault of a unit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from studies.air_handler.truth import SIDES
from studies.air_handler.units import Unit


def shift_commands(hours: float) -> Callable[[Unit], pd.DataFrame]:
    """Return a function that logs the commands of a unit so many hours late."""

    def shift(unit: Unit) -> pd.DataFrame:
        headers = [unit.columns[f"{side}_command"] for side in SIDES.values()]
        return unit.log.assign(**{name: np.roll(unit.log[name], int(60 * hours)) for name in headers})

    return shift


def reverse_log(unit: Unit) -> pd.DataFrame:
    """Let the values of a log run backwards."""
    return pd.concat([unit.log.iloc[:, :1], unit.log.iloc[::-1, 1:].reset_index(drop=True)], axis=1)


def swap_headers(unit: Unit) -> pd.DataFrame:
    """Swap the headers of cooling and heating commands."""
    cooling, heating = unit.columns["cooling_command"], unit.columns["heating_command"]
    return unit.log.rename(columns={cooling: heating, heating: cooling})


PLACEBOS: dict[str, Callable[[Unit], pd.DataFrame]] = {
    "in order": lambda unit: unit.log,
    **{f"commands {hours} h late": shift_commands(hours) for hours in (2, 6, 12)},
    "commands of the next day": shift_commands(24),
    "backwards": reverse_log,
    "headers of cooling and heating swapped": swap_headers,
}
