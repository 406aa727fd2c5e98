"""A small trend log: its header, its rows, and rows with other values."""

HEADER = ["elapsed_time [s]", "m_a [kg/s]", "T_a_in [degC]", "W_a_in [1]", "T_w_in [degC]", "T_set [degC]"]


def row(time, m_a=1.0, T_a_in=25.0, W_a_in=0.01, T_w_in=7.0, T_set=14.0):
    return [time, m_a, T_a_in, W_a_in, T_w_in, T_set]


ROWS = [row(0), row(60, m_a=1.6, T_set=15.0), row(120, T_a_in=27.0)]


def replace_column(column, values, rows=ROWS):
    """Replace the values of one column, by its index."""
    return [[*r[:column], value, *r[column + 1 :]] for r, value in zip(rows, values, strict=True)]
