"""Study files to start from: the template of ``fastcoil init``, and the studies that come with fastcoil."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from fastcoil.base.errors import InputError, StorageError, nearest, shown

TEMPLATE = """\
# A fastcoil study: which loops, on which days.  `fastcoil plan FILE` checks it, `fastcoil run FILE` runs it.
# All openings, commands and backlash are fractions of stroke; °C, kg/s, s.  `fastcoil parameters` lists the names.

title = "Does a backlash inverse help this loop?"
question = "How does the control error depend on the true backlash and on how well it is known?"

[loop]                                  # shared by all loops
preset = "lbnl"                         # `fastcoil presets` lists them
# include = ["valve.toml", "coil.toml"] # your own AHU: files written by `fastcoil fit valve|coil data.csv`
# noise_std = 0.05                      # any parameter may be given here

[sweep]                                 # each on its own axis; all combinations are run
backlash = [0.02, 0.05, 0.07, 0.10, 0.15]
estimate_ratio = { linspace = [0.0, 1.4, 15] }   # or { geomspace = [first, last, count] }

[cases.tuning]                          # named alternatives: one more axis, called tuning
as_found = { kp = 0.018, ti = 30 }
faster = { kp = 0.03, ti = 15 }

# [sample]                              # drawn together: one more axis, called sample
# method = "sobol"                      # latin_hypercube, sobol (size a power of two) or random
# size = 1024
# seed = 0
# sensor_time_constant = { uniform = [10.0, 60.0] }      # lowest, highest; or loguniform
# C_c = { triangular = [10.0, 30.0, 50.0] }              # lowest, most likely, highest
# buffer = { truncnorm = [0.01, 0.005, 0.0, 0.02] }      # mean, standard deviation, lowest, highest
# sample_time = { choice = [5, 10, 30] }                 # numbers or words, equally likely

[boundary]                              # what acts on the coil, second by second
kind = "paper_day"                      # or heating_day, constant_day, design_day, csv, weather, weather_year
hours = 8
seed = 1                                # [1, 2, 3] for three days: one more axis, called day

[run]
seed = 0                                # of the measurement noise
replicates = 1                          # noise realisations: one more axis, called replicate
warm_up = 1800                          # seconds left out of every metric
traces = []                             # signals to keep, such as ["T_sup", "command"]
trace_interval = 60                     # s between their samples
# reduce = "mine:overshoot"             # your function overshoot in mine.py next to this file: numbers from the traces
predict = false                         # true: margin, hunting, its period and swing as theory predicts them

# [tune]                                # what `fastcoil tune FILE` chooses for all valves and days above
# search = { buffer = [0.0, 0.01], error_dead_band = [0.0, 0.5] }  # and kp, ti, … where no table above varies them
# objective = "rmse"                    # metric to make small: its value that 95 % of valves and days do not exceed
# quantile = 0.95                       # or "mean"
# limits = { motor_travel = "now", hunts = [0.05, "mean"] }        # upper ones; "now": no more than as it is
# holdout = { kind = "paper_day", hours = 8, seed = [2, 3] }       # days to try it on, or labels such as [4, 5]
# evaluations = 240                     # settings that are tried

# [tariff]                              # prices: the summary then says what backlash costs a year
# electricity = 0.13                    # price of a kWh; below: of a kW of demand a month, of a kWh of heat
# demand = 15.0
# heat = 0.05
# cop = 4.0                             # of the chiller
# electric_heat = false                 # true: heating coils also pay for demand
# currency = "USD"
# baseline = { tuning = "as_found" }    # loops to compare with; those with backlash = 0 if there are
"""


_ANALYSIS = "# Analysis: "  # begins the line of a study file that names the script for what `fastcoil run` does not do


@dataclass(frozen=True)
class ShippedStudy:
    """A study file to start from."""

    name: str
    text: str

    @property
    def title(self) -> str:
        return str(tomllib.loads(self.text)["title"])

    @property
    def analysis(self) -> str:
        """The script that analyses the results, in words; empty where `fastcoil run` is enough."""
        found = (line for line in self.text.splitlines() if line.startswith(_ANALYSIS))
        return next(found, "").removeprefix(_ANALYSIS)


def shipped_studies() -> list[ShippedStudy]:
    """All of them, by name."""
    folders = (folder for folder in _folder().iterdir() if folder.is_dir())
    found = [file for folder in folders for file in folder.iterdir() if file.name.endswith(".toml")]
    found.sort(key=lambda file: file.name)
    return [ShippedStudy(file.name.removesuffix(".toml"), file.read_text(encoding="utf-8")) for file in found]


def shipped_study(name: str) -> ShippedStudy:
    """The study called ``name``."""
    known = {study.name: study for study in shipped_studies()}
    if name not in known:
        raise InputError(f"--from {shown(name)}: no such study{nearest(name, known)}; choose one of {', '.join(known)}")
    return known[name]


def _folder() -> Traversable:
    package = files("fastcoil")
    installed = package / "studies"
    if installed.is_dir():
        return installed
    root = Path(str(package)).parent
    if (root / "pyproject.toml").is_file() and (root / "studies").is_dir():
        return root / "studies"
    raise StorageError("this installation of fastcoil has no studies: install it again")
