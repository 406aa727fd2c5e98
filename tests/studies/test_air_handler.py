"""Scores of the air handler's study for inspectors that know the truth, blame others or are silent."""

from types import SimpleNamespace

import pytest

import fastcoil as fc
from studies.air_handler import air_handler as study
from studies.air_handler import placebos, truth, units
from studies.air_handler.truth import COOLING, HEATING

pytestmark = pytest.mark.kernel
CASES = (study.Case(truth.LEAK, COOLING, 0.5), study.Case(truth.STUCK_SHUT, HEATING), study.Case(truth.FIGHT, size=3.0),
         study.Case(truth.SWINGS, size=3.0, cause=truth.SWINGS))  # fmt: skip


def finding(component, kind, windows, cause=""):
    return SimpleNamespace(component=component, kind=kind, windows=windows, cause=cause)


def result(case, seed, answer):
    unit = units.simulate_unit(seed, case.fault, case.size, case.component, study.DAYS, case.cause)
    return study.Result(case, unit, answer(unit))


def know(unit):
    return [finding(unit.truth.component, unit.truth.kind, unit.truth.windows, "outer loop")]


def blame_others(unit):
    other = HEATING if unit.truth.component == COOLING else COOLING
    return [finding(other, "stuck_open", unit.truth.windows)]


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(
    ("answer", "scores"), [(know, (True, False)), (blame_others, (False, True)), (lambda _: [], (False, False))]
)
def test_who_knows_is_right_and_who_blames_another_is_wrong(case, answer, scores):
    results = [result(case, seed, answer) for seed in range(910, 914)]
    shown = [r for r in results if r.shows]
    assert shown
    assert {(r.is_right, r.is_wrong) for r in shown} == {scores}
    (row,) = study.fault_rows({case: results})
    percent = [cell.split(" %")[0] for cell in row[4:7]]
    assert percent == [f"{100 * s}" for s in (*scores, scores == (False, False))]


def test_a_finding_at_another_time_is_not_right():
    r = result(CASES[0], 911, know)
    start = r.unit.signals.index[0] - 2 * (r.unit.signals.index[-1] - r.unit.signals.index[0])
    early = r._replace(findings=[finding(COOLING, "leak", [(start, start)])])
    assert (r.is_right, early.is_right) == (True, False)
    seconds = [tuple((t - r.unit.signals.index[0]).total_seconds() for t in w) for w in r.unit.truth.windows]
    assert r._replace(findings=[finding(COOLING, "leak", seconds)]).is_right


def test_days_called_hunting_are_found_if_they_hunt_and_accused_if_calm():
    unit = units.simulate_unit(307, truth.HUNT, component=COOLING, cause=units.LOAD)
    s = unit.signals.index
    said = [finding(COOLING, "hunt", [(s[1440 * k], s[1440 * k + 60])]) for k in unit.observed.hunting[COOLING]]
    cooling, heating, _ = study.hunting_rows([study.Result(study.HUNTING[0], unit, said)])
    assert cooling[:2] == [COOLING, f"{len(said)}"]
    assert cooling[2].startswith("100 %")
    assert cooling[4].startswith(("0 %", "none"))
    assert heating[1] == "0"


def test_disorder_moves_what_it_says_and_a_coil_that_cannot_is_named():
    unit = units.simulate_unit(912)
    late = placebos.shift_commands(6)(unit)
    header = unit.columns["cooling_command"]
    assert late[header].iloc[360:].tolist() == unit.log[header].iloc[:-360].tolist()
    assert late.drop(columns=[unit.columns[f"{s}_command"] for s in ("cooling", "heating")]).equals(
        unit.log.drop(columns=[unit.columns[f"{s}_command"] for s in ("cooling", "heating")])
    )
    assert placebos.swap_headers(unit)[header].equals(unit.log[unit.columns["heating_command"]].rename(header))
    back = placebos.reverse_log(unit)
    assert back.iloc[:, 1:].iloc[::-1].reset_index(drop=True).equals(unit.log.iloc[:, 1:])
    index = unit.signals.index
    colder = unit.log.copy()
    colder[unit.columns["T_sup"]] = colder[unit.columns["T_mixed"]] - 3.0
    whole = [(index[0], index[-1])]
    assert study.is_impossible(finding(HEATING, "leak", whole), unit, colder)
    assert not study.is_impossible(finding(COOLING, "leak", whole), unit, colder)


def test_tables_have_a_row_for_each_fault_component_cause_and_disorder(monkeypatch, read_table):
    monkeypatch.setattr(fc, "inspect", lambda _: SimpleNamespace(findings=[]), raising=False)
    monkeypatch.setattr(study, "Parallel", lambda **_: lambda jobs: [f(*a, **k) for f, a, k in jobs])
    study.write_tables(2, 2, 1, CASES[:2])
    assert len(read_table("air_handler")[1]) == 1 + 2
    assert read_table("air_handler_healthy")[1][1][2].startswith("0 %")
    assert [row[0] for row in read_table("air_handler_hunting")[1][1:]] == [COOLING, HEATING, "set-point"]
    assert len(read_table("air_handler_causes")[1]) == 1 + 4
    assert [row[0] for row in read_table("air_handler_placebos")[1][1:]] == list(placebos.PLACEBOS)


def test_every_case_is_scored_by_kinds_that_exist():
    kinds = study.ACCUSATIONS | {truth.HUNT, truth.SWINGS, truth.UNOCCUPIED, "not_met"}
    for case in study.CASES:
        assert study.RIGHT_KINDS.get(case.fault, {case.fault}) <= kinds
    assert len(set(study.CASES)) == len(study.CASES)
    assert set(study.SAMPLE_CASES) <= set(study.CASES)
