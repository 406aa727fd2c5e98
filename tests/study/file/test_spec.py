"""Study files: what they mean, and that every mistake in one is named, all at once."""

from importlib.resources import files

import numpy as np
import pytest
from helpers.refusals import assert_mistakes, assert_refused

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


def test_all_mistakes_are_named_together(read):
    text = """
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
        """
    mistakes = [("titel", "name"), ("seed", "type"), ("kpp", "name"), ("preset", "choice"), ("ti", "value")]
    mistakes += [("kp", "type"), ("backlash", "value"), ("estimate_ratio", "missing"), ("hourss", "name")]
    assert_mistakes(mistakes, read, text)


MISTAKES = [
    ("[loop]\nkp = '0.1'", "kp", "type"),
    ("[loop]\nbacklash = 0.95", "backlash", "value"),
    ("[loop]\n[sweep]\nkp = [0.1, 0.1]", "kp", "duplicate"),
    ("[loop]\n[sweep]\nkp = 'all'", "kp", "value"),
    ("[loop]\n[sweep]\nkp = { geomspace = [0, 1, 3] }", "kp", "value"),
    ("[loop]\n[sweep]\nkp = { linspace = [0, 1, 2.5] }", "kp", "value"),
    ("[loop]\n[cases.kp]\na = { ti = 3 }", "kp", "name"),
    ("[loop]\n[cases.tuning]", "tuning", "missing"),
    ("[loop]\n[cases.day]\na = { kp = 0.1 }", "kp", "name"),
    ("[loop]\n[boundary]\nkind = 'paperday'", "kind", "choice"),
    ("[loop]\n[boundary]\nkind = 'csv'", "path", "missing"),
    ("[loop]\n[run]\ntraces = ['T_supp']", "traces", "choice"),
    ("[loop]\n[run]\nseed = -1", "seed", "value"),
    ("[loop]\n[run]\nreplicates = 0", "replicates", "value"),
    ("[sweep]\nkp = [1]", "loop", "missing"),
    ("loop = 3", "loop", "type"),
    ("sample = 4\n[loop]", "sample", "type"),
    ("[loop]\nlearning_step = 0.01\nbacklash_estimate = 0.3", "backlash_estimate", "conflict"),
    ("[loop]\nn_volumes = 9", "C_w", "value"),
    ("[loop]\nrangeability = 50", "authority", "missing"),
    ("[loop]\nkp = 0.1\n[sweep]\nkp = [0.1]", "kp", "duplicate"),
    ("[loop]\n[sweep]\nkp = [1]\n[cases.tuning]\na = { kp = 2 }", "kp", "duplicate"),
    ("[loop]\n[cases.x]\na = { estimate_ratio = 1 }\nb = {}", "estimate_ratio", "missing"),
    ("[loop]\n[boundary]\nhours = 0.2", "boundary", "data"),
    ("[loop]\n[boundary]\nkind = 'csv'\npath = 'log.csv'", "TMP/log.csv", "path"),
    ("[loop]\n[sweep]\nkp = { linspace = [0, 1" + 400 * "0" + ", 3] }", "kp", "value"),
    ("[loop]\nkp = 1" + 5000 * "0", "TMP/study.toml", "format"),
    ("[loop\n", "TMP/study.toml", "format"),
    (b"[loop]\ntitle = '\xe9'", "TMP/study.toml", "format"),
]


@pytest.mark.parametrize(("text", "field", "code"), MISTAKES)
def test_a_mistake_gets_one_sentence_with_field_value_and_cure(read, tmp_path, text, field, code):
    assert_refused(field.replace("TMP", str(tmp_path)), code, read, text)


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
