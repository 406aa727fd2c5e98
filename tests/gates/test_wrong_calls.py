"""A wrong argument of any public function gives a sentence: every argument, some forty wrong values."""

import datetime
import math
import random
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from helpers.public_calls import call_with, parameters, public_calls

import fastcoil as fc

pytestmark = [pytest.mark.kernel, pytest.mark.usefixtures("blank_figures")]

_LONGEST = 3000
"""Characters of a message."""
WRONG_VALUES = {
    "None": None, "NaN": math.nan, "inf": math.inf, "-1": -1, "0": 0, "1.5": 1.5, "1e308": 1e308, "10**9": 10**9,
    "complex": 1j, "True": True, "empty text": "", "text": "x", "half a surrogate pair": "\ud800",
    "text with NUL": "a\0b", "number as text": "1", "bytes": b"x", "list of mixed things": [1, "a", None],
    "ragged list": [[1.0], [1.0, 2.0]], "pair": ("tuning", object()), "dict": {"a": 1}, "set": {1, 2},
    "dict with other keys": {None: 1, 2: "b"}, "dict of arrays": {"a": np.array([1.0, 2.0])}, "Path": Path("x"),
    "large range": range(10**9), "object": object(), "function": lambda: None, "module": math,
    "empty array": np.empty(0), "3-d array": np.ones((2, 2, 2)), "array of objects": np.array([object(), None]),
    "array of text": np.array(["a", "b"]), "NaT": np.datetime64("NaT", "s"), "timedelta64": np.timedelta64(1, "s"),
    "array of datetime64": np.array(["2024-07-01", "NaT"], dtype="M8[s]"), "datetime": datetime.datetime(2024, 7, 1),
    "masked array": np.ma.array([1.0, 2.0], mask=[True, False]), "pd.NA": pd.NA,
    "DataFrame": pd.DataFrame({"a": [1.0]}),
    "Dataset": xr.Dataset({"x": ("t", [1.0, 2.0])}, attrs={"parameters": "{", "title": "\ud800"}),
    "DataArray": xr.DataArray(["a", "b"], dims="sample"), "0-d DataArray": xr.DataArray(75.0, attrs={"units": "degF"}),
    "DataFrame with pd.NA": pd.DataFrame({"elapsed_time [s]": pd.array([0, None], dtype="Int64")}),
    "DataArray along time": xr.DataArray([1.0, 2.0], {"elapsed_time": ["a", "b"]}, "elapsed_time"),
    "DataArray in bad units": xr.DataArray([1.0, 2.0], dims="elapsed_time", attrs={"units": 5}),
}  # fmt: skip
"""Wrong values that users pass by mistake: of another type, size, unit or shape."""
NEVER_RIGHT = ("object", "module")
"""Values that no argument accepts."""


def faults(base, name, argument, value):
    """What is wrong with the answer to a wrong value."""
    attempt = f"{name}({argument}={value})"
    try:
        call_with(base, **{argument: WRONG_VALUES[value]})
    except fc.FastcoilError as error:
        text = str(error)
        if value in NEVER_RIGHT and not isinstance(error, fc.InputTypeError):
            return [f"{attempt}: no InputTypeError, but {text:.200}"]
        if isinstance(error, fc.InputTypeError) and argument not in text and name.rpartition(".")[2] not in text:
            return [f"{attempt}: does not name the argument: {text:.200}"]
        if len(text) > _LONGEST or not text.replace("\n", "").isprintable():
            return [f"{attempt}: {len(text)} letters, perhaps not printable: {text:.200}"]
        return []
    except UserWarning:  # of a value that is right, such as no air flow
        pass
    except Exception as error:
        return [f"{attempt}: {type(error).__name__}: {error!s:.200}"]
    return [f"{attempt}: is taken"] if value in NEVER_RIGHT else []


def test_every_public_function_has_a_base_call(base_calls):
    assert base_calls.keys() == public_calls().keys()
    for name, base in base_calls.items():
        call_with(base)
        assert set(parameters(base[0])) == set(parameters(public_calls()[name]))


@pytest.mark.parametrize("n", [150, pytest.param(None, marks=pytest.mark.full)])
def test_a_wrong_argument_gets_a_sentence(base_calls, n):
    """Of all functions, arguments and wrong values some at random, or all."""
    arguments = [(name, a) for name, base in base_calls.items() for a in parameters(base[0]) if a != "changes"]
    attacks = [(*each, value) for each in arguments for value in WRONG_VALUES]
    attacks = random.Random(12).sample(attacks, n or len(attacks))
    all_faults = [fault for name, *attack in attacks for fault in faults(base_calls[name], name, *attack)]
    assert not all_faults, "\n".join(all_faults)
