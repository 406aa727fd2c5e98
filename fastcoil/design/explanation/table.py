"""The cures as a table of plain text."""

from __future__ import annotations

import math

from fastcoil.design.explanation.answer import kelvin, number
from fastcoil.design.explanation.theory import Found

_HEAD = ("", "margin", "RMSE", "swing", "motor travel", "")


def table_of(found: Found) -> list[str]:
    """A heading and a row for each cure: what is now in numbers, the others relative to it."""
    ds = found.cures
    rows: list[tuple[str, ...]] = [_HEAD]
    for k in range(ds.sizes["cure"]):
        one, now = ds.isel(cure=k), ds.isel(cure=0)
        error, travel = float(one["rmse"]), float(one["motor_travel"])
        if k:
            error_word = f"{100 * (error / float(now['rmse']) - 1):+.0f} %"
            travel_word = f"× {number(travel / float(now['motor_travel']))}" if float(now["motor_travel"]) > 0 else "–"
            says = str(one["verdict"].item())
        else:
            error_word, travel_word = f"{error:.3g} K", f"{travel:.3g} strokes"
            says = "hunts" if found.hunts else "hunts in part" if found.needs_cure else "does not hunt"
        swing = float(one["hunting_swing"])
        cells = [f"{float(one['margin']):.2f}", error_word, kelvin(swing), travel_word]
        known = (float(one["margin"]), error, swing, travel)
        cells = [cell if math.isfinite(value) else "–" for cell, value in zip(cells, known, strict=True)]
        rows.append((str(one["words"].item()), *cells, says))
    widths = [max(len(row[c]) for row in rows) for c in range(len(_HEAD))]
    lines = []
    for row in rows:
        numbers = [cell.rjust(width) for cell, width in zip(row[1:-1], widths[1:-1], strict=True)]
        lines.append("  ".join([row[0].ljust(widths[0]), *numbers, row[-1]]).rstrip())
    title = (
        "What would cure it, and what that costs:"
        if found.needs_cure
        else "What else could be done, and what it costs:"
    )
    return [f"{title} the day simulated with each", *lines]
