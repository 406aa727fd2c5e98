"""Values that no argument expects: of every type, of every size, some of which raise when they are looked at."""

from __future__ import annotations

import collections
import datetime
import decimal
import enum
import fractions
import io
import itertools
import math
from pathlib import Path

import numpy as np
import xarray as xr


class RaisingText:
    """Has no text of itself."""

    def __repr__(self):
        raise RuntimeError("no text")


class LongText:
    """Has a text of a megabyte, with line breaks and an escape sequence."""

    def __repr__(self):
        return "\x1b[31mlong\n" * 100_000


class RaisingArray:
    """Cannot be made into an array."""

    def __array__(self, *_, **__):
        raise KeyError("no array")

    def __len__(self):
        raise OSError("no length")

    def __iter__(self):
        raise LookupError("no values")

    def __float__(self):
        raise ZeroDivisionError("no number")


class RaisingEquality:
    """Cannot be compared, and has no hash."""

    def __eq__(self, other):
        raise RuntimeError("no comparison")

    def __bool__(self):
        raise RuntimeError("no truth")

    __hash__ = None


class RaisingAttributes:
    """Raises for every attribute that it does not have."""

    def __getattr__(self, name):
        raise RuntimeError(f"no {name}")


class RaisingPath:
    """A path without a text."""

    def __fspath__(self):
        raise RuntimeError("no path")


class BytesPath:
    """A path of bytes."""

    def __fspath__(self):
        return b"x"


class RaisingMapping(collections.UserDict):
    """A mapping that cannot be read."""

    def __init__(self):
        super().__init__(a=1)

    def __iter__(self):
        raise RuntimeError("no names")


class Number(float):
    """A number of a user's own class."""


class RaisingNumber(float):
    """A number that cannot be used."""

    def __float__(self):
        raise RuntimeError("no number")


class Whole(enum.IntEnum):
    """A number of an enumeration."""

    ONE = 1


def deep_list():
    """A list in a list, and so on."""
    value = []
    for _ in range(5000):
        value = [value]
    return value


def own_list():
    """A list that holds itself."""
    value = []
    value.append(value)
    return value


def dataset():
    """A Dataset of somebody else's."""
    return xr.Dataset({"x": ("t", [1.0, 2.0])}, attrs={"parameters": "{", "title": "\ud800"})


def forged_result():
    """A Dataset with the names of a result and other contents."""
    ds = xr.Dataset({"status": ((), 0), "rmse": ("sample", ["a", "b"])}, attrs={"parameters": "[[]]"})
    return ds.assign_coords(kp=("sample", [object(), None]))


def closed_file():
    """A file that can no longer be read."""
    file = io.StringIO()
    file.close()
    return file


def _pandas():
    pd = __import__("pandas")
    return {
        "pd.NA": lambda: pd.NA,
        "pd.NaT": lambda: pd.NaT,
        "Series": lambda: pd.Series([1.0, 2.0]),
        "Series of text": lambda: pd.Series(["a", None]),
        "Series of nullable numbers": lambda: pd.Series([1, pd.NA], dtype="Int64"),
        "DataFrame": lambda: pd.DataFrame({"a": [1.0]}),
        "Timestamp": lambda: pd.Timestamp("2024-07-01"),
        "Timedelta": lambda: pd.Timedelta("1s"),
        "Index": lambda: pd.Index([1, 2]),
        "MultiIndex": lambda: pd.MultiIndex.from_product([[1, 2], ["a", "b"]]),
        "Categorical": lambda: pd.Categorical(["a", "b"]),
    }


HOSTILE = {
    "None": lambda: None,
    "NaN": lambda: math.nan,
    "inf": lambda: math.inf,
    "-inf": lambda: -math.inf,
    "-1": lambda: -1,
    "0": lambda: 0,
    "-0.0": lambda: -0.0,
    "1.5": lambda: 1.5,
    "1e308": lambda: 1e308,
    "-1e308": lambda: -1e308,
    "1e-320": lambda: 1e-320,
    "10**9": lambda: 10**9,
    "10**400": lambda: 10**400,
    "10**5000": lambda: 10**5000,
    "complex": lambda: 1j,
    "True": lambda: True,
    "np.True_": lambda: np.True_,
    "empty text": lambda: "",
    "text": lambda: "x",
    "long text": lambda: "x" * 10_000,
    "half a surrogate pair": lambda: "\ud800",
    "text with NUL": lambda: "a\0b",
    "number as text": lambda: "1",
    "bytes": lambda: b"x",
    "bytearray": lambda: bytearray(b"x"),
    "empty list": list,
    "list of None": lambda: [None],
    "list of mixed things": lambda: [1, "a", None],
    "ragged list": lambda: [[1.0], [1.0, 2.0]],
    "deep list": deep_list,
    "list of itself": own_list,
    "list of a surrogate": lambda: ["\ud800"],
    "list of a large number": lambda: [10**400],
    "list of arrays": lambda: [np.array([1.0, 2.0]), np.array([1.0])],
    "empty tuple": tuple,
    "pair": lambda: ("tuning", object()),
    "pair with a bad dim": lambda: ("\ud800", [1.0, 2.0]),
    "pair with a generator": lambda: ("tuning", (k for k in range(3))),
    "pair with a Dataset": lambda: ("tuning", dataset()),
    "empty dict": dict,
    "dict": lambda: {"a": 1},
    "dict of arrays": lambda: {"a": np.array([1.0, 2.0])},
    "dict of a surrogate": lambda: {"\ud800": "\ud800"},
    "dict with other keys": lambda: {None: 1, 2: "b"},
    "raising mapping": RaisingMapping,
    "set": lambda: {1, 2},
    "large range": lambda: range(10**9),
    "object": object,
    "0-d array": lambda: np.array(1),
    "0-d array of a duration": lambda: np.array(1, dtype="m8[s]"),
    "1-d array of one": lambda: np.array([1.0]),
    "empty array": lambda: np.empty(0),
    "array of NaN": lambda: np.full(3, np.nan),
    "3-d array": lambda: np.ones((2, 2, 2)),
    "array of objects": lambda: np.array([object(), None]),
    "array of text": lambda: np.array(["a", "b"]),
    "structured array": lambda: np.zeros(2, dtype=[("a", float), ("b", int)]),
    "structured scalar": lambda: np.zeros(2, dtype=[("a", float), ("b", int)])[0],
    "complex array": lambda: np.ones(2, dtype=complex),
    "long doubles": lambda: np.full(2, np.finfo(np.longdouble).max),
    "long double": lambda: np.finfo(np.longdouble).max,
    "datetime64": lambda: np.datetime64("2024-07-01"),
    "timedelta64": lambda: np.timedelta64(1, "s"),
    "NaT": lambda: np.datetime64("NaT"),
    "array of datetime64": lambda: np.array(["2024-07-01", "NaT"], dtype="M8[s]"),
    "masked": lambda: np.ma.masked,
    "masked array": lambda: np.ma.array([1.0, 2.0], mask=[True, False]),
    "masked array of objects": lambda: np.ma.array([object(), None], mask=[True, False]),
    "np.void": lambda: np.void(b"x"),
    "np.str_": lambda: np.str_("x"),
    "np.float16": lambda: np.float16("inf"),
    "dtype": lambda: np.dtype("f8"),
    "Dataset": dataset,
    "forged result": forged_result,
    "DataArray": lambda: xr.DataArray([1.0, 2.0], dims="sample"),
    "DataArray without dims": lambda: xr.DataArray(1.0),
    "DataArray without dims, of an object": lambda: xr.DataArray(np.array(None, dtype=object)),
    "DataArray with a bad dim": lambda: xr.DataArray([1.0, 2.0], dims="\ud800"),
    "DataArray with odd dims": lambda: xr.DataArray(np.ones((2, 2)), dims=(1, None)),
    "DataArray with bad labels": lambda: xr.DataArray([1.0, 2.0], {"sample": ["a", "\ud800"]}, "sample"),
    "DataArray with labels of objects": lambda: xr.DataArray([1.0, 2.0], {"sample": [object(), None]}, "sample"),
    "DataArray along time": lambda: xr.DataArray([1.0, 2.0], {"elapsed_time": ["a", "b"]}, "elapsed_time"),
    "DataArray in bad units": lambda: xr.DataArray([1.0, 2.0], dims="elapsed_time", attrs={"units": 5}),
    "DataArray of text": lambda: xr.DataArray(["a", "b"], dims="sample"),
    "DataArray of objects": lambda: xr.DataArray(np.array([object(), None]), dims="sample"),
    "Variable": lambda: xr.Variable("sample", [1.0, 2.0]),
    "Path": lambda: Path("x"),
    "path without a text": RaisingPath,
    "path of bytes": BytesPath,
    "open file": lambda: io.StringIO("a,b\n1,2\n"),
    "closed file": closed_file,
    "function": lambda: lambda: None,
    "class": lambda: dict,
    "module": lambda: math,
    "generator": lambda: (k for k in range(3)),
    "endless generator": itertools.count,
    "Decimal": lambda: decimal.Decimal(1),
    "Fraction": lambda: fractions.Fraction(1, 3),
    "datetime": lambda: datetime.datetime(2024, 7, 1),
    "ellipsis": lambda: ...,
    "slice": lambda: slice(0, 1),
    "NotImplemented": lambda: NotImplemented,
    "own number": lambda: Number(1.0),
    "raising number": lambda: RaisingNumber(1.0),
    "number of an enumeration": lambda: Whole.ONE,
    "raising text": RaisingText,
    "long repr": LongText,
    "raising array": RaisingArray,
    "raising equality": RaisingEquality,
    "list of raising equality": lambda: [RaisingEquality()],
    "raising attributes": RaisingAttributes,
    "memoryview": lambda: memoryview(b"abc"),
    **_pandas(),
}
"""Name → what makes the value: anew for each call, since generators and files are used up."""

NEVER_RIGHT = ("object", "module", "ellipsis", "raising text", "raising attributes")
"""No argument takes one of these."""
