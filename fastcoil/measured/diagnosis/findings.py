"""What a diagnosis found, without what can be made of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import xarray as xr


@dataclass(frozen=True)
class Findings:
    """The attributes of a ``Diagnosis``, explained there."""

    source: str
    backlash: float
    interval: tuple[float, float]
    identified: bool
    reason: str
    cause: str
    because: str
    hunts: bool
    profile: xr.Dataset
    indices: xr.Dataset
    predictions: xr.Dataset | None
    signals: xr.Dataset = field(repr=False)
    notes: list[str] = field(default_factory=list)
