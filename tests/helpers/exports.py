"""One trend log in the formats of building automation: times, numbers and tables in every notation."""

from datetime import datetime, timedelta

import numpy as np

from fastcoil.logs.columns import ColumnSpec

START = datetime(2024, 7, 11, 23, 30)
ROWS = 60
STEP = 60  # s
SECONDS = STEP * np.arange(ROWS)
COMMAND = np.round(50 + 30 * np.sin(SECONDS / 400), 1)  # %, one decimal; some are whole
T_SUP = np.round(14 + 2 * np.cos(SECONDS / 300), 2)
HEADER = ("timestamp", "command [%]", "T_sup [degC]")
WANTED = ColumnSpec(required=("command", "T_sup"), optional=("enabled",), measured=("T_sup",))


def format_times(form, start=START, step=STEP):
    """Format the times of the rows with a pattern of strftime."""
    return [(start + timedelta(seconds=step * k)).strftime(form) for k in range(ROWS)]


ISO = format_times("%Y-%m-%dT%H:%M:%S")


def cell_rows(stamps=ISO, command=COMMAND, T_sup=T_SUP, *more_columns):
    """Return the cells of the rows as text."""
    return [list(map(str, row)) for row in zip(stamps, command, T_sup, *more_columns, strict=True)]


def table_text(cells, header=HEADER, separator=",", before="", after=""):
    """Join a file: lines before the table, header, rows, lines after it."""
    return before + "\n".join(separator.join(row) for row in [header, *cells]) + "\n" + after


def save_text(tmp_path, text, encoding="utf-8", name="export.csv"):
    """Write a new file with this text; return its path."""
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return path


def assert_same_log(log, step=STEP):
    """Assert that every row of the log is there, with its time and its values."""
    np.testing.assert_array_equal(log.time, step * np.arange(ROWS))
    np.testing.assert_allclose(log.values["command"], COMMAND / 100, rtol=1e-12)
    np.testing.assert_allclose(log.values["T_sup"], T_SUP, rtol=1e-12)
    assert log.n_batches == 1
