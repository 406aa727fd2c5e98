"""A study with a [sample]: what it means, every mistake in it, and the files that it names."""

import numpy as np
import pytest
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.study.file.sample import sample_values
from fastcoil.study.file.spec import read_study


@pytest.fixture
def read(tmp_path):
    def read(sample, before="[loop]", after=""):
        (tmp_path / "study.toml").write_text(f"{before}\n[sample]\n{sample}\n{after}")
        return read_study(tmp_path / "study.toml")

    return read


@pytest.mark.filterwarnings("ignore:action = 'heating', but the water")
def test_sampled_parameters_are_zipped_along_one_dimension(read):
    study = read(
        """
        method = "latin_hypercube"
        size = 10
        kp = { loguniform = [0.005, 0.05] }
        n_volumes = { choice = [4, 8] }
        action = { choice = ["cooling", "heating"] }
        """,
        "[loop]\n[sweep]\nbacklash = [0.02, 0.07]\n[cases.tuning]\na = { ti = 5 }\nb = { ti = 9 }",
    )
    loop = study.plan.layout.loop
    assert loop.sizes == {"backlash": 2, "tuning": 2, "sample": 10}
    for name in ("kp", "n_volumes", "action"):
        assert loop[name].dims == ("sample",)
    assert loop["n_volumes"].dtype.kind == "i"
    np.testing.assert_array_equal(loop.coordinates()["sample"], np.arange(10))
    np.testing.assert_array_equal(loop["kp"], sample_values(study.tables["sample"])["kp"])


VALVE = {
    "rangeability": "{ uniform = [30, 60] }",
    "authority": "{ uniform = [0.2, 0.6] }",
    "m_full": "{ choice = [1] }",
}


@pytest.mark.parametrize("count", [1, 2, 3])
def test_an_installed_valve_may_be_sampled_in_part(read, count):
    constant = {"m_full": 1.2, "rangeability": 50.0, "authority": 0.4}
    sampled = list(VALVE)[:count]
    rest = [n for n in VALVE if n not in sampled]
    loop = read(
        "method = 'sobol'\nsize = 4\n" + "\n".join(f"{n} = {VALVE[n]}" for n in sampled),
        "[loop]\n" + "\n".join(f"{n} = {constant[n]}" for n in rest),
    ).plan.layout.loop
    assert {n: loop[n] for n in rest} == {n: constant[n] for n in rest}
    assert all(loop[n].dims == ("sample",) for n in sampled)
    assert loop["m_max"] is None


# Mistakes

GOOD = "method = 'random'\nsize = 4\n"
KP = "kp = { uniform = [0.01, 0.05] }\n"
TI = "ti = { uniform = [5, 300] }\n"


MISTAKES = [
    ("size = 4\n" + KP, "method", "missing"),
    ("method = 'random'\n" + KP, "size", "missing"),
    ("method = 'sobl'\nsize = 4\n" + KP, "method", "choice"),
    ("method = 'sobol'\nsize = 1000\n" + KP, "size", "value"),
    ("method = 'random'\nsize = 0\n" + KP, "size", "value"),
    (GOOD + "seed = -1\n" + KP, "seed", "value"),
    (GOOD, "sample", "missing"),
    (GOOD + "kpp = { uniform = [0, 1] }", "kpp", "name"),
    (GOOD + "kp = 0.1", "kp", "value"),
    (GOOD + "kp = { uniform = [0, 1], choice = [1] }", "kp", "value"),
    (GOOD + "kp = { unifrm = [0, 1] }", "kp", "name"),
    (GOOD + "kp = { gamma = [2, 3] }", "kp", "name"),
    (GOOD + "kp = { uniform = [1] }", "kp", "value"),
    (GOOD + "kp = { uniform = [false, true] }", "kp", "value"),
    (GOOD + "kp = { triangular = [1, 2] }", "kp", "value"),
    (GOOD + "kp = { truncnorm = [1, 2] }", "kp", "value"),
    (GOOD + "kp = { loguniform = [0, 1] }", "kp", "value"),
    (GOOD + "kp = { truncnorm = [1, 0, 0, 2] }", "kp", "value"),
    (GOOD + "kp = { choice = [] }", "kp", "value"),
    (GOOD + "kp = { choice = [1, 2, 1.0] }", "kp", "duplicate"),
    (GOOD + "action = { choice = ['cooling', 'warming'] }", "action", "choice"),
    (GOOD + "sample_time = { choice = [5, 7.5] }", "sample_time", "value"),
    (GOOD + "sample_time = { uniform = [5, 30] }", "sample_time", "value"),
    (GOOD + "action = { uniform = [0, 1] }", "action", "value"),
    ("method = 'random'\nsize = 4.0\n" + KP, "size", "type"),
    (GOOD + "kp = { uniform = [0, 1" + 400 * "0" + "] }", "kp", "value"),
    (GOOD + "kp = { uniform = [1, 1] }", "kp", "value"),
    (GOOD + "kp = { truncnorm = [1, 1, 2, 2] }", "kp", "value"),
    (GOOD + "kp = { triangular = [0, 3, 2] }", "kp", "value"),
    (GOOD + "kp = { triangular = [2, 2, 2] }", "kp", "value"),
    (GOOD + "backlash = { uniform = [0.91, 0.95] }", "backlash", "value"),
    (GOOD + "kp = { lognormal = [0.02, -0.4] }", "kp", "value"),
    (GOOD + "kp = { normal = [0.02, 0.4, 1, 0] }", "kp", "value"),
    (GOOD + "kp = { normal = [0.02] }", "kp", "value"),
    (GOOD + "backlash = { normal = [5, 1] }", "backlash", "value"),
    (GOOD + "kp = { beta = [2, 0, 0, 1] }", "kp", "value"),
    (GOOD + "kp = { csv = 'gaps.csv' }", "kp", "value"),
    (GOOD + "kp = { csv = 'none.csv', column = 'gap' }", "TMP/none.csv", "path"),
    (GOOD + "kp = { csv = 'gaps.csv', column = 'gpa' }", "kp", "name"),
    (GOOD + "kp = { csv = 'gaps.csv', column = 'gap' }", "kp", "value"),
    (GOOD + "kp = { csv = 'gaps.csv', column = 'angle' }", "kp", "unit"),
    (GOOD + "backlash = { csv = 'gaps.csv', column = 'wide' }", "backlash", "value"),
    (GOOD + "action = { csv = 'gaps.csv', column = 'gap' }", "action", "value"),
    (GOOD + "kp = { csv = 'empty.csv', column = 'gap' }", "TMP/empty.csv", "data"),
    (GOOD + KP + "correlation = 0.5", "correlation", "type"),
    (GOOD + KP + TI + "correlation = [['kp', 'tii', 0.5]]", "correlation", "name"),
    (GOOD + KP + TI + "correlation = [['kp', 'ti', 1.2]]", "correlation", "value"),
    (GOOD + KP + "correlation = [['kp', 'kp', 0.5]]", "correlation", "duplicate"),
    (
        GOOD + KP + "action = { choice = ['cooling'] }\ncorrelation = [['kp', 'action', 0.5]]",
        "correlation",
        "unsupported",
    ),
    ("method = 'saltelli'\nsize = 4\n" + KP + TI + "correlation = [['kp', 'ti', 0.5]]", "correlation", "conflict"),
    (
        GOOD
        + KP
        + TI
        + "C_w = { normal = [9, 1] }\ncorrelation = [['kp','ti',0.9], ['ti','C_w',0.9], ['C_w','kp',-0.9]]",
        "correlation",
        "conflict",
    ),
    (GOOD + "authority = { uniform = [0.2, 0.8] }", "rangeability", "missing"),
]


@pytest.mark.parametrize(("text", "field", "code"), MISTAKES)
def test_a_mistake_gets_one_sentence_with_field_value_and_cure(read, tmp_path, text, field, code):
    (tmp_path / "gaps.csv").write_text("gap,angle [deg],wide\n0.02,1,3\nNaN,2,4\n0.05,3,0.1\n")
    (tmp_path / "empty.csv").write_text("")
    assert_refused(field.replace("TMP", str(tmp_path)), code, read, text)


@pytest.mark.parametrize(
    ("before", "field", "code"),
    [
        ("[loop]\nkp = 0.1", "kp", "duplicate"),
        ("[loop]\n[sweep]\nkp = [0.1]", "kp", "duplicate"),
        ("[loop]\n[cases.tuning]\na = { kp = 0.1 }", "kp", "duplicate"),
        ("[loop]\n[cases.sample]\na = { ti = 9 }", "sample", "name"),
    ],
)
def test_a_mistake_between_tables_gets_one_sentence(read, before, field, code):
    assert_refused(field, code, read, GOOD + KP, before)


# Files that it names: their content is part of the study, and of its folder

OF_FILES = """
[loop]
preset = "lbnl"
[sample]
method = "sobol"
size = 4
backlash = { csv = "measured/gaps.csv", column = "gap" }
kp = { csv = "pi.csv", column = "kp" }
[boundary]
kind = "constant_day"
hours = 0.5
[run]
warm_up = 60
"""


@pytest.fixture
def path(tmp_path):
    home = tmp_path / "home"
    (home / "measured").mkdir(parents=True)
    (home / "measured/gaps.csv").write_text("gap [%]\n2\n5\n7\n")
    (home / "pi.csv").write_text("kp\n0.01\n0.03\n")
    (home / "study.toml").write_text(OF_FILES)
    return home / "study.toml"


@pytest.mark.parametrize("name", ["measured/gaps.csv", "pi.csv"])
def test_the_content_of_a_file_is_part_of_the_hash(path, name):
    before, file = read_study(path).sha256, path.parent / name
    assert read_study(path).sha256 == before
    file.write_text(file.read_text().replace("7", "8").replace("0.03", "0.04"))
    assert read_study(path).sha256 != before


@pytest.mark.kernel
def test_a_study_is_not_resumed_with_other_measurements(path, tmp_path):
    out, gaps = tmp_path / "out", path.parent / "measured/gaps.csv"
    fc.run_study(path, out, n_jobs=1)
    gaps.write_text("gap [%]\n2\n5\n8\n")
    with pytest.raises(fc.IntegrityError, match="a file that the study reads changed"):
        fc.run_study(path, out, n_jobs=1)
