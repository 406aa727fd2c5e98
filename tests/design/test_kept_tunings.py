"""A search that was killed goes on from its file, to the same bits; a foreign or damaged file is refused."""

import json

import pytest
from helpers.refusals import only_problem

import fastcoil as fc
from fastcoil.base.errors import IntegrityError
from fastcoil.design import tune as module
from fastcoil.design.tuning_plan import key_of, plan_tuning

pytestmark = pytest.mark.kernel

HOW = {"search": {"kp": (0.005, 0.2), "buffer": (0.0, 0.01)}, "evaluations": 40, "warm_up": 60, "n_jobs": 1}


@pytest.fixture(scope="module")
def population():
    return fc.Loop(backlash=("sample", [0.0, 0.05, 0.1])), fc.paper_day(hours=0.1, seed=[1, 2])


@pytest.fixture(scope="module")
def whole(population):
    return fc.tune(*population, **HOW)


@pytest.fixture
def counted(monkeypatch):
    """How many tunings are simulated on the valves of the search."""
    simulated, tried = [], module.tried

    def counting(asked, group, values):
        simulated.append(len(values))
        return tried(asked, group, values)

    monkeypatch.setattr(module, "tried", counting)
    return simulated


class Killed(Exception):
    pass


def killed_after(n):
    def progress(done, planned):
        assert planned == 40
        if done >= n:
            raise Killed

    return progress


@pytest.mark.parametrize("after", [8, 32])
def test_a_search_that_was_killed_goes_on_to_the_same_bits(population, whole, counted, tmp_path, after):
    path = tmp_path / "tune.json"
    with pytest.raises(Killed):
        fc.tune(*population, **HOW, kept=path, progress=killed_after(after))
    before = sum(counted)
    kept = json.loads(path.read_text())["tried"]
    assert before == len(kept) > 0
    again = fc.tune(*population, **HOW, kept=path)
    for name in ("trained", "held_out", "front", "evaluations"):
        assert getattr(again, name).identical(getattr(whole, name))
    every = whole.evaluations.sizes["evaluation"]
    front, chosen_on_both = whole.front.sizes["point"], 2
    assert sum(counted) == every + front + chosen_on_both, "none is simulated twice"


def test_more_evaluations_use_those_that_were_kept(population, counted, tmp_path):
    fc.tune(*population, **HOW, kept=tmp_path / "tune.json")
    counted.clear()
    fc.tune(*population, **HOW | {"evaluations": 48}, kept=tmp_path / "tune.json")
    assert sum(counted) < 48


@pytest.mark.parametrize(
    "change", [{"seed": 1}, {"warm_up": 90}, {"objective": "iae"}, {"search": {"kp": (0.005, 0.2)}}, {"replicates": 2}]
)
def test_another_tuning_has_another_key(population, change):
    def key(**how):
        how = {name: value for name, value in (HOW | how).items() if name != "n_jobs"}
        return key_of(plan_tuning(*population, **how))

    assert key(**change) != key()
    assert key(evaluations=99, search={"kp": (0.1, 0.2), "buffer": (0.0, 0.1)}) == key(), "what was tried still holds"


def test_a_file_of_another_tuning_is_refused_and_kept(population, tmp_path):
    path = tmp_path / "tune.json"
    path.write_text(
        '{"kind": "fastcoil tuning", "format": 1, "key": "x", "parameters": [], "measures": [], "tried": []}'
    )
    before = path.read_bytes()
    problem = only_problem(fc.tune, *population, **HOW, kept=path)
    assert "keeps tunings of other valves, days, measures or another model" in problem
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "text", ["", "{}", '{"kind": "fastcoil tuning", "format": 1, "key": "", "parameters": [], "mea']
)
def test_a_damaged_file_is_refused(population, tmp_path, text):
    (tmp_path / "tune.json").write_text(text)
    with pytest.raises(IntegrityError, match="delete it"):
        fc.tune(*population, **HOW, kept=tmp_path / "tune.json")
