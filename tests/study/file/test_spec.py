"""Study files: what they mean, and that every mistake in one is named, all at once."""

from importlib.resources import files

import numpy as np
import pytest
from helpers.refusals import only_problem, problems

from fastcoil.study.file.spec import read_study


@pytest.fixture
def read(tmp_path):
    def read(text):
        path = tmp_path / "study.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_study(path)

    return read


@pytest.mark.filterwarnings("ignore:action = 'heating', but the water")
def test_axes_cases_and_constants_become_the_loop(read):
    loop = read("""
        [loop]
        preset = "lbnl"
        noise_std = 0.05
        [sweep]
        backlash = { linspace = [0.01, 0.15, 15] }
        buffer = { geomspace = [0.001, 0.1, 3] }
        action = ["cooling", "heating"]
        [cases.tuning]
        slow = { ti = 60 }
        fast = { ti = 10, sample_time = 5 }
    """).plan.layout.loop
    assert loop.sizes == {"backlash": 15, "buffer": 3, "action": 2, "tuning": 2}
    assert loop["noise_std"] == 0.05
    assert loop["stroke_time"] == 90.0
    np.testing.assert_allclose(loop["buffer"], [0.001, 0.01, 0.1])
    assert loop["sample_time"].values.tolist() == [15.0, 5.0], "a case that leaves a parameter out keeps the loop's"
    assert loop.coordinates()["tuning"].values.tolist() == ["slow", "fast"]


def test_an_absent_boundary_is_the_paper_day_of_8_hours(read):
    boundary = read("[loop]").plan.layout.boundary
    assert (boundary.hours, boundary.n_days) == (8.0, 1)


def test_run_table_reaches_the_plan(read):
    plan = read("[loop]\n[run]\nseed = 7\nreplicates = 3\nwarm_up = 600\ntraces = ['u']\ntrace_interval = 30").plan
    assert (plan.seed, plan.n_scenarios, plan.warm_up) == (7, 3, 600)
    assert (plan.traces.names, plan.traces.interval) == (("u",), 30)


def test_all_mistakes_are_named_at_once(read):
    mistakes = problems(
        read,
        """
        titel = "x"
        [loop]
        preset = "paper_lik"
        kpp = 3
        ti = inf
        kp = true
        [sweep]
        backlash = { linspace = [0.01, 0.15] }
        estimate_ratio = []
        [boundary]
        hourss = 1
        [run]
        seed = 1.5
        """,
    )
    for part in (
        "titel is unknown, did you mean 'title'?",
        "[loop] preset = 'paper_lik', did you mean 'paper_like'?",
        "[loop] kpp is not a parameter, did you mean 'kp'?",
        "[loop] ti = inf: give a finite number",
        "[loop] kp = True: give a number",
        "[sweep] backlash = { linspace = [0.01, 0.15] }: give [first, last, count]",
        "[sweep] estimate_ratio = []: a sweep needs at least one value",
        "[boundary] hourss is not an argument of paper_day, did you mean 'hours'?",
        "[run] seed = 1.5: give a whole number",
    ):
        assert any(part in p for p in mistakes), part
    assert all("study.toml" in p for p in mistakes)


MISTAKES = [
    ("[loop]\nkp = '0.1'", "kp = '0.1': give a number"),
    ("[loop]\nbacklash = 0.95", "backlash = 0.95: must be from 0 to 0.9"),
    ("[loop]\n[sweep]\nkp = [0.1, 0.1]", "kp: 0.1 appears twice"),
    ("[loop]\n[sweep]\nkp = 'all'", "kp = 'all': give a list of values"),
    ("[loop]\n[sweep]\nkp = { geomspace = [0, 1, 3] }", "must be above 0"),
    ("[loop]\n[sweep]\nkp = { linspace = [0, 1, 2.5] }", "a whole number from 1"),
    ("[loop]\n[cases.kp]\na = { ti = 3 }", "kp is a parameter: give the dimension another name"),
    ("[loop]\n[cases.tuning]", "no case: give at least one"),
    ("[loop]\n[cases.day]\na = { kp = 0.1 }", "'day' cannot be the name of a swept dimension"),
    ("[loop]\n[boundary]\nkind = 'paperday'", "did you mean 'paper_day'?"),
    ("[loop]\n[boundary]\nkind = 'csv'", "path is missing: csv needs it"),
    ("[loop]\n[run]\ntraces = ['T_supp']", "did you mean 'T_sup'?"),
    ("[loop]\n[run]\nseed = -1", "seed = -1: must be at least 0"),
    ("[loop]\n[run]\nreplicates = 0", "replicates = 0: must be at least 1"),
    ("[sweep]\nkp = [1]", "[loop] is missing"),
    ("loop = 3", "loop = 3: give a table"),
    ("sample = 4\n[loop]", "sample = 4: give a table"),
    ("[loop]\nlearning_step = 0.01\nbacklash_estimate = 0.3", "cannot start above learning_cap"),
    ("[loop]\nn_volumes = 9", "substeps = 2 is stable"),
    ("[loop]\nrangeability = 50", "authority and m_full missing"),
    ("[loop]\nkp = 0.1\n[sweep]\nkp = [0.1]", "kp appears in [loop] and in [sweep]"),
    ("[loop]\n[sweep]\nkp = [1]\n[cases.tuning]\na = { kp = 2 }", "kp appears in [sweep] and in [cases.tuning]"),
    ("[loop]\n[cases.x]\na = { estimate_ratio = 1 }\nb = {}", "estimate_ratio is missing in b"),
    ("[loop]\n[boundary]\nhours = 0.2", "nothing is left to count"),
    ("[loop]\n[boundary]\nkind = 'csv'\npath = 'log.csv'", "log.csv"),
    ("[loop]\n[sweep]\nkp = { linspace = [0, 1" + 400 * "0" + ", 3] }", "two finite numbers"),
    ("[loop]\nkp = 1" + 5000 * "0", "not valid TOML"),
    ("[loop\n", "not valid TOML"),
    (b"[loop]\ntitle = '\xe9'", "is not UTF-8"),
]


@pytest.mark.parametrize(("text", "sentence"), MISTAKES)
def test_a_mistake_gets_one_sentence_with_field_value_and_cure(read, text, sentence):
    assert sentence in only_problem(read, text)


@pytest.mark.parametrize(
    ("text", "warning"),
    [
        ("[loop]\nkp = 100", "kp = 100 1/K is unusual and taken as it is: if it is in %/K, divide it by 100"),
        ("[loop]\n[sweep]\nti = [0.5, 8]", "ti = 0.5 s is unusual and taken as it is: if it is in minutes, multiply"),
        ("[loop]\nbacklash = 0.5", "backlash = 0.5 is unusual and taken as it is: if it is in %, divide it by 100"),
        ("[loop]\nti = 1.5", "ti = 1.5 s is unusual and taken as it is: if it is in minutes, multiply it by 60"),
        ("[loop]\nnoise_std = 5", "noise_std = 5 K is unusual and taken as it is: if it is in mK, divide it by 1000"),
        ("[loop]\nsensor_resolution = 50", "sensor_resolution = 50 K is unusual and taken as it is: if it is in mK"),
        ("[loop]\nC_w = 8800", "C_w = 8800 kJ/K is unusual and taken as it is: if it is in J/K, divide it by 1000"),
        ("[loop]\n[cases.motor]\na = { stroke_time = 1.5 }\nb = {}", "stroke_time = 1.5 s is unusual"),
        ("[loop]\nkp = 1\nti = 3\nbacklash = 0.3\nstroke_time = 0", ""),
    ],
)
def test_a_magnitude_of_another_unit_is_warned_of(read, recwarn, text, warning):
    read(text)
    assert [str(w.message)[: len(warning)] for w in recwarn] == [warning] * bool(warning)


def test_windows_line_ends_and_a_byte_order_mark_change_nothing(read):
    plain = read("[loop]\nkp = 0.04\n")
    assert read("﻿[loop]\r\nkp = 0.04\r\n".encode()).sha256 == plain.sha256


def test_the_hash_tells_studies_apart(read):
    text = "[loop]\nkp = 0.04\n[sweep]\nti = [5, 9]\nbacklash = [0.1]"
    variants = [text.replace("0.04", "0.05"), text.replace("5, 9", "9, 5"), f"{text}\n[boundary]\nseed = 2"]
    variants += ["[loop]\nkp = 0.04\n[sweep]\nbacklash = [0.1]\nti = [5, 9]", f"{text}\n[run]\nseed = 1"]
    assert len({read(variant).sha256 for variant in (text, *variants)}) == 6


def test_the_hash_is_of_values_and_not_of_their_spelling(read):
    plain = read("[loop]\nkp = 0.04\n[sweep]\nti = [5, 9]")
    same = read("# why\ntitle = 'x'\nquestion = 'y?'\nloop.kp = 4.0e-2  # 1/K\n\n\n[ sweep ]\nti = [\n  5,\n  9,\n]\n")
    assert same.sha256 == plain.sha256
    assert "# why" in same.text, "the text is kept as it was written"


def log_text(T_set):
    head = "elapsed_time [s],m_a [kg/s],T_a_in [degC],W_a_in [g/kg],T_w_in [degC],T_set [degC]\n"
    return head + "".join(f"{t},1.2,25,10,7,{T_set}\n" for t in range(0, 7260, 60))


def test_the_hash_is_also_of_what_lies_in_other_files(read, tmp_path):
    def day(T_set):
        (tmp_path / "log.csv").write_text(log_text(T_set))
        return read("[loop]\n[boundary]\nkind = 'csv'\npath = 'log.csv'").sha256

    assert day(14) == day(14)
    assert day(14) != day(15)


def test_the_template_is_a_valid_study(read):
    assert read(files("fastcoil.study.file").joinpath("template.toml").read_bytes()).plan.n_scenarios == 150


def test_a_relative_path_starts_from_the_study_file(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "log.csv").write_text(log_text(14))
    (tmp_path / "sub" / "study.toml").write_text("[loop]\n[boundary]\nkind = 'csv'\npath = 'log.csv'")
    boundary = read_study(tmp_path / "sub" / "study.toml").plan.layout.boundary
    assert boundary.series["W_a_in"][0, 0] == pytest.approx(0.010)
    (tmp_path / "study.toml").write_text((tmp_path / "sub" / "study.toml").read_text())
    assert read_study(tmp_path / "study.toml", tmp_path / "sub").plan.layout.boundary == boundary
