"""Datasets of every kind are read as the same log in a file."""

import numpy as np
import pytest
from helpers.refusals import assert_mistakes
from helpers.simulated_logs import add_noise, make_valve_log, random_walk, valve_flows

import fastcoil as fc
from fastcoil.logs import read_checked_log
from fastcoil.logs.columns import ColumnSpec

WANTED = ColumnSpec(("command", "m_w"))


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
    values = fc.read_log(renamed, columns=columns, units={"command": "1", "m_w": "kg/s"}).read(WANTED).values
    for name, expected in fc.read_log(log).read(WANTED).values.items():
        np.testing.assert_array_equal(values[name], expected)
    assert_mistakes([("command", "unit"), ("m_w", "unit")], fc.read_log(renamed, columns=columns).read, WANTED)


@pytest.mark.parametrize(
    ("change", "mistakes"),
    [
        (lambda ds: ds.drop_vars("m_w"), [("m_w", "missing")]),
        (lambda ds: ds.rename(elapsed_time="t"), [("elapsed_time", "missing")]),
        (lambda ds: ds.expand_dims(loop=2), [("command", "shape"), ("m_w", "shape")]),
        (lambda ds: ds.isel(elapsed_time=[0]), [("Dataset", "data")]),
        (lambda ds: ds.assign(m_w=ds["m_w"].where(ds["m_w"] > 1.0, "off")), [("m_w", "value")]),
        (lambda ds: ds.where(ds["elapsed_time"] != 300.0), [("command", "value"), ("m_w", "value")]),
        (lambda ds: ds.assign(command=(ds["command"] > 0.5).assign_attrs(units="1")), [("command", "value")]),
        (lambda ds: ds.assign_coords(time=("elapsed_time", np.arange(60).astype("M8[ns]"))), [("time", "conflict")]),
        (
            lambda ds: ds.to_dataframe().convert_dtypes().rename(columns="{} [1]".format).shift(),
            [("elapsed_time", "unit"), ("m_w", "unit"), ("command", "value")],
        ),
        (lambda ds: ds["m_w"], [("source", "type")]),
        (lambda ds: ds.to_dataframe(), [("elapsed_time", "unit"), ("command", "unit"), ("m_w", "unit")]),
        (lambda ds: ds.to_dataframe().iloc[:1], [("DataFrame", "data")]),
        (lambda ds: 7, [("source", "type")]),
    ],
)
def test_bad_datasets_are_refused(change, mistakes):
    log = make_valve_log(c := random_walk(np.random.default_rng(27), n=60), valve_flows(c))
    assert_mistakes(mistakes, lambda: fc.read_log(change(log)).read(WANTED))
