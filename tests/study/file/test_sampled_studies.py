"""A study with a [sample]: what it means, and every mistake in it."""

import numpy as np
import pytest
from helpers.refusals import problems

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
KNOWN = "known: uniform, loguniform, truncnorm, triangular, normal, lognormal, beta, choice, fit, csv"


def problems_of(read, *text):
    return [p.split("study.toml: ")[1] for p in problems(read, *text)]


MISTAKES = [
    ("size = 4\n" + KP, "[sample] method is missing: give one of latin_hypercube, sobol, random"),
    ("method = 'random'\n" + KP, "[sample] size is missing: give the number of samples"),
    ("method = 'sobl'\nsize = 4\n" + KP, "[sample] method = 'sobl', did you mean 'sobol'?: choose"),
    ("method = 'sobol'\nsize = 1000\n" + KP, "powers of two, such as 512"),
    ("method = 'random'\nsize = 0\n" + KP, "[sample] size = 0: must be at least 1 and at most 10000000"),
    (GOOD + "seed = -1\n" + KP, "[sample] seed = -1: must be at least 0"),
    (GOOD, "[sample] no parameter is given: give at least one, such as backlash"),
    (GOOD + "kpp = { uniform = [0, 1] }", "[sample] kpp is not a parameter, did you mean 'kp'?"),
    (GOOD + "kp = 0.1", "[sample] kp = 0.1: give one distribution, such as { uniform = [lowest, highest] }; known"),
    (GOOD + "kp = { uniform = [0, 1], choice = [1] }", "give one distribution"),
    (GOOD + "kp = { unifrm = [0, 1] }", "kp = { unifrm = [0, 1] }: unknown distribution, did you mean 'uniform'?;"),
    (GOOD + "kp = { gamma = [2, 3] }", "kp = { gamma = [2, 3] }: unknown distribution; " + KNOWN),
    (GOOD + "kp = { uniform = [1] }", "kp = { uniform = [1] }: give [lowest, highest], 2 finite numbers"),
    (GOOD + "kp = { uniform = [false, true] }", "2 finite numbers"),
    (GOOD + "kp = { triangular = [1, 2] }", "give [lowest, most likely, highest], 3 finite numbers"),
    (GOOD + "kp = { truncnorm = [1, 2] }", "give [mean, standard deviation, lowest, highest], 4 finite numbers"),
    (GOOD + "kp = { loguniform = [0, 1] }", "give [lowest, highest] with 0 < lowest < highest"),
    (GOOD + "kp = { truncnorm = [1, 0, 0, 2] }", "with lowest < highest and standard deviation > 0"),
    (GOOD + "kp = { choice = [] }", "kp = { choice = [] }: give a list of at least one value"),
    (GOOD + "kp = { choice = [1, 2, 1.0] }", "kp = { choice = [1, 2, 1.0] }: 1 appears twice, leave one out"),
    (GOOD + "action = { choice = ['cooling', 'warming'] }", "action = 'warming': choose 'cooling' or 'heating'"),
    (GOOD + "sample_time = { choice = [5, 7.5] }", "sample_time = 7.5 s: must be whole"),
    (
        GOOD + "sample_time = { uniform = [5, 30] }",
        "sample_time = { uniform = [5, 30] }: sample_time is a whole number, use { choice = […] }",
    ),
    (GOOD + "action = { uniform = [0, 1] }", "action is a word, use { choice = […] }"),
    ("method = 'random'\nsize = 4.0\n" + KP, "[sample] size = 4.0: give a whole number"),
    (GOOD + "kp = { uniform = [0, 1" + 400 * "0" + "] }", "2 finite numbers"),
    (GOOD + "kp = { uniform = [1, 1] }", "[1, 1] }: give [lowest, highest] with lowest < highest"),
    (GOOD + "kp = { truncnorm = [1, 1, 2, 2] }", "with lowest < highest and standard deviation > 0"),
    (GOOD + "kp = { triangular = [0, 3, 2] }", "with lowest ≤ most likely ≤ highest, lowest < highest"),
    (GOOD + "kp = { triangular = [2, 2, 2] }", "lowest < highest"),
    (GOOD + "backlash = { uniform = [0.91, 0.95] }", "must be from 0 to 0.9 (and 3 more of its values)"),
    (GOOD + "kp = { lognormal = [0.02, -0.4] }", "median > 0, sigma > 0 and 0 ≤ lowest < highest"),
    (GOOD + "kp = { normal = [0.02, 0.4, 1, 0] }", "with lowest < highest and standard deviation > 0"),
    (GOOD + "kp = { normal = [0.02] }", "give [mean, standard deviation] or [mean, standard deviation, lowest, hig"),
    (GOOD + "backlash = { normal = [5, 1] }", "backlash = 5: must be from 0 to 0.9"),
    (GOOD + "kp = { beta = [2, 0, 0, 1] }", "give [a, b, lowest, highest] with a > 0, b > 0 and lowest < highest"),
    (GOOD + "kp = { csv = 'gaps.csv' }", "give a file and the header of a column, such as { csv = "),
    (GOOD + "kp = { csv = 'none.csv', column = 'gap' }", "none.csv does not exist: give a CSV file"),
    (GOOD + "kp = { csv = 'gaps.csv', column = 'gpa' }", "gaps.csv has no column 'gpa', did you mean 'gap'?: give"),
    (GOOD + "kp = { csv = 'gaps.csv', column = 'gap' }", "kp = 'NaN' in row 3: give a number with a decimal point"),
    (GOOD + "kp = { csv = 'gaps.csv', column = 'angle' }", "kp is in 'deg' (known units: K-1, 1/K, %/K, percent/K)"),
    (GOOD + "backlash = { csv = 'gaps.csv', column = 'wide' }", "backlash = 3: must be from 0 to 0.9 (and 1 more of"),
    (GOOD + "action = { csv = 'gaps.csv', column = 'gap' }", "action is a word, use { choice = […] }"),
    (GOOD + "kp = { csv = 'empty.csv', column = 'gap' }", "empty.csv is empty: give a header row"),
    (GOOD + "kp = { fit = 'none.toml' }", "none.toml does not exist: give a file that `fastcoil fit` or"),
    (GOOD + "kp = { fit = 'gaps.csv' }", "gaps.csv is not valid TOML"),
    (GOOD + "kp = { fit = 'valve.toml' }", "valve.toml has no estimate of kp with a 95 % interval: give a file"),
    (GOOD + KP + "correlation = 0.5", "correlation = 0.5: give pairs of parameters and their rank correlation, such"),
    (GOOD + KP + TI + "correlation = [['kp', 'tii', 0.5]]", "correlation of kp and tii: tii is not drawn, did you"),
    (GOOD + KP + TI + "correlation = [['kp', 'ti', 1.2]]", "correlation of kp and ti = 1.2: must be above -1 and"),
    (GOOD + KP + "correlation = [['kp', 'kp', 0.5]]", "correlation of kp: give each pair of two parameters once"),
    (
        GOOD + KP + "action = { choice = ['cooling'] }\ncorrelation = [['kp', 'action', 0.5]]",
        "action is drawn by choice, which has no ranks",
    ),
    (
        "method = 'saltelli'\nsize = 4\n" + KP + TI + "correlation = [['kp', 'ti', 0.5]]",
        "Sobol' indices need independent parameters",
    ),
    (
        GOOD
        + KP
        + TI
        + "C_w = { normal = [9, 1] }\ncorrelation = [['kp','ti',0.9], ['ti','C_w',0.9], ['C_w','kp',-0.9]]",
        "correlation of kp and ti = 0.9, ti and C_w = 0.9, C_w and kp = -0.9: these cannot hold together",
    ),
    (GOOD + "authority = { uniform = [0.2, 0.8] }", "rangeability and m_full missing"),
]


@pytest.mark.parametrize(("text", "sentence"), MISTAKES)
def test_a_mistake_gets_one_sentence_with_field_value_and_cure(read, tmp_path, text, sentence):
    (tmp_path / "gaps.csv").write_text("gap,angle [deg],wide\n0.02,1,3\nNaN,2,4\n0.05,3,0.1\n")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "valve.toml").write_text("[loop]\nkp = 0.02\n")
    (problem,) = problems_of(read, text)
    assert sentence in problem


@pytest.mark.parametrize(
    ("before", "sentence"),
    [
        ("[loop]\nkp = 0.1", "kp appears in [loop] and in [sample]: leave one out"),
        ("[loop]\n[sweep]\nkp = [0.1]", "kp appears in [sweep] and in [sample]: leave one out"),
        ("[loop]\n[cases.tuning]\na = { kp = 0.1 }", "kp appears in [cases.tuning] and in [sample]: leave one out"),
        ("[loop]\n[cases.sample]\na = { ti = 9 }", "[cases.sample] sample is the dimension of [sample]: give"),
    ],
)
def test_a_mistake_between_tables_gets_one_sentence(read, before, sentence):
    (problem,) = problems_of(read, GOOD + KP, before)
    assert sentence in problem
