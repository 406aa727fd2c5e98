"""Weather years made up by a formula, as CSV files."""

from helpers.log_files import write_csv

HEADER = ["hour_of_year", "T_drybulb_C", "T_dewpoint_C"]


def write_weather(folder, T_out, T_dew=5.0, days=7, first_day=1):
    """Write a file of whole days; ``T_out``: a number, or a function of the hour of the year; return its path."""
    hours = range(24 * (first_day - 1) + 1, 24 * (first_day - 1 + days) + 1)
    T = [T_out(h) if callable(T_out) else T_out for h in hours]
    rows = [[h, T_hour, min(T_dew, T_hour)] for h, T_hour in zip(hours, T, strict=True)]
    return write_csv(folder / "made.csv", HEADER, rows)
