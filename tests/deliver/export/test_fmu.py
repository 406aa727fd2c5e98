"""The exported FMU, driven by FMPy: valid, the kernel's numbers, its clock inside communication steps, its refusals."""

import runpy
import shutil
import subprocess
import warnings
import zipfile
from pathlib import Path

import pytest
from helpers import rules
from helpers.commands import assert_command_refused, fastcoil
from helpers.exported import COMPILER_FLAGS, has_differences, read_vectors
from helpers.full import full_except
from helpers.sentences import assert_worded
from test_same_controller import LOOPS, loop_of

import fastcoil as fc

pytestmark = [pytest.mark.kernel, pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler: cc")]
fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed: pip install --group test")
from fmpy.fmi1 import FMICallException  # noqa: E402
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE  # noqa: E402
from fmpy.validation import validate_fmu  # noqa: E402

ROOT = Path(__file__).parents[3]
SAMPLE_TIME = 15.0
PLAIN = {"backlash_estimate": 0.05, "sample_time": SAMPLE_TIME}


def unpack(path):
    """The folder with what is in an FMU."""
    folder = path.with_suffix("")
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    return folder


class Slave:
    """An instance, begun at ``start``, with variables by name."""

    def __init__(self, folder, start=0.0, guid=None, **values):
        description = fmpy.read_model_description(str(folder))
        self.variables = {variable.name: variable for variable in description.modelVariables}
        self.messages = []
        names = {"instanceName": "one", "modelIdentifier": description.coSimulation.modelIdentifier}
        self.fmu = FMU2Slave(guid=guid or description.guid, unzipDirectory=str(folder), **names)
        self.callbacks = callbacks = fmi2CallbackFunctions()  # FMPy does not keep them
        callbacks.logger = fmi2CallbackLoggerTYPE(lambda *arguments: self.messages.append(arguments[-1].decode()))
        self.fmu.instantiate(callbacks=callbacks)
        self.fmu.setupExperiment(startTime=start)
        self.fmu.enterInitializationMode()
        self.put(**values)
        self.fmu.exitInitializationMode()

    def put(self, **values):
        for name, value in values.items():
            variable = self.variables[name]
            (self.fmu.setReal if variable.type == "Real" else self.fmu.setBoolean)([variable.valueReference], [value])

    def __getattr__(self, name):
        variable = self.variables[name]
        return (self.fmu.getReal if variable.type == "Real" else self.fmu.getBoolean)([variable.valueReference])[0]

    def step(self, time, h, **values):
        self.put(**values)
        self.fmu.doStep(time, h)
        return self


def runner(folder):
    """Takes an instance through one cycle."""
    slave, times = Slave(folder), iter(range(10**6))
    step = float(slave.sample_time)
    inputs = [name for name, variable in slave.variables.items() if variable.causality == "input"]
    return lambda row: slave.step(next(times) * step, step, **{name: row[name] for name in inputs})


@pytest.fixture(scope="module")
def export_files(tmp_path_factory):
    """The FMU of a loop of ``test_same_controller`` and its vectors, made once."""
    files_by_name = {}

    def files(name, test=None):
        if name not in files_by_name:
            loop = fc.Loop(**PLAIN) if name == "plain" else loop_of(name)
            path = tmp_path_factory.mktemp(name) / "valve.fmu"
            files_by_name[name] = fc.export_controller(loop, path, "fmu", test=test)
        return files_by_name[name]

    return files


@pytest.fixture(scope="module")
def plain_folder(export_files):
    """Folder of the FMU of a PI with an inverse."""
    return unpack(export_files("plain")[0])


@pytest.mark.parametrize(
    ("name", "test"),
    full_except(
        [("identify", fc.ValveTest()), *((name, None) for name in LOOPS if name != "identify")],
        [("identify", fc.ValveTest()), ("heating", None)],
    ),
)
def test_it_is_valid_and_gives_the_kernels_numbers(export_files, name, test):
    """Every vector, through FMPy."""
    path, stored = export_files(name, test)
    assert validate_fmu(str(path)) == []
    variables = fmpy.read_model_description(str(path)).modelVariables
    inputs, outputs = ({v.name for v in variables if v.causality == side} for side in ("input", "output"))
    assert inputs | outputs == read_vectors(stored)[0].keys()
    assert {"T_sup", "T_set", "enabled", "reset", "start_command"} <= inputs
    assert ("start_test" in inputs) == ("test_aborted" in outputs) == (test is not None)
    assert not has_differences(runner(unpack(path)), stored)


def test_a_broken_law_is_found_and_the_sources_compile_without_a_warning(export_files, tmp_path):
    path, stored = export_files("inverse")
    shutil.copy(path, tmp_path / "broken.fmu")
    folder = unpack(tmp_path / "broken.fmu")
    binary = folder / "binaries" / "linux64" / "valve.so"
    flags = [*COMPILER_FLAGS, "-Wno-unused-parameter", "-fPIC", "-shared"]
    laws = folder / "sources" / "controller.c"
    for text in (laws.read_text(), laws.read_text().replace("s->u > s->u_ext)", "s->u > s->u_ext + 0.1)")):
        laws.write_text(text)
        subprocess.run(["cc", *flags, folder / "sources" / "fmi2.c", "-lm", "-o", binary], check=True)
        symbols = subprocess.run(["nm", "-D", "--defined-only", binary], check=False, capture_output=True, text=True)
        assert "fmi2DoStep" in symbols.stdout or symbols.returncode
        if "0.1)" not in text:
            assert not has_differences(runner(folder), stored)
            binary.rename(binary.with_suffix(".whole"))  # a library is loaded once
    shutil.copytree(folder, tmp_path / "other")
    assert has_differences(runner(tmp_path / "other"), stored)


def slave_after(folder, seconds, h, start=0.0):
    """The slave after some seconds of a temperature that is too high and falls each 60 s."""
    slave = Slave(folder, start, start_command=0.3)
    for k in range(round(seconds / h)):
        slave.step(start + k * h, h, T_sup=16.0 - (k * h // 60.0), T_set=14.0)
    return slave


def test_it_acts_at_multiples_of_its_sample_time_whatever_the_communication_step_is(plain_folder):
    expected = slave_after(plain_folder, 420.0, SAMPLE_TIME)
    assert expected.integral_part != 0.3
    for h in (0.1, 1.0, 5.0, 30.0, 60.0):
        for start in (0.0, 1e6):
            slave = slave_after(plain_folder, 420.0, h, start)
            assert (slave.command, slave.integral_part) == (expected.command, expected.integral_part), h
    # 280 s hold the cycles of 0, 15 … 270 s, and 285 s no other
    for h in (7.0, 28.0):
        assert slave_after(plain_folder, 280.0, h).u != slave_after(plain_folder, 266.0, 7.0).u
    at_280_s, at_285_s, at_286_s = (slave_after(plain_folder, seconds, 1.0).u for seconds in (280.0, 285.0, 286.0))
    assert at_280_s == at_285_s != at_286_s


def test_the_first_output_is_the_command_to_start_from_and_the_loop_goes_on_from_there(plain_folder):
    slave = Slave(plain_folder, start_command=0.4)
    assert slave.command == 0.4
    assert slave.step(0.0, 1.0, T_sup=14.0, T_set=14.0).command == pytest.approx(0.4, abs=1e-12)


def test_steps_that_go_backwards_or_leave_time_out_are_errors(plain_folder):
    slave = Slave(plain_folder).step(0.0, 60.0)
    for time, h in ((0.0, 60.0), (45.0, 15.0), (60.0, -15.0), (75.0, 15.0), (60.0, float("nan"))):
        with pytest.raises(FMICallException) as caught:
            slave.fmu.doStep(time, h)
        assert caught.value.status == 3  # fmi2Error
        assert_worded(slave.messages.pop())
    slave.step(60.0, 15.0)


LATEST = 1e-6 * SAMPLE_TIME / 2.0**-52  # s, where times are rounded to a millionth of a cycle


def assert_refused(slave, call):
    with pytest.raises(FMICallException) as caught:
        call()
    assert caught.value.status == 3
    assert_worded(slave.messages.pop())


def test_a_step_of_absurd_length_is_refused_and_one_of_a_day_is_not(plain_folder):
    slave, in_hours = Slave(plain_folder), Slave(plain_folder)
    for h in (1e18, 1e9, 367 * 86400.0, float("inf")):
        assert_refused(slave, lambda: slave.fmu.doStep(0.0, h))  # noqa: B023
    for hour in range(24):
        in_hours.step(3600.0 * hour, 3600.0, T_sup=16.0)
    assert slave.step(0.0, 86400.0, T_sup=16.0).command == in_hours.command


def test_a_step_is_refused_past_the_stop_time_and_outside_of_a_simulation(plain_folder):
    slave = Slave(plain_folder, start=0.99 * LATEST)
    assert_refused(slave, lambda: slave.fmu.setupExperiment(startTime=0.0))
    slave.step(0.99 * LATEST, 60.0)
    slave.fmu.terminate()
    for call in (lambda: slave.fmu.doStep(0.99 * LATEST + 60.0, 60.0), slave.fmu.exitInitializationMode):
        assert_refused(slave, call)
    slave.fmu.reset()
    for start in (float("nan"), float("inf"), -1e18, 1.01 * LATEST):
        assert_refused(slave, lambda: slave.fmu.setupExperiment(startTime=start))  # noqa: B023
    for stop in (float("nan"), -60.0):
        assert_refused(slave, lambda: slave.fmu.setupExperiment(startTime=0.0, stopTime=stop))  # noqa: B023
    slave.fmu.setupExperiment(startTime=0.0, stopTime=90.0)
    assert_refused(slave, lambda: slave.fmu.doStep(0.0, 60.0))
    slave.fmu.enterInitializationMode()
    slave.fmu.exitInitializationMode()
    slave.step(0.0, 60.0)
    assert_refused(slave, lambda: slave.fmu.doStep(60.0, 60.0))
    slave.step(60.0, 30.0)


def test_a_stored_state_takes_it_back(plain_folder):
    slave = slave_after(plain_folder, 60.0, 15.0)
    before = slave.command
    state = slave.fmu.getFMUstate()
    first = slave.step(60.0, 60.0, T_sup=18.0).command
    assert first != before
    slave.fmu.setFMUstate(state)
    assert slave.command == before
    assert slave.step(60.0, 60.0, T_sup=18.0).command == first
    slave.fmu.freeFMUstate(state)


def test_parameters_are_constants_with_units(plain_folder):
    slave = Slave(plain_folder)
    kp, T_sup = slave.variables["kp"], slave.variables["T_sup"]
    assert (kp.causality, kp.variability, kp.unit, float(kp.start)) == ("local", "constant", "K-1", slave.kp)
    assert (slave.sample_time, slave.backlash_estimate, T_sup.unit) == (SAMPLE_TIME, 0.05, "degC")
    with pytest.raises(FMICallException):
        slave.put(kp=0.1)
    assert_worded(slave.messages.pop())


def test_another_guid_is_refused(plain_folder):
    with pytest.raises(Exception, match="instantiate"):
        Slave(plain_folder, guid="{00000000-0000-0000-0000-000000000000}")


def test_the_same_controller_has_the_same_bytes_and_another_one_another_guid(export_files, tmp_path):
    path, _ = export_files("plain")
    fc.export_controller(fc.Loop(**PLAIN), tmp_path / "valve.fmu", "fmu")
    assert (tmp_path / "valve.fmu").read_bytes() == path.read_bytes()
    fc.export_controller(fc.Loop(**PLAIN, kp=0.017), tmp_path / "valve.fmu", "fmu")
    assert len({fmpy.read_model_description(str(fmu_path)).guid for fmu_path in (path, tmp_path / "valve.fmu")}) == 2


@pytest.mark.parametrize("compiler", [None, "false"])
def test_without_a_compiler_there_are_sources_and_a_sentence_says_so(tmp_path, monkeypatch, compiler):
    monkeypatch.setattr("fastcoil.deliver.export.export.shutil.which", lambda name: compiler)
    with pytest.warns(UserWarning, match="has sources and no binary.*(no C compiler was found|false failed)"):
        fc.export_controller(fc.Loop(**PLAIN), tmp_path / "valve.fmu", "fmu")
    with zipfile.ZipFile(tmp_path / "valve.fmu") as archive:
        assert archive.namelist() == ["modelDescription.xml", "sources/fmi2.c", "sources/controller.c"]
    assert fmpy.supported_platforms(str(tmp_path / "valve.fmu")) == ["c-code"]


def test_the_command_finds_the_form_by_the_suffix_and_refuses_in_a_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop.toml").write_text("[loop]\nbacklash_estimate = 0.05\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = fastcoil("export", "loop.toml", "-o", "2nd floor.fmu")
    assert result.exit_code == 0, result.output
    assert result.output.splitlines()[-2:] == ["Written: 2nd floor.fmu", "Written: 2nd floor_vectors.csv"]
    assert fmpy.read_model_description("2nd floor.fmu").coSimulation.modelIdentifier == "c_2nd_floor"
    endless = "def mine(now, p, memory):\n    while now.e > p.gain:\n        pass\n    return 0.0, memory\n"
    (tmp_path / "mine.py").write_text(rules.RULE_HEADER + endless)
    (tmp_path / "own.toml").write_text('[loop]\nestimator = "mine:mine"\ngain = 0.02\n')
    refused = fastcoil("export", "own.toml", "-o", "own.fmu")
    announcement, sentence = refused.stderr.splitlines()
    assert (refused.exit_code, announcement[:30]) == (2, "This study runs its own code: ")
    assert sentence.startswith("fastcoil: estimator = 'mine' cannot be exported: ")
    assert_worded(sentence.removeprefix("fastcoil: "))
    assert_command_refused("export", "loop.toml", "-o", "x.c", "--language", "fmu")
    assert not [*tmp_path.glob("own.fmu"), *tmp_path.glob("x*")]


def test_the_example_of_the_gallery_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    plain, inverse = runpy.run_path(str(ROOT / "docs" / "gallery" / "16_fmu.py"))["rms"].values()
    assert inverse < 0.1 * plain
    assert "rms with the plain PI" in capsys.readouterr().out
