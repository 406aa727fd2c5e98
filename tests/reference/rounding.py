"""Numbers that are limited and rounded."""

import math


def clip(value, low, high):
    """Value limited to low..high; a NaN stays NaN."""
    if value < low:
        return low
    if value > high:
        return high
    return value


def round_half_up(value, resolution):
    """Value rounded to a multiple of resolution, halves upwards; what is not finite stays as it is."""
    if not math.isfinite(value):
        return value
    return resolution * math.floor(value / resolution + 0.5)
