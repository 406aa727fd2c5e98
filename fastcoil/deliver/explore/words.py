"""What is seen beyond the explanation, in sentences for a lecture hall."""

import math

from fastcoil.deliver.explore.loop import Run
from fastcoil.design.advice import per_cent


def compared(run: Run) -> str:
    """What the same day shows without the gap, and without the inverse."""
    others = [f"Without {what}: {shown}." for what, shown in run.without.items()]
    return "  ".join(others if run.parameter("backlash") else ["The valve has no gap.", *others])


def learning(run: Run) -> str:
    """What an estimator has found; empty without one."""
    found, gap = run.value("estimate_final"), run.value("backlash_final")
    if not run.learns or not math.isfinite(found):
        return ""
    hours = run.value("time_identified") / 3600.0
    since = f", right since hour {hours:.1f}" if math.isfinite(hours) else ", which is not right yet"
    return f"The estimate ends at {per_cent(round(found, 3))} for a gap of {per_cent(gap)}{since}."
