"""Datasets of every kind are read as the same log in a file."""

import numpy as np
import pytest
from helpers.simulated_logs import add_noise, make_valve_log, random_walk, valve_flows

import fastcoil as fc
from fastcoil.logs import read_checked_log
from fastcoil.logs.columns import ColumnSpec

WANTED = ColumnSpec(("command", "m_w"))
pytestmark = pytest.mark.kernel


def test_a_dataset_with_timestamps_is_as_one_with_seconds():
    log = make_valve_log(c := random_walk(np.random.default_rng(25), n=200), valve_flows(c))
    stamps = np.datetime64("2024-07-01T08:00") + np.arange(200) * np.timedelta64(60, "s")
    with_timestamps = [
        log.drop_vars("elapsed_time").rename({"elapsed_time": name}).assign_coords({name: stamps})
        for name in ("timestamp", "time", "elapsed_time")
    ]
    expected = read_checked_log(log, WANTED)
    for dataset in (*with_timestamps, log.assign_coords(elapsed_time=stamps - stamps[0])):
        log_read = read_checked_log(dataset, WANTED)
        for name in ("time", "batch", "rows"):
            np.testing.assert_array_equal(getattr(log_read, name), getattr(expected, name))
        for name, values in expected.values.items():
            np.testing.assert_array_equal(log_read.values[name], values)


def test_a_dataset_of_other_names_and_units_is_read_as_a_file_would_be():
    rng = np.random.default_rng(26)
    log = make_valve_log(c := random_walk(rng, n=200), add_noise(rng, valve_flows(c), 0.02))
    renamed = log.rename(command="CHW valve", m_w="CHW flow")
    for name in ("CHW valve", "CHW flow"):
        del renamed[name].attrs["units"]
    columns = {"command": "CHW valve", "m_w": "CHW flow"}
    units = {"command": "1", "m_w": "kg/s"}
    assert fc.fit_valve(renamed, columns=columns, units=units).parameters == fc.fit_valve(log).parameters
    with pytest.raises(fc.InputError, match=r"m_w has no unit: give it attrs\['units'\] = 'UNIT'"):
        fc.fit_valve(renamed, columns=columns)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda ds: ds.drop_vars("m_w"), "m_w is missing"),
        (lambda ds: ds.rename(elapsed_time="t"), "no coordinate elapsed_time, nor timestamp"),
        (lambda ds: ds.expand_dims(loop=2), "choose one loop"),
        (lambda ds: ds.isel(elapsed_time=[0]), "fewer than two samples"),
        (
            lambda ds: ds.assign(m_w=ds["m_w"].astype(str).where(ds["m_w"] > 1.0, "off").assign_attrs(units="kg/s")),
            "m_w = 'off' in row",
        ),
        (lambda ds: ds.where(ds["elapsed_time"] != 300.0), "command = 'nan' in row 5"),
        (
            lambda ds: ds.assign(command=(ds["command"] > 0.5).assign_attrs(units="1")),
            "command = '(True|False)' in row",
        ),
        (
            lambda ds: ds.assign_coords(time=("elapsed_time", np.arange(60).astype("M8[s]").astype("M8[ns]"))),
            "time and elapsed_time of the Dataset differ in their steps",
        ),
        (
            lambda ds: ds.to_dataframe().convert_dtypes().rename(columns="{} [1]".format).shift(),
            "command = 'nan' in row 0",
        ),
        (lambda ds: ds["m_w"], "log is a DataArray"),
        (lambda ds: ds.to_dataframe(), "DataFrame: command has no unit: name the column 'command"),
        (lambda ds: ds.to_dataframe().iloc[:1], "fewer than two samples"),
        (lambda ds: 7, "log is a int"),
    ],
)
def test_bad_datasets_are_refused(change, words):
    log = make_valve_log(c := random_walk(np.random.default_rng(27), n=60), valve_flows(c))
    with pytest.raises(fc.InputError, match=words):
        fc.fit_valve(change(log))
