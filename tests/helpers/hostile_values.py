"""Wrong values that users pass by mistake: of another type, size, unit or shape."""

from __future__ import annotations

import datetime
import decimal
import math
from pathlib import Path

import numpy as np
import xarray as xr


def dataset():
    """A Dataset that is not a result."""
    return xr.Dataset({"x": ("t", [1.0, 2.0])}, attrs={"parameters": "{", "title": "\ud800"})


def _pandas():
    pd = __import__("pandas")
    return {
        "pd.NA": lambda: pd.NA,
        "Series": lambda: pd.Series([1.0, 2.0]),
        "Series of text": lambda: pd.Series(["a", None]),
        "DataFrame": lambda: pd.DataFrame({"a": [1.0]}),
        "Timestamp": lambda: pd.Timestamp("2024-07-01"),
        "Timedelta": lambda: pd.Timedelta("1s"),
    }


HOSTILE = {
    "None": lambda: None,
    "NaN": lambda: math.nan,
    "inf": lambda: math.inf,
    "-inf": lambda: -math.inf,
    "-1": lambda: -1,
    "0": lambda: 0,
    "1.5": lambda: 1.5,
    "1e308": lambda: 1e308,
    "10**9": lambda: 10**9,
    "complex": lambda: 1j,
    "True": lambda: True,
    "empty text": lambda: "",
    "text": lambda: "x",
    "half a surrogate pair": lambda: "\ud800",
    "text with NUL": lambda: "a\0b",
    "number as text": lambda: "1",
    "bytes": lambda: b"x",
    "empty list": list,
    "list of None": lambda: [None],
    "list of mixed things": lambda: [1, "a", None],
    "ragged list": lambda: [[1.0], [1.0, 2.0]],
    "pair": lambda: ("tuning", object()),
    "empty dict": dict,
    "dict": lambda: {"a": 1},
    "dict of arrays": lambda: {"a": np.array([1.0, 2.0])},
    "dict with other keys": lambda: {None: 1, 2: "b"},
    "set": lambda: {1, 2},
    "large range": lambda: range(10**9),
    "object": object,
    "1-d array of one": lambda: np.array([1.0]),
    "empty array": lambda: np.empty(0),
    "3-d array": lambda: np.ones((2, 2, 2)),
    "array of objects": lambda: np.array([object(), None]),
    "array of text": lambda: np.array(["a", "b"]),
    "complex array": lambda: np.ones(2, dtype=complex),
    "datetime64": lambda: np.datetime64("2024-07-01"),
    "timedelta64": lambda: np.timedelta64(1, "s"),
    "NaT": lambda: np.datetime64("NaT"),
    "array of datetime64": lambda: np.array(["2024-07-01", "NaT"], dtype="M8[s]"),
    "masked array": lambda: np.ma.array([1.0, 2.0], mask=[True, False]),
    "np.str_": lambda: np.str_("x"),
    "Dataset": dataset,
    "DataArray": lambda: xr.DataArray([1.0, 2.0], dims="sample"),
    "DataArray along time": lambda: xr.DataArray([1.0, 2.0], {"elapsed_time": ["a", "b"]}, "elapsed_time"),
    "DataArray in bad units": lambda: xr.DataArray([1.0, 2.0], dims="elapsed_time", attrs={"units": 5}),
    "DataArray of text": lambda: xr.DataArray(["a", "b"], dims="sample"),
    "Path": lambda: Path("x"),
    "function": lambda: lambda: None,
    "module": lambda: math,
    "Decimal": lambda: decimal.Decimal(1),
    "datetime": lambda: datetime.datetime(2024, 7, 1),
    **_pandas(),
}
"""Name → function that makes the value."""

NEVER_RIGHT = ("object", "module")
"""Values that no argument accepts."""
