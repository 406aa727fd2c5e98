"""Small logs of a valve and of a coil as CSV files: headers, rows, and rows with other values."""

import csv

import numpy as np

from helpers.simulated_logs import random_walk, valve_flows


def write_csv(path, header, rows):
    """Write rows below a header; returns the path."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *rows])
    return path


def change_cell(rows, row, column, value):
    """Change one cell of the rows."""
    rows = [list(r) for r in rows]
    rows[row][column] = value
    return rows


VALVE_HEADER = ["elapsed_time [s]", "command [1]", "m_w [kg/s]"]
COIL_HEADER = [
    "elapsed_time [s]", "m_w [kg/s]", "m_a [kg/s]", "T_w_in [degC]", "T_a_in [degC]", "RH_a_in [%]", "T_sup [degC]",
]  # fmt: skip


def valve_rows(n=60):
    """Return the cells of a valve's log without noise, a sample a minute."""
    command = random_walk(np.random.default_rng(17), n=n)
    rows = zip(command, valve_flows(command), strict=True)
    return [[60 * i, f"{c:.4f}", f"{m:.4f}"] for i, (c, m) in enumerate(rows)]


def coil_rows(n=80):
    """Return the cells of a coil's log, a sample a minute; good numbers, but of no coil."""
    return [[60 * i, 1.0 + 0.5 * (i // 5 % 2), 1.2, 7.0, 26.0, 50.0, 15.0 + i % 3] for i in range(n)]
