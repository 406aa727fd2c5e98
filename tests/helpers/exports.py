"""One trend log as the programs of buildings export it: times, numbers and tables in every writing."""

from datetime import datetime, timedelta

import numpy as np

from fastcoil.logs import ReadingOptions, read_checked_log
from fastcoil.logs.columns import ColumnSpec

START = datetime(2024, 7, 11, 23, 30)
ROWS, STEP = 60, 60
SECONDS = STEP * np.arange(ROWS)
COMMAND = np.round(50 + 30 * np.sin(SECONDS / 400), 1)
"""%, with one decimal; some are whole."""
T_SUP = np.round(14 + 2 * np.cos(SECONDS / 300), 2)
HEADER = ("timestamp", "command [%]", "T_sup [degC]")
WANTED = ColumnSpec(required=("command", "T_sup"), optional=("enabled",), measured=("T_sup",))


def format_times(form, start=START, step=STEP):
    """The times of the rows, written with a pattern of strftime."""
    return [(start + timedelta(seconds=step * k)).strftime(form) for k in range(ROWS)]


ISO = format_times("%Y-%m-%dT%H:%M:%S")


def cell_rows(stamps=ISO, command=COMMAND, T_sup=T_SUP, *more_columns):
    """Cells of the rows as text."""
    return [list(map(str, row)) for row in zip(stamps, command, T_sup, *more_columns, strict=True)]


def table_text(cells, header=HEADER, separator=",", before="", after=""):
    """A file: lines before the table, header, rows, lines after it."""
    return before + "\n".join(separator.join(row) for row in [header, *cells]) + "\n" + after


def save_text(tmp_path, text, encoding="utf-8", name="export.csv"):
    """Path of a new file with this text."""
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return path


def read_text_as_log(tmp_path, text, encoding="utf-8", **options):
    """The log in this text."""
    return read_checked_log(save_text(tmp_path, text, encoding), WANTED, ReadingOptions(reader="read_log", **options))


def assert_same_log(log, step=STEP):
    """Every row of the log is there, with its time and its values."""
    np.testing.assert_array_equal(log.time, step * np.arange(ROWS))
    np.testing.assert_allclose(log.values["command"], COMMAND / 100, rtol=1e-12)
    np.testing.assert_allclose(log.values["T_sup"], T_SUP, rtol=1e-12)
    assert log.n_batches == 1
