"""``[loop] include`` and ``fastcoil fit``: from a CSV file to a study, on the command line."""

import csv
import tomllib

import numpy as np
import pytest
from click.testing import CliRunner
from helpers.refusals import assert_refused

import fastcoil as fc
from fastcoil.cli.main import main
from fastcoil.study.file.spec import read_study

VALVE = "[loop]\nbacklash = 0.1\nm_max = 1.5\n[fit]\nkind = 'valve'\n[fit.rmse]\nfit = nan\n"
COIL = "[loop]\nC_w = 9.0\nbeta6 = -0.4\n"
STUDY = '[loop]\npreset = "lbnl"\ninclude = ["valve.toml", "coil.toml"]\n'


@pytest.fixture
def read(tmp_path):
    def read(study=STUDY, valve=VALVE, coil=COIL):
        (tmp_path / "valve.toml").write_text(valve)
        (tmp_path / "coil.toml").write_text(coil)
        (tmp_path / "study.toml").write_text(study)
        return read_study(tmp_path / "study.toml")

    return read


def test_included_parameters_come_between_preset_and_constants_and_may_be_swept(read):
    loop = read(STUDY + "m_max = 1.4\n").plan.layout.loop
    assert loop["C_c"] == 10.0  # the preset's
    assert (loop["backlash"], loop["C_w"], loop["beta6"], loop["m_max"]) == (0.1, 9.0, -0.4, 1.4)
    loop = read(STUDY + "[sweep]\nbacklash = [0.0, 0.1, 0.2]\n").plan.layout.loop
    assert (loop.sizes, loop["m_max"]) == ({"backlash": 3}, 1.5)


def test_the_hash_is_also_of_what_is_included(read):
    sha256 = read().sha256
    assert read(valve=VALVE.replace("0.1", "0.11")).sha256 != sha256
    assert read(valve=VALVE.replace("nan", "0.3")).sha256 == sha256, "the hash ignores [fit]"


@pytest.mark.parametrize(
    ("study", "valve", "field", "code"),
    [
        ("[loop]\ninclude = 'valve.toml'\n", VALVE, "include", "value"),
        ('[loop]\ninclude = ["no.toml"]\n', VALVE, "TMP/no.toml", "path"),
        (STUDY, "[loop", "valve.toml", "format"),
        (STUDY, "backlash = 0.1", "valve.toml", "format"),
        (STUDY, "[loop]\nbacklsh = 0.1", "backlsh", "name"),
        (STUDY, "[loop]\nbacklash = 1.1", "backlash", "value"),
        (STUDY, "[loop]\nC_w = 9.0", "C_w", "duplicate"),
        (VALVE, VALVE, "fit", "name"),
    ],
)
def test_a_mistake_gets_one_sentence(read, tmp_path, study, valve, field, code):
    assert_refused(field.replace("TMP", str(tmp_path)), code, read, study, valve)


# ------------------------------------------------------------------------------------------------ the command line


@pytest.fixture
def fastcoil(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return lambda *words: CliRunner().invoke(main, words)


def write_csv(path, header, columns):
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *zip(*columns, strict=True)])


@pytest.fixture
def logs(tmp_path):
    """Two CSV files of one AHU with its own units: valve.csv and coil.csv."""
    rng, n = np.random.default_rng(1), 2 * 3600
    day = fc.paper_day(hours=2, seed=1)
    command = np.clip(np.repeat(np.cumsum(rng.normal(0.0, 0.15, n // 120)) % 1.0, 120), 0.05, 0.95)
    ds = fc.simulate(
        fc.Loop(backlash=0.1, C_w=10.0, converged=True), day, command=command, traces=["m_w", "T_sup"], warm_up=0
    )
    flow, series = ds["m_w"].values, {name: values[0] for name, values in day.series.items()}
    every = slice(None, None, 60)
    t = np.arange(n)[every] / 60.0
    m_w = np.abs(flow[every] + rng.normal(0.0, 0.01, t.size))
    write_csv(
        tmp_path / "valve.csv", ["elapsed_time [min]", "command [%]", "m_w [kg/s]"], [t, 100 * command[every], m_w]
    )
    ten = slice(None, None, 10)
    T_sup = ds["T_sup"].values[ten] + rng.normal(0.0, 0.03, n // 10)
    write_csv(
        tmp_path / "coil.csv",
        ["seconds", "m_w [kg/s]", "m_a [kg/s]", "T_w_in [degC]", "T_a_in [degC]", "W_a_in [1]", "SAT"],
        [np.arange(n)[ten], flow[ten], *(series[name][ten] for name in ("m_a", "T_w_in", "T_a_in", "W_a_in")), T_sup],
    )
    return tmp_path


COIL_OPTIONS = [
    *("--column", "elapsed_time=seconds", "--column", "m_w=m_w", "--column", "m_a=m_a", "--column", "T_sup=SAT"),
    *("--unit", "elapsed_time=s", "--unit", "T_sup=degC", "--hold", "m_w"),
]


@pytest.mark.kernel
def test_two_files_to_a_study_of_that_ahu(fastcoil, logs):
    for name, options in (("valve", []), ("coil", COIL_OPTIONS)):
        fit = fastcoil("fit", name, f"{name}.csv", "-o", f"{name}.toml", *options)
        assert fit.exit_code == 0, fit.output
        assert name == "coil" or "backlash = 0." in fit.output
    assert tomllib.loads((logs / "valve.toml").read_text())["loop"]["backlash"] == pytest.approx(0.1, abs=0.005)
    for name in ("valve", "coil"):
        assert (logs / f"{name}.png").stat().st_size > 10_000
        assert tomllib.loads((logs / f"{name}.toml").read_text())["fit"]["kind"] == name
    (logs / "mine.toml").write_text(
        '[loop]\ninclude = ["valve.toml", "coil.toml"]\n[sweep]\nestimate_ratio = [0.0, 1.0]\n[boundary]\nhours = 1\n'
    )
    run = fastcoil("run", "mine.toml", "--no-figures")
    assert run.exit_code == 0, run.output
    second_run = fastcoil("run", "mine.toml", "--no-figures")
    assert "nothing to do" in second_run.output
    text = (logs / "coil.toml").read_text()
    (logs / "coil.toml").write_text(text.replace("\nbeta2 = -0.", "\nbeta2 = -0.9", 1))
    changed = fastcoil("run", "mine.toml", "--no-figures")
    assert changed.exit_code == 6
    assert "a file that the study reads changed" in changed.output


@pytest.mark.kernel
def test_a_fit_replaces_an_earlier_one_but_nothing_else(fastcoil, logs):
    """And a second log validates it."""
    (logs / "ahu.toml").write_text('[loop]\npreset = "lbnl"\n')
    (logs / "mine.png").write_text("a photo")
    (logs / "folder.png").mkdir()
    for name, sentence in (
        ("ahu", "-o ahu.toml: this file exists and is not a fit"),
        ("mine", "mine.png exists and would be replaced"),
        ("folder", "folder.png exists and would be replaced"),
    ):
        fit = fastcoil("fit", "valve", "valve.csv", "-o", f"{name}.toml")
        assert fit.exit_code == 2, fit.output
        assert sentence in fit.output
    assert (logs / "ahu.toml").read_text() == '[loop]\npreset = "lbnl"\n'
    assert (logs / "mine.png").read_text() == "a photo"
    assert not list(logs.glob("[fm]*.toml"))
    assert fastcoil("fit", "valve", "valve.csv", "-o", "valve.toml", "--split", "1").exit_code == 0
    before = (logs / "valve.toml").read_text()
    fit = fastcoil("fit", "valve", "valve.csv", "-o", "valve.toml")
    assert fit.exit_code == 0, fit.output
    assert "RMSE, validation: " in fit.output
    assert "nothing was held back" in before
    assert "nothing was held back" not in (logs / "valve.toml").read_text()
