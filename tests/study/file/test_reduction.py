"""A user's own reduction of traces: where it is found, what it is handed, what it may return, and every refusal."""

from __future__ import annotations

import pickle
import sys
from types import ModuleType

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import only_problem, problems

from fastcoil.errors import InputError
from fastcoil.study.file.reduction import Reduction, find_reduction
from fastcoil.study.file.spec import read_study

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
            "tuning": ("scenario", ["slow"] * 3 + ["fast"] * 2),
        },
    )


def reducing(body, name="mine:f"):
    return Reduction(name, f"import numpy as np\nimport xarray as xr\ndef f(t):\n    {body}\n")


# What a function is handed, what it may return


def test_the_answer_is_that_of_the_function(traces):
    found = Reduction("mine:overshoot", SOURCE).apply(traces)
    expected = np.nanmax(traces.T_sup.values, axis=1) - 14.0
    np.testing.assert_array_equal(found.overshoot, expected)
    assert found.overshoot.dims == ("scenario",)
    assert set(found.variables) == {"overshoot", "undershoot"}, "the labels of the scenarios are not its business"


def test_swept_parameters_and_volumes_are_at_hand(traces):
    found = reducing("return xr.Dataset({'x': t.T_c.isel(volume=1).max('elapsed_time') * t.kp})").apply(traces)
    np.testing.assert_array_equal(found.x, (np.nanmax(traces.T_sup.values, axis=1) + 1.0) * traces.kp.values)
    assert "kp" not in found.coords


def test_further_dims_keep_their_labels_and_stand_behind_the_scenario(traces):
    body = "q = t.T_sup.quantile([0.1, 0.9], 'elapsed_time')\n    "
    found = reducing(body + "return xr.Dataset({'q': q, 'n': (t.T_sup > 14).sum('elapsed_time')})").apply(traces)
    assert found.q.dims == ("scenario", "quantile")
    assert found.coords["quantile"].values.tolist() == [0.1, 0.9]
    np.testing.assert_array_equal(found.q[0], np.quantile(traces.T_sup.values[0], [0.1, 0.9]))
    assert found.n.dtype.kind == "i"


def test_attributes_that_a_file_can_hold_are_kept(traces):
    body = "return xr.Dataset({'x': t.kp.rename(None).assign_attrs(units='K', factor=2, pair=[1, 2], f=len, yes=True)})"
    assert reducing(body).apply(traces).x.attrs == {"units": "K", "factor": 2}


def test_booleans_and_missing_values_are_answers(traces):
    found = reducing(
        "m = t.T_sup.mean('elapsed_time', skipna=False)\n    return xr.Dataset({'m': m, 'b': m > 14})"
    ).apply(traces)
    assert np.isnan(found.m[1])
    assert np.isnan(reducing("return xr.Dataset({'m': t.kp * np.nan})").apply(traces).m).all(), "NaN is equal to NaN"
    assert found.b.dtype == bool


def test_the_traces_are_as_they_were_and_cannot_be_written_to(traces):
    before = traces.copy(deep=True)
    reducing("t['more'] = t.T_sup + 1\n    return xr.Dataset({'x': t.more.max('elapsed_time')})").apply(traces)
    for name in ("T_sup", "kp"):
        problem = only_problem(reducing(f"t.{name}.values[:] = 0\n    return t").apply, traces)
        assert problem == "reduce = 'mine:f' raised ValueError: assignment destination is read-only"
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
    problem = only_problem(reducing(body).apply, traces)
    assert problem == (
        "reduce = 'mine:f' gives another x for a scenario alone than among others: treat each scenario by itself, to "
        "the last bit"
    )


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ("return t.T_sup.max('elapsed_time')", "returned a DataArray: return an xarray.Dataset"),
        ("return None", "returned a NoneType: return an xarray.Dataset"),
        ("return xr.Dataset()", "returned an empty Dataset: return at least one variable"),
        ("return xr.Dataset({'x': t.T_sup.max()})", "returned x without the dim 'scenario': give one value"),
        ("return xr.Dataset({'x': t.kp[1:]})", "returned x for 4 of 5 scenarios: keep every one of them"),
        ("return xr.Dataset({'x': t.tuning})", "returned x of type <U4: return numbers"),
        ("return xr.Dataset({'x': t.kp * 1j})", "returned x of type complex128: return numbers"),
        ("return xr.Dataset({'x': t.kp.astype('f2')})", "returned x of type float16: return numbers (float64, float32"),
        ("return xr.Dataset({'x': t.kp.astype('m8[s]')})", "returned x of type timedelta64[s]: return numbers"),
        *(
            (
                f"return xr.Dataset({{'{name}': ('scenario', t.kp.values)}})",
                f"returned a variable {name}: the name is ta",
            )
            for name in ("backlash", "rmse", "T_w", "status", "day", "sample", "controller")
        ),
        ("return xr.Dataset({3: t.kp})", "returned a variable 3: name it with letters, digits and _"),
        ("return xr.Dataset({'a/b': t.kp})", "returned a variable 'a/b': name it with letters, digits and _"),
        *(
            (f"return xr.Dataset({{'x': t.kp.expand_dims({name}=2)}})", f"returned a dim {name}: the name is taken")
            for name in ("backlash", "day", "replicate", "sample", "status", "rmse")
        ),
        ("return xr.Dataset({'x': t.kp.drop_vars('tuning').expand_dims(tuning=2)})", "returned a dim tuning: the name"),
        ("return xr.Dataset({'x': t.kp.expand_dims({'a b': 2})})", "returned a dim 'a b': name it with letters"),
        (
            "return xr.Dataset({'x': t.kp.expand_dims(y=2).assign_coords(y=np.array([1, 'a'], dtype=object))})",
            "returned labels of y that are neither numbers nor words: give it others, or drop them",
        ),
        ("return t.missing", "raised AttributeError: 'Dataset' object has no attribute 'missing'"),
        ("raise ValueError('two\\n   lines')", "raised ValueError: two lines"),
        ("raise ValueError", "raised ValueError"),
        ("raise SystemExit(3)", "raised SystemExit: 3"),
    ],
)
def test_a_wrong_answer_is_refused_with_one_sentence(traces, body, sentence):
    problem = only_problem(reducing(body).apply, traces)
    assert problem.startswith(f"reduce = 'mine:f' {sentence}")
    assert "\n" not in problem


def test_the_exception_of_the_function_is_the_cause(traces):
    with pytest.raises(InputError) as refused:
        reducing("return 1 / 0").apply(traces)
    assert isinstance(refused.value.__cause__, ZeroDivisionError)


def test_all_that_is_wrong_is_named(traces):
    body = "return xr.Dataset({'rmse': t.T_sup.max(), 'x': t.tuning.expand_dims(day=2)})"
    assert len(problems(reducing(body).apply, traces)) == 4


# Where a function is found


def test_a_module_next_to_the_study_comes_before_one_that_can_be_imported(tmp_path):
    (tmp_path / "statistics.py").write_text(SOURCE)
    assert find_reduction("statistics:overshoot", tmp_path).source == SOURCE
    (tmp_path / "pkg").mkdir()
    (tmp_path / "pkg" / "mine.py").write_text(SOURCE)
    assert find_reduction("pkg.mine:overshoot", tmp_path).name == "pkg.mine:overshoot"
    assert "def median(" in find_reduction("statistics:median", tmp_path / "pkg").source


def test_a_module_that_can_be_imported_is_found_without_running_it(tmp_path, monkeypatch):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "of_mine.py").write_text("import sys\n" + SOURCE)
    monkeypatch.syspath_prepend(tmp_path / "site")
    assert find_reduction("of_mine:overshoot", tmp_path).source == "import sys\n" + SOURCE
    assert "of_mine" not in sys.modules


def test_it_goes_to_another_process_as_text(traces):
    there = pickle.loads(pickle.dumps(Reduction("mine:overshoot", SOURCE)))
    assert there.apply(traces).identical(Reduction("mine:overshoot", SOURCE).apply(traces))


def test_the_module_is_run_once_and_is_one_that_decorators_find():
    source = "from __future__ import annotations\nfrom dataclasses import dataclass\n"
    source += "@dataclass\nclass Settings:\n    limit: float = 1.0\nruns = []\ndef f(t): return runs\n"
    one, two = Reduction("m:f", source), Reduction("m:f", str(source))
    one.function()(None).append(1)
    assert two.function()(None) == [1]


def test_the_hash_is_of_name_and_text():
    hashes = {Reduction(*r).sha256 for r in (("a:f", "x = 1"), ("a:g", "x = 1"), ("a:f", "x = 2"))}
    assert len(hashes) == 3
    assert Reduction("a:f", "x = 1").sha256 in hashes


def test_line_ends_of_another_system_change_nothing(tmp_path):
    (tmp_path / "mine.py").write_bytes(SOURCE.replace("\n", "\r\n").encode())
    assert find_reduction("mine:overshoot", tmp_path).source == SOURCE


@pytest.mark.parametrize(
    ("text", "source", "sentence"),
    [
        *(
            (text, SOURCE, f"reduce = {text!r}: give module:function, such as 'mine:overshoot'")
            for text in ("mine", "mine.py:overshoot()", "mine:", ":overshoot", "../mine:overshoot", "mine:a:b", "")
        ),
        ("absent:f", SOURCE, "absent.py, and no module absent can be imported: put absent.py next to the study file"),
        ("absent.mod:f", SOURCE, "absent/mod.py, and no module absent.mod can be imported: put mod.py next to"),
        ("made_here:f", SOURCE, "no module made_here can be imported"),
        ("math:f", SOURCE, "no module written in Python math can be imported"),
        ("mine:f", SOURCE, "reduce = 'mine:f': its module has no function f"),
        ("mine:f", "f = 3", "reduce = 'mine:f': its module has no function f"),
        ("mine:f", "def f(:", "reduce = 'mine:f': its module does not run: SyntaxError: invalid syntax"),
        ("mine:f", "import no_such_thing", "its module does not run: ModuleNotFoundError: No module named 'no_such"),
        ("mine:f", "raise SystemExit", "its module does not run: SystemExit"),
        ("mine:f", b"# \xe9", "mine.py cannot be read: "),
    ],
)
def test_what_cannot_be_found_or_run_is_refused_with_one_sentence(tmp_path, monkeypatch, text, source, sentence):
    monkeypatch.setitem(sys.modules, "made_here", ModuleType("made_here"))
    (tmp_path / "mine.py").write_bytes(source if isinstance(source, bytes) else source.encode())
    with pytest.raises(InputError) as refused:
        find_reduction(text, tmp_path)
    (problem,) = refused.value.problems
    assert sentence in problem
    assert "\n" not in problem


def test_both_places_that_were_looked_at_are_named(tmp_path):
    with pytest.raises(InputError) as refused:
        find_reduction("absent:f", tmp_path)
    assert f"there is no {tmp_path / 'absent.py'}, and no module absent can be imported" in str(refused.value)


# Studies

STUDY = "[loop]\n[run]\ntraces = ['T_sup']\nreduce = 'mine:overshoot'\n"


def test_a_study_finds_its_reduction_next_to_it_or_in_a_given_folder(tmp_path):
    for name, source in (("one", SOURCE), ("two", SOURCE + "\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text(source)
    (tmp_path / "one" / "study.toml").write_text(STUDY)
    one = read_study(tmp_path / "one" / "study.toml")
    two = read_study(tmp_path / "one" / "study.toml", tmp_path / "two")
    assert (one.reduction.source, two.reduction.source) == (SOURCE, SOURCE + "\n")
    assert one.sha256 != two.sha256, "the source is part of what decides the result"


def test_a_reduction_without_traces_and_an_absent_one_are_both_named(tmp_path):
    (tmp_path / "study.toml").write_text("[loop]\nkpp = 1\n[run]\nreduce = 'absent:f'")
    with pytest.raises(InputError) as refused:
        read_study(tmp_path / "study.toml")
    unknown, absent, without = refused.value.problems
    assert "kpp" in unknown
    assert "[run] reduce = 'absent:f': there is no" in absent
    assert "[run] reduce = 'absent:f' without traces: list the traces it needs, such as traces = [\"T_sup\"]" in without


def test_a_reduction_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "study.toml").write_text("[loop]\n[run]\nreduce = 3")
    with pytest.raises(InputError, match=r"\[run\] reduce = 3: give a text in quotes"):
        read_study(tmp_path / "study.toml")
