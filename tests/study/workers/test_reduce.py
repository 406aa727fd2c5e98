"""A user's own reduction of traces: what it is handed, may return and raise, and every refusal."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from helpers.commands import fastcoil
from helpers.refusals import assert_mistakes, assert_refused, only_problem

from fastcoil.study.file.user_code import UserCode, load_function, reduce_traces

SOURCE = """
import numpy as np
import xarray as xr

def overshoot(traces):
    error = traces["T_sup"] - 14.0
    return xr.Dataset({"overshoot": error.max("elapsed_time"), "undershoot": -error.min("elapsed_time")})
"""
N, STEPS = 5, 40


@pytest.fixture
def traces():
    values = np.random.default_rng(0).normal(14.0, 1.0, (N, STEPS))
    values[1, 3] = np.nan
    return xr.Dataset(
        {
            "T_sup": (("scenario", "elapsed_time"), values, {"units": "degC"}),
            "T_c": (("scenario", "volume", "elapsed_time"), np.stack([values, values + 1.0], axis=1)),
        },
        coords={
            "elapsed_time": 60.0 * np.arange(STEPS),
            "kp": ("scenario", np.linspace(0.01, 0.05, N)),
            "gain": ("scenario", np.linspace(1.0, 2.0, N)),
            "tuning": ("scenario", ["slow"] * 3 + ["fast"] * 2),
        },
    )


def make_source(source, name="mine:overshoot"):
    return UserCode(name, source, Path("mine.py"))


def make_reduction(body, name="mine:f"):
    return make_source(f"import numpy as np\nimport xarray as xr\ndef f(t):\n    {body}\n", name)


# What a function is handed, what it may return


def test_the_answer_is_that_of_the_function(traces):
    reduced = reduce_traces(make_source(SOURCE), traces)
    expected = np.nanmax(traces.T_sup.values, axis=1) - 14.0
    np.testing.assert_array_equal(reduced.overshoot, expected)
    assert reduced.overshoot.dims == ("scenario",)
    assert set(reduced.variables) == {"overshoot", "undershoot"}, "the labels of the scenarios are not its business"


def test_swept_parameters_and_volumes_are_at_hand(traces):
    reduced = reduce_traces(
        make_reduction("return xr.Dataset({'x': t.T_c.isel(volume=1).max('elapsed_time') * t.kp})"), traces
    )
    np.testing.assert_array_equal(reduced.x, (np.nanmax(traces.T_sup.values, axis=1) + 1.0) * traces.kp.values)
    assert "kp" not in reduced.coords


def test_further_dims_keep_their_labels_and_stand_behind_the_scenario(traces):
    body = "q = t.T_sup.quantile([0.1, 0.9], 'elapsed_time')\n    "
    reduced = reduce_traces(
        make_reduction(body + "return xr.Dataset({'q': q, 'n': (t.T_sup > 14).sum('elapsed_time')})"), traces
    )
    assert reduced.q.dims == ("scenario", "quantile")
    assert reduced.coords["quantile"].values.tolist() == [0.1, 0.9]
    np.testing.assert_array_equal(reduced.q[0], np.quantile(traces.T_sup.values[0], [0.1, 0.9]))
    assert reduced.n.dtype.kind == "i"


def test_attributes_are_words_that_mean_nothing_to_a_decoder(traces):
    attributes = (
        "units='K', long_name='an \\u00e9', factor=2, comment=5, f=len, scale_factor=2.0, _FillValue='x', dtype='bool'"
    )
    body = (
        f"return xr.Dataset({{'x': t.kp.rename(None).assign_attrs({attributes}, add_offset=1.0, missing_value=0.01)}})"
    )
    assert reduce_traces(make_reduction(body), traces).x.attrs == {"units": "K", "long_name": "an \u00e9"}
    for units in ("'K\\0'", "'\\ud800'", "10**40"):
        body = f"return xr.Dataset({{'x': ('scenario', t.kp.values, {{'units': {units}}})}})"
        assert reduce_traces(make_reduction(body), traces).x.attrs == {}


def test_the_traces_are_as_they_were_and_cannot_be_written_to(traces):
    before = traces.copy(deep=True)
    reduce_traces(
        make_reduction("t['more'] = t.T_sup + 1\n    return xr.Dataset({'x': t.more.max('elapsed_time')})"), traces
    )
    for name in ("T_sup", "kp"):
        assert_refused("reduce", "code", reduce_traces, make_reduction(f"t.{name}.values[:] = 0\n    return t"), traces)
    assert traces.identical(before)
    traces.T_sup.values[0] = 0.0


@pytest.mark.parametrize(
    "body",
    [
        "return xr.Dataset({'x': t.T_sup.max('elapsed_time') / t.T_sup.max()})",
        "return xr.Dataset({'x': t.kp - t.kp[0]})",
        "return xr.Dataset({'x': t.kp.astype(int if t.sizes['scenario'] > 1 else float) * 0})",
        "return xr.Dataset({'x': t.kp, 'y': t.kp} if t.sizes['scenario'] > 1 else {'y': t.kp})",
        "return xr.Dataset({'y': t.kp, 'x': t.kp} if t.sizes['scenario'] == 1 else {'y': t.kp})",
        "return xr.Dataset({'x': t.kp * np.nextafter(1.0, 2.0) ** (t.sizes['scenario'] > 1)})",
        "return xr.Dataset({'y': t.kp.expand_dims(x=[t.sizes['scenario']])})",
    ],
)
def test_an_answer_that_depends_on_other_scenarios_is_refused(traces, body):
    assert_refused("reduce", "code", reduce_traces, make_reduction(body), traces)


@pytest.mark.parametrize(
    "answer",
    [
        *("t.T_sup.max('elapsed_time')", "None", "xr.Dataset()", "t.missing"),
        *(
            f"xr.Dataset({{'x': {values}}})"
            for values in (
                *("t.T_sup.max()", "t.kp[1:]", "t.tuning", "t.kp * 1j", "t.kp.astype('f2')", "t.kp.astype('m8[s]')"),
                *(f"t.kp.expand_dims({name}=2)" for name in ("backlash", "day", "sample", "status")),
                *("t.kp.expand_dims({'a b': 2})", "t.kp.expand_dims(y=['a\\0b'])"),
                "t.kp.expand_dims(y=2).assign_coords(y=np.array([1, 'a'], dtype=object))",
            )
        ),
        *(f"xr.Dataset({{{name!r}: t.kp.variable}})" for name in ("backlash", "rmse", "T_w", "day", "gain")),
        *(f"xr.Dataset({{{name}: t.kp}})" for name in ("3", "'a/b'", "'x' * 300", "'cafe\\u0301'")),
    ],
)
def test_a_wrong_answer_is_refused_with_one_sentence(traces, answer):
    assert_refused("reduce", "code", reduce_traces, make_reduction(f"return {answer}"), traces)


def test_all_that_is_wrong_is_named(traces):
    body = "return xr.Dataset({'rmse': t.T_sup.max(), 'x': t.tuning.expand_dims(day=2)})"
    assert_mistakes(4 * [("reduce", "code")], reduce_traces, make_reduction(body), traces)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("raise ValueError('two\\n   lines')", "ValueError: two lines"),
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("raise type('Mine', (BaseException,), {})('words')", "Mine: words"),
        ("return f(t)", "RecursionError: maximum recursion depth exceeded"),
        ("raise MemoryError", "MemoryError"),
        ("raise ValueError('x' * 1000)", "ValueError: " + 300 * "x" + " …"),
    ],
)
def test_whatever_the_function_raises_is_one_sentence(traces, body, words):
    problem = only_problem(reduce_traces, make_reduction(body), traces)
    assert (problem.field, problem.code) == ("reduce", "code")
    assert problem.startswith(f"reduce = 'mine:f' raised {words}")
    assert "\n" not in problem


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (SOURCE, "its module has no function f"),
        ("f = 3", "its module has no function f"),
        ("def f(:", "its module does not run: SyntaxError: "),
        ("f = 1\0", "its module does not run: "),
        ("import no_such_thing", "its module does not run: ModuleNotFoundError: No module named 'no_such_thing'"),
        ("class Mine(BaseException): pass\nraise Mine('words')", "its module does not run: Mine: words"),
    ],
)
def test_a_module_that_does_not_run_is_refused_with_one_sentence(source, words):
    problem = only_problem(load_function, "reduce", make_source(source, "mine:f"))
    assert problem.startswith(f"reduce = 'mine:f': {words}")
    assert "\n" not in problem


# On every backend


RAISING = """
class Mine(BaseException):
    def __init__(self, first, second):  # no other process can make it again from its text
        super().__init__(f"{first} {second}")

def f(traces):
    raise {what}
"""


@pytest.mark.kernel
@pytest.mark.usefixtures("leaves_nothing")
@pytest.mark.parametrize("backend", ["threads", "loky", pytest.param("dask", marks=pytest.mark.full)])
@pytest.mark.parametrize(
    ("what", "code", "sentence"),
    [
        ("Mine('two', 'words')", 2, "fastcoil: reduce = 'mine:f' raised Mine: two words"),
        pytest.param("SystemExit(0)", 2, "raised SystemExit: 0", marks=pytest.mark.full),
        pytest.param("GeneratorExit", 2, "raised GeneratorExit", marks=pytest.mark.full),
        pytest.param("RecursionError", 2, "raised RecursionError", marks=pytest.mark.full),
        pytest.param("MemoryError", 2, "raised MemoryError", marks=pytest.mark.full),
        pytest.param("KeyboardInterrupt", 130, "fastcoil: interrupted", marks=pytest.mark.full),
    ],
)
def test_whatever_a_reduction_raises_ends_the_run_with_a_sentence(
    tmp_path, small_study, request, backend, what, code, sentence
):
    text = small_study.read_text().replace('"T_sup", "mode"]', '"T_sup"]\nreduce = "mine:f"')
    (tmp_path / "study.toml").write_text(text)
    (tmp_path / "mine.py").write_text(RAISING.replace("{what}", what))
    words = ["run", tmp_path / "study.toml", "-o", tmp_path / "out", "--backend", backend, "-j", 1, "--no-figures"]
    if backend == "dask":
        words += ["--scheduler", request.getfixturevalue("two_workers").address]
    done = fastcoil(*words)
    assert done.exit_code == code, done.output
    (last,) = done.stderr.splitlines()[-1:]
    assert sentence in last
    assert "Traceback" not in done.output
