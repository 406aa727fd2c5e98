"""The exported controllers are the kernel's: C, Python and Structured Text give its numbers, a broken law does not."""

import re
import subprocess
import sys
from functools import cache

import pytest
from helpers import exported
from helpers.full import full_except
from helpers.structured_text import Project

import fastcoil as fc
from fastcoil.deliver.export.export import SUFFIXES
from fastcoil.deliver.export.words import IEC_KEYWORDS

pytestmark = pytest.mark.kernel

VARIANTS = {
    "learning_early_trip": 1.0, "learning_growth": 1.5, "learning_shrink": 0.5, "learning_min_switches": 2.0,
    "learning_max_reference": 0.5, "learning_reference": 2.0, "learning_error_ratio": 1.2, "estimate_share": 0.8,
}  # fmt: skip
LOOPS = {
    "inverse": {"backlash_estimate": 0.05},
    "variants": {"learning_step": 0.01, "learning_interval": 600.0, "noise_std": 0.05, "sample_time": 10.0, **VARIANTS},
    "hagglund": {"estimator": "hagglund", "plant_gain": 15.0, "hagglund_least_half_periods": 5.0},
    "gradient": {"estimator": "gradient", "sample_time": 5.0, "noise_std": 0.05},
    "identify": {"estimator": "identify"},
    "additive": {"compensation": "additive", "backlash_estimate": 0.07, "buffer_ratio": 3.0, "noise_std": 0.1},
    "heating": {
        "preset": "heating",
        "backlash_estimate": 0.04,
        "estimate_share": 0.8,
        "error_dead_band": 0.2,
        "buffer": 0.01,
    },
}
MORE_LOOPS = {
    "learner": {"learning_step": 0.01, "learning_interval": 600.0},
    "pi": {"preset": "g36"},
    "smooth": {"preset": "lbnl", "compensation": "smooth", "backlash_estimate": 0.07},
    "measured": {
        "preset": "paper_like_fast", "backlash_estimate": 0.07, "noise_std": 0.1, "buffer_ratio": 3.0,
        "buffer_noise": "measured", "buffer_swing": 0.5, "plant_gain": 15.0,
    },
    "stops": {
        "learning_step": 0.02, "learning_interval": 600.0, "learning_stop": "first_step_down", "learning_final": 0.9,
        "sample_time": 5.0, "noise_std": 0.1, "sensor_resolution": 0.1,
    },
    "reports": {"estimator": "hagglund", "plant_gain": 15.0, "estimate_share": 0.0, "preset": "lbnl"},
    "identify_fast": {"estimator": "identify", "preset": "lbnl", "sample_time": 5.0, "error_dead_band": 0.1},
    "identify_slow": {"estimator": "identify", "sample_time": 60.0, "identify_stroke_time": 0.0},
    "heating_learner": {"preset": "heating_45", "learning_step": 0.01, "compensation": "additive"},
    "heating_gradient": {"preset": "heating", "estimator": "gradient"},
    "backwards": {"kp": -0.01, "ti": 60.0, "backlash_estimate": 0.05, "sample_time": 7.0},
}  # fmt: skip
ALL_LOOPS = LOOPS | MORE_LOOPS
EACH_LOOP = full_except(ALL_LOOPS, LOOPS)


def loop_of(name):
    values = dict(ALL_LOOPS[name])
    return fc.Loop.preset(values.pop("preset", "paper_like")).assign(**values)


@pytest.fixture(scope="module")
def export_files(tmp_path_factory):
    """(name, language) → the files of that export, made once."""

    @cache
    def files(name, language):
        path = tmp_path_factory.mktemp(f"{name}_{language}") / f"valve{SUFFIXES[language]}"
        return fc.export_controller(loop_of(name), path, language)

    return files


@pytest.mark.parametrize("name", EACH_LOOP)
@pytest.mark.parametrize("language", exported.WORST_DIFFERENCE)
def test_every_language_gives_the_kernels_numbers(export_files, name, language):
    """C compiled without a warning; Structured Text by an interpreter of ours, with the program that checks it."""
    exported.skip_without_compiler(language)
    files = export_files(name, language)
    # exp and log of the C library may differ from the kernel's in the last digit
    assert exported.WORST_DIFFERENCE[language](*files) <= (1e-12 if "identify" in name or name == "smooth" else 0.0)
    text = files[0].read_text()
    assert text.isascii()
    assert max(map(len, text.splitlines())) <= 120 or name == "variants"
    assert not re.search(r"[ \t]$|\n\n\n\n", text, re.MULTILINE)
    if language == "python":
        assert exported.load_module(files[0]).check(files[1])


@pytest.mark.parametrize("name", EACH_LOOP)
def test_structured_text_keeps_clear_of_the_standards_own_names_and_its_loops_are_bounded(export_files, name):
    code = re.sub(r"\(\*.*?\*\)", "", export_files(name, "st")[0].read_text(), flags=re.DOTALL)
    lists = re.findall(r"^[ \t]*([\w, \n]+) :(?!=)", code, re.MULTILINE)
    variable_names = {name.strip() for names in lists for name in names.split(",")}
    assert len(variable_names) > 20
    assert not {name.casefold() for name in variable_names} & IEC_KEYWORDS
    assert not any("__" in name or name.endswith("_") for name in variable_names)
    # some compilers skip a loop of one pass, and a cycle must end in time
    loops = re.findall(r"FOR \w+ := (\S+) TO ([^\n]+?)(?: BY -1)? DO", code)
    assert bool(loops) == ("identify" in name)
    assert all(re.fullmatch(r"\d+|[A-Z][A-Z_0-9]*( - 1)?", bound) for pair in loops for bound in pair)


@pytest.mark.parametrize("name", EACH_LOOP)
def test_the_vectors_go_through_all_that_a_controller_does(export_files, name):
    rows = exported.read_vectors(export_files(name, "python")[1])
    pairs = [(a, b) for a, b in zip(rows, rows[1:], strict=False) if not b["reset"]]
    assert sum(row["reset"] for row in rows) >= 2.0
    assert sum(a["rising"] != b["rising"] for a, b in pairs) > 20
    assert sum(a["T_set"] != b["T_set"] for a, b in pairs) >= 2
    assert sum(a["enabled"] > b["enabled"] for a, b in pairs) >= 2
    assert all(row["u"] == row["integral_part"] == 0.0 for row in rows if not row["enabled"])
    assert {0.0, 1.0} <= {row["u"] for row in rows}
    assert sum(a["command"] == b["command"] and a["T_sup"] != b["T_sup"] for a, b in pairs) > 0 or name == "smooth"
    if "estimate" in rows[0]:
        steps = [b["estimate"] - a["estimate"] for a, b in pairs]
        assert max(steps) > 0.0 or name == "identify_slow"
        assert min(steps) < 0.0 or name not in ("learner", "variants", "gradient", "identify", "stops")


def break_law(text, law, broken_law):
    """Replace a law in exported Python; … stands for the rest of a name, the same in both."""
    broken, n = re.subn(re.escape(law).replace("…", r"(\w*)"), broken_law.replace("…", r"\1"), text)
    assert n, law
    return broken


BREAKS = [
    # limits
    ("inverse", "-50.0", "-51.0"),
    ("inverse", "150.0", "149.0"),
    ("inverse", "T_sup > LOWEST_READING", "T_sup >= LOWEST_READING"),
    ("inverse", "T_sup < HIGHEST_READING", "T_sup <= HIGHEST_READING"),
    ("inverse", "T_sup > LOWEST_READING", "not (T_sup <= LOWEST_READING)",
     "T_sup < HIGHEST_READING", "not (T_sup >= HIGHEST_READING)"),
    ("inverse", "T_set > LOWEST_READING", "not (T_set <= LOWEST_READING)",
     "T_set < HIGHEST_READING", "not (T_set >= HIGHEST_READING)"),
    ("inverse", "good_T_sup and good_T_set", "good_T_sup"),
    ("inverse", "good_T_sup and good_T_set", "good_T_set"),
    ("inverse", "x > 1.0", "x > 1.5"),
    ("inverse", "clipped(s.integral_part + KP", "(s.integral_part + KP"),
    ("additive", "clipped(s.u_ext + 0.5 *", "(s.u_ext + 0.5 *"),
    # sign
    ("inverse", "s.e = T_sup - T_set", "s.e = T_set - T_sup"),
    ("additive", "s.u_ext - 0.5 * BACKLASH_ESTIMATE", "s.u_ext + 0.5 * BACKLASH_ESTIMATE"),
    ("inverse", "s.rising = True", "s.rising = False"),
    ("smooth", "s.u_before - s.u", "s.u - s.u_before"),
    # integral
    ("inverse", "s.integral_part + KP * SAMPLE_TIME", "s.integral_part - KP * SAMPLE_TIME"),
    ("inverse", "SAMPLE_TIME / TI", "1.0 / TI"),
    ("inverse", "s.integral_part = 0.0", "s.integral_part = s.integral_part"),
    ("heating", "abs(s.e) > ERROR_DEAD_BAND", "abs(s.e) >= 0.0"),
    # start
    ("inverse", "s.u - KP * s.e", "s.u"),
    ("inverse", "clipped(start_command)", "0.0"),
    ("smooth", "start_command > 0.0", "start_command >= 0.0"),
    ("inverse", "starts and start_command > 0.0", "start_command > 0.0"),
    ("inverse", "reset or ", ""),
    ("inverse", " or not s.running", ""),
    ("additive", "start_command + 0.5 *", "start_command - 0.5 *"),
    # order, off and compensation
    ("inverse", "KP * s.e + s.integral_part", "KP * s.e + s.integral_part - KP * SAMPLE_TIME / TI * s.e"),
    ("gradient", "s.clock > 0.0", "s.clock >= 0.0"),
    ("variants", "(good_T_sup and good_T_set) or s.clock > 0.0", "good_T_sup and good_T_set"),
    ("inverse", "not enabled", "enabled"),
    ("inverse", "s.u_ext + BACKLASH_ESTIMATE", "s.u_ext + 0.9 * BACKLASH_ESTIMATE"),
    ("inverse", "s.u < s.u_ext - BUFFER", "s.u < s.u_ext - 0.001"),
    ("additive", "BUFFER_RATIO * abs(KP)", "0.3 * BUFFER_RATIO * abs(KP)"),
    # estimators
    ("learner", "… < LEARNING_FLOOR", "… >= LEARNING_FLOOR"),
    ("learner", "= s.estimate - …", "= s.estimate + 0.0 * …"),
    ("learner", "s.clock >= s.next_update", "s.clock > s.next_update"),
    ("variants", "… * LEARNING_SHRINK", "…"),
    ("variants", "chatter or ", "chatter or False and "),
    ("variants", "ESTIMATE_SHARE * s.estimate", "s.estimate"),
    ("hagglund", "KP * PLANT_GAIN * s.duration - TI", "KP * PLANT_GAIN * s.duration"),
    ("hagglund", "low < high", "low > high"),
    ("gradient", "/ (1.0 + zeta * zeta)", "/ 1.0"),
    ("gradient", "… + GRADIENT_DEAD_ZONE", "…"),
    ("gradient", "s.clock + GRADIENT_PAUSE", "s.clock"),
    ("identify", "s.clock + COUNTS_AFTER_STEP…", "s.clock + 600.0 + 0.0 * COUNTS_AFTER_STEP…"),
    ("identify", "s.decay * rows_2 + 1.0", "rows_2 + 1.0"),
    ("identify", " <= GOOD…", " <= 0.2 + 0.0 * GOOD…"),
    ("identify", "band = 0.0", "band = BUFFER"),
    ("identify", "interrupted or not s.T_known", "not s.T_known"),
    ("identify", "= s.clock + PAUSE_AFTER_GUST…", "= s.clock + 0.0 * PAUSE_AFTER_GUST…"),
    ("identify", "= 1.0 / ", "= 1.001 / "),
]  # fmt: skip


@pytest.mark.parametrize("broken", BREAKS)
def test_a_law_that_is_broken_anywhere_is_found_by_the_vectors(export_files, broken):
    """Each break in the Python that was exported: the other languages have the same statements."""
    name, *pairs = broken
    code, stored = export_files(name, "python")
    text = code.read_text()
    for law, broken_law in zip(pairs[::2], pairs[1::2], strict=True):
        text = break_law(text, law, broken_law)
    assert exported.has_differences(exported.python_runner(text), stored)


def test_the_check_in_c_finds_a_broken_law_and_missing_vectors(export_files, tmp_path):
    exported.skip_without_compiler("c")
    code, stored = export_files("inverse", "c")
    (tmp_path / "valve.c").write_text(code.read_text().replace("s->u > s->u_ext)", "s->u > s->u_ext + 0.1)"))
    command = ["gcc", *exported.COMPILER_FLAGS, "-DFASTCOIL_CHECK", "valve.c", "-lm", "-o", "broken"]
    subprocess.run(command, cwd=tmp_path, check=True)
    for arguments in ([stored], ["missing.csv"], []):
        command = [tmp_path / "broken", *arguments]
        assert subprocess.run(command, cwd=tmp_path, check=False, capture_output=True).returncode == 1, arguments


def test_the_check_in_structured_text_finds_a_broken_law(export_files):
    code, _, program = export_files("inverse", "st")
    broken = code.read_text().replace("u > u_ext ", "u > u_ext + 0.1 ")
    check = Project(broken, program.read_text()).block("valve_check")
    check()
    assert not check.same


UNDAMAGED = {"whole": str, "other line ends": lambda text: text.replace("\n", "\r\n")}
DAMAGES = {
    "cut at a line": lambda text: text[: text.rindex("\n", 0, -1) + 1],
    "cut in a line": lambda text: text[:-9],
    "a row twice": lambda text: text + text.splitlines(keepends=True)[-1],
    "a digit": lambda text: re.sub(r"\.(\d)", lambda found: f".{9 - int(found[1])}", text, count=3),
    "rows in another order": lambda text: "".join([*text.splitlines(True)[:-2], *text.splitlines(True)[:-3:-1]]),
    "no rows": lambda text: text[: text.index("T_sup,")],
    "nothing": lambda text: "",
}


@pytest.mark.parametrize("language", ["python", "c"])
def test_vectors_that_were_cut_or_edited_are_reported(export_files, tmp_path, language):
    """Line ends of another system are no edit."""
    exported.skip_without_compiler(language)
    code, stored = export_files("inverse", language)
    program = [sys.executable, code]
    if language == "c":
        program = [tmp_path / "check"]
        subprocess.run(["gcc", *exported.COMPILER_FLAGS, "-DFASTCOIL_CHECK", code, "-lm", "-o", *program], check=True)
    text = stored.read_text()
    damaged_file = tmp_path / "other.csv"
    for name, damage in [*UNDAMAGED.items(), *DAMAGES.items()]:
        damaged_file.write_bytes(damage(text).encode())
        process = subprocess.run([*program, damaged_file], check=False, capture_output=True, text=True, timeout=60)
        output = process.stdout + process.stderr
        assert process.returncode == (name in DAMAGES), name
        assert ("was cut or edited, or is of another export" in output) == (name in DAMAGES), (name, output)
        assert "Traceback" not in output
