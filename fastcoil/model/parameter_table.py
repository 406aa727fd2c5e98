"""Table of all parameters: name, unit, bounds, default, meaning, and what theory makes of each.

Kernel rows, ``Loop``, study files, the command line, the attributes of a result and the limits of ``limit_cycle`` and
``explain`` derive from it, so a name is the same from the TOML key to the NetCDF coordinate.  The defaults are the
preset ``paper_like``.
"""

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple

from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr

Scalar = float | int | str
LARGEST_FLOAT = sys.float_info.max


class Theory(NamedTuple):
    """What the theory of a PI loop with a gap (``linearise``, ``limit_cycle``, ``explain``) makes of a parameter.

    nearest: value in the nearest loop that theory covers; None where it covers the parameter as it is, or is not
    affected by it.  clause: why it says nothing at other values and, behind a colon, what to do in Python; empty where
    it covers them, too.  only_with: a parameter that must be above 0 for the clause to hold.
    """

    nearest: Scalar | None = None
    clause: str = ""
    only_with: str = ""


COVERED = Theory()  # of a parameter at any value


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number (or word) of a control loop.

    ``text`` says what it is, in help and docs; ``label`` is a few words for the axis of a figure.  ``default`` is
    ``None`` for parameters that replace others when given (``rangeability``, …).  Bounds are inclusive unless
    ``open_lower``/``open_upper``.  ``theory`` has no default: each new parameter needs one.
    """

    name: str
    group: str
    unit: str
    default: Scalar | None
    text: str
    lower: float = -math.inf
    upper: float = math.inf
    open_lower: bool = False
    open_upper: bool = False
    whole: bool = False
    choices: tuple[str, ...] = ()
    label: str = ""
    theory: Theory = field(kw_only=True)

    @property
    def is_word(self) -> bool:
        return bool(self.choices)

    @property
    def bounds(self) -> str:
        """Admissible values in words, for tables and messages."""
        if self.is_word:
            return " or ".join(repr(c) for c in self.choices)
        low, high = f"{self.lower:g}", f"{self.upper:g}"
        if math.isinf(self.lower) and math.isinf(self.upper):
            text = "any finite number"
        elif math.isinf(self.upper):
            text = f"{'above' if self.open_lower else 'at least'} {low}"
        else:
            text = f"{'above' if self.open_lower else 'from'} {low} "
            text += f"and below {high}" if self.open_upper else f"to {high}"
        return f"whole, {text}" if self.whole else text

    def equation(self, value: object) -> str:
        """Format the parameter with a value as ``name = value unit``."""
        return f"{self.name} = {value}" + ("" if self.unit in ("", "1") else f" {self.unit}")

    def problem(self, value: object) -> Problem | None:
        """Return the mistake in a value that is not admissible, else ``None``."""
        if self.is_word:
            if isinstance(value, str) and value in self.choices:
                return None
            code = "choice" if isinstance(value, str) else "type"
            return Problem(f"{self.name} = {short_repr(value)}: choose {self.bounds}", self.name, code)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return Problem(f"{self.name} = {short_repr(value)}: give a number ({self.bounds})", self.name, "type")
        if not -LARGEST_FLOAT <= value <= LARGEST_FLOAT:
            text = f"{value}" if isinstance(value, float) else "a number of too many digits"
            return Problem(f"{self.name} = {text}: give a finite number ({self.bounds})", self.name, "value")
        too_low = value <= self.lower if self.open_lower else value < self.lower
        too_high = value >= self.upper if self.open_upper else value > self.upper
        if too_low or too_high or (self.whole and value != math.floor(value)):
            unit = "" if self.unit == "1" else f" {self.unit}"
            is_percent = self.unit == "1" and self.upper <= 1.0 < value <= 100.0
            hint = f"; {value:g} % is {value / 100.0:g}" * is_percent
            return Problem(f"{self.name} = {value:g}{unit}: must be {self.bounds}{hint}", self.name, "value")
        return None


_regular = partial(Parameter, theory=COVERED)
_positive = partial(_regular, lower=0.0, open_lower=True)
_SMALL_CYCLES = "makes small cycles of its own: give 0, or simulate it"
_RESOLUTION = Theory(0.0, f"a resolution (of sensor or command) {_SMALL_CYCLES}")

# fmt: off
_TABLE = (
    _positive("C_w", "coil", "kJ K-1", 8.8, "heat capacity of the water in one control volume (of 8), Eq (3)",
              label="water heat capacity C_w"),
    _positive("C_c", "coil", "kJ K-1", 30.0, "heat capacity of the metal of one control volume (of 8), Eq (3)",
              label="metal heat capacity C_c"),
    _positive("beta1", "coil", "1", 0.32, "water-side effectiveness: factor, Eq (4)", label="water-side factor β1"),
    _regular("beta2", "coil", "1", -0.20, "water-side effectiveness: exponent of m_w, Eq (4)", -5.0, 5.0,
             label="water-side exponent β2"),
    _positive("beta3", "coil", "1", 0.40, "air-side effectiveness (heat): factor, Eq (4)",
              label="air-side heat factor β3"),
    _regular("beta4", "coil", "1", -0.45, "air-side effectiveness (heat): exponent of m_a, Eq (4)", -5.0, 5.0,
             label="air-side heat exponent β4"),
    _positive("beta5", "coil", "1", 0.42, "air-side effectiveness (heat and mass): factor, Eq (4)",
              label="air-side heat and mass factor β5"),
    _regular("beta6", "coil", "1", -0.42, "air-side effectiveness (heat and mass): exponent of m_a, Eq (4)", -5.0, 5.0,
             label="air-side heat and mass exponent β6"),
    _positive("cp_w", "coil", "kJ kg-1 K-1", 4.186, "specific heat of water", label="specific heat of water"),
    _positive("cp_a", "coil", "kJ kg-1 K-1", 1.02, "specific heat of moist air", label="specific heat of air"),
    _regular("pressure", "coil", "Pa", 101325.0, "barometric pressure", 50e3, 110e3, label="barometric pressure"),
    _regular("n_volumes", "coil", "1", 8, "number of control volumes N along the water", 1, 64, whole=True,
             label="control volumes N"),
    _regular("air_march", "coil", "", "lagged",
             "how air passes: a step for each volume, as printed in Eq (3), or at once, before the controller looks",
             choices=("lagged", "quasistatic"), label="air march"),
    _regular("substeps", "coil", "1", 1, "steps a second in which Eqs (3) and (4) are taken", 1, 64, whole=True,
             label="substeps"),
    _regular("T_initial", "coil", "degC", 20.0, "all temperatures at the start", 0.0, 50.0,
             label="initial temperature"),
    _positive("m_max", "valve", "kg s-1", 2.0, "asymptotic water flow, Eq (2)", label="asymptotic water flow"),
    _positive("valve_a", "valve", "1", 0.7, "asymmetry a of the flow curve, Eq (2)", label="valve asymmetry a"),
    _positive("valve_b", "valve", "1", 9.0, "growth rate b of the flow curve per unit opening, Eq (2)",
              label="valve growth rate b"),
    _regular("valve_c", "valve", "1", 0.38, "opening c of steepest growth, Eq (2)", -5.0, 5.0,
             label="opening of steepest growth c"),
    _regular("rangeability", "valve", "1", None,
             "inherent rangeability R of an equal-percentage valve (with authority and m_full, replaces Eq (2)'s "
             "m_max, a, b, c)", 1.0, 1000.0, open_lower=True, label="rangeability"),
    _regular("authority", "valve", "1", None, "valve authority N: share of the total pressure drop, fully open",
             0.0, 1.0, open_lower=True, open_upper=True, label="valve authority"),
    _positive("m_full", "valve", "kg s-1", None, "water flow at full opening", label="water flow, fully open"),
    _regular("curve", "valve", "", "richards",
             "flow over opening: Eq (2), or m_max times the opening", choices=("richards", "linear"),
             label="valve curve"),
    _regular("pressure_independent", "valve", "1", 0.0,
             "1 = a regulator in the valve takes what the pressure difference (dp_ratio) exceeds the design by", 0.0,
             1.0, whole=True, label="pressure-independent"),
    _regular("leakage", "valve", "1", None,
             "share of the fully open water flow that passes at opening 0; not given: as much as Eq (2) as printed",
             0.0, 1.0, open_upper=True, label="leakage"),
    _regular("backlash", "actuator", "1", 0.07, "true backlash x_BL, fraction of stroke, Eq (1)", 0.0, 0.9,
             label="backlash"),
    _regular("stroke_time", "actuator", "s", 0.0, "time the motor takes for a full stroke; 0 = instantaneous", 0.0,
             label="stroke time"),
    Parameter("command_resolution", "actuator", "1", 0.0, "step of the actuator's input; 0 = continuous", 0.0, 0.5,
              label="command resolution", theory=_RESOLUTION),
    Parameter("neutral_zone", "actuator", "1", 0.0,
              "a motor at rest starts where its target is further away than this, and runs until there; 0 = none",
              0.0, 1.0, open_upper=True, label="neutral zone", theory=Theory(0.0, f"a neutral_zone {_SMALL_CYCLES}")),
    Parameter("positioner_band", "actuator", "1", 0.0,
              "a positioner measures the stem: the motor runs while the stem is further than this from its target; "
              "0 = the motor follows its own position", 0.0, 0.5, label="positioner band",
              theory=Theory(0.0, "a positioner (positioner_band) closes the gap by a loop of its own: give 0, or "
                                 "simulate it")),
    Parameter("slip_jump", "actuator", "1", 0.0,
              "jump J of a sticking stem when it breaks loose; the backlash is then the stick band S; 0 = Eq (1)",
              0.0, 0.9, label="slip jump J",
              theory=Theory(0.0, f"a stem that sticks and slips (slip_jump) {_SMALL_CYCLES}")),
    Parameter("wear_rate", "actuator", "1", 0.0,
              "growth of the backlash, fraction of stroke, per stroke that the stem travels; 0 = no wear", 0.0, 0.01,
              label="wear rate",
              theory=Theory(0.0, "a gap that wears has no one size: give wear_rate = 0 and the backlash that you "
                                 "mean")),
    _regular("plant", "plant", "", "coil", "what stands behind the valve", choices=("coil",), label="plant"),
    _regular("dead_time", "plant", "s", 0.0, "time by which a plant of one's own sees the valve late", 0.0, 3600.0,
             whole=True, label="dead time"),
    _positive("room_capacity", "room", "kJ K-1", None,
              "heat capacity of the room behind the plant; not given: there is no room",
              label="heat capacity of the room"),
    _regular("room_ua", "room", "kW K-1", 0.0, "heat transfer from the room to outdoors", 0.0,
             label="heat transfer of the room"),
    _regular("sensor_time_constant", "sensor", "s", 0.0, "first-order lag of the supply air sensor; 0 = none", 0.0,
             label="sensor time constant"),
    _regular("noise_std", "sensor", "K", 0.0, "standard deviation of the measurement noise at controller samples", 0.0,
             label="measurement noise"),
    Parameter("sensor_resolution", "sensor", "K", 0.0, "step of the measured temperature; 0 = continuous", 0.0,
              label="sensor resolution", theory=_RESOLUTION),
    _regular("kp", "controller", "K-1", 0.03, "proportional gain K_p, stroke per kelvin", label="proportional gain Kp"),
    _positive("ti", "controller", "s", 8.0, "integral time T_i", label="integral time Ti"),
    _regular("sample_time", "controller", "s", 30.0, "controller sample time", 1, 3600, whole=True,
             label="sample time"),
    Parameter("error_dead_band", "controller", "K", 0.0,
              "control error up to which the controller holds its output; 0 = none", 0.0, label="error dead band",
              theory=Theory(0.0, "an error_dead_band stops small cycles and starts others: give 0, or simulate it")),
    _regular("action", "controller", "", "cooling", "whether the valve opens to cool or to heat",
             choices=("cooling", "heating"), label="action"),
    _regular("controlled", "controller", "", "T_sup",
             "temperature that sensor, controller, set-point and error metrics look at", choices=("T_sup", "T_room"),
             label="controlled temperature"),
    _positive("plant_gain", "controller", "K", None,
              "change of the supply temperature per full stroke that the controller reckons with",
              label="reckoned plant gain"),
    Parameter("law", "controller", "", "pi", "what decides the opening that the controller asks for",
              choices=("pi",), label="control law",
              theory=Theory("pi", "a control law of your own has no describing function: simulate it")),
    _regular("test_start", "test", "s", None, "when the valve test starts; not given: there is none", 0.0,
             label="start of the test"),
    _regular("test_every", "test", "d", 0.0, "days between tests where days are a sequence; 0 = one test", 0.0,
             label="days between tests"),
    _positive("test_minutes", "test", "min", 20.0, "how long the valve test takes", label="minutes of the test"),
    _regular("test_rate", "test", "s-1", 7e-4, "rate of the command in the first ramp", 0.0, 0.01, open_lower=True,
             label="rate of the test"),
    _positive("test_threshold", "test", "K", 0.3, "error beyond the set-point of the start at which a ramp ends",
              label="threshold of the test"),
    _regular("test_settle", "test", "s", 60.0, "time for which the command holds before the first ramp", 0.0,
             label="settling of the test"),
    _regular("test_hold", "test", "s", 120.0, "time for which the command holds after a ramp", 0.0,
             label="hold of the test"),
    _positive("test_excursion", "test", "K", 1.5, "error at which the test is aborted", label="limit of the test"),
    Parameter("backlash_estimate", "inverse", "1", 0.0,
              "backlash that the inverse assumes; 0 = no inverse; the learner starts here and never goes below it",
              0.0, 1.0, open_upper=True, label="backlash estimate", theory=Theory(0.0)),
    _regular("estimate_ratio", "inverse", "1", None, "backlash_estimate / backlash, in place of backlash_estimate", 0.0,
             label="estimate / backlash"),
    _regular("buffer", "inverse", "1", 1e-9, "reversals of u up to this size are ignored by the inverse; 0 = none are",
             0.0, 1.0, open_upper=True, label="buffer"),
    _regular("buffer_ratio", "inverse", "1", 0.0,
             "buffer / (K_p x standard deviation of the noise), where that exceeds buffer; 0 = buffer counts", 0.0,
             label="buffer / noise in u"),
    _regular("buffer_noise", "inverse", "", "given",
             "noise that buffer_ratio takes: noise_std, or what the controller measures in its own readings",
             choices=("given", "measured"), label="noise of the buffer"),
    _regular("buffer_swing", "inverse", "K", 0.0,
             "largest change of the supply temperature, by plant_gain, from a jump of u across the buffer of "
             "buffer_ratio; 0 = any", 0.0, label="largest swing by the buffer"),
    _regular("compensation", "inverse", "", "inverse",
             "how the command crosses the gap: by the inverse, by half the estimate added to u, or by an inverse "
             "without a jump", choices=("inverse", "additive", "smooth"), label="compensation"),
    _positive("smooth_rate", "inverse", "s-1", 1e-4,
              "rate of u at which the smooth compensation has crossed 98 % of the gap",
              label="rate of the smooth inverse"),
    Parameter("estimator", "estimator", "", None,
              "what finds the backlash estimate; by default the learner where learning_step > 0, else nothing does",
              choices=("none", "learner", "hagglund", "gradient", "identify"), label="estimator",
              theory=Theory("none", "an estimator changes the estimate as it goes: give estimator = 'none' and the "
                             "backlash_estimate that you want to know about", only_with="estimate_share")),
    _regular("estimate_share", "estimator", "1", 1.0,
             "share of the estimate that the inverse assumes; 0 = the estimate is only reported", 0.0, 1.0,
             label="share of the estimate"),
    Parameter("learning_step", "learner", "1", 0.0, "step by which the learner changes its estimate; 0 = no learning",
              0.0, 0.25, label="learning step", theory=Theory(0.0)),
    _regular("learning_interval", "learner", "s", 1800.0, "time between updates of the estimate", 600, 86400,
             whole=True, label="learning interval"),
    _positive("learning_ratio", "learner", "1", 2.0,
              "the learner steps down if switches are more than this many times as frequent as in the first interval",
              label="learning ratio"),
    _regular("learning_floor", "learner", "1", 0.0,
             "lower limit of the first interval's switch frequency, switches per 10 min", 0.0, label="learning floor"),
    _regular("learning_cap", "learner", "1", 0.25, "largest estimate the learner may reach", 0.0, 0.9, open_lower=True,
             label="learning cap"),
    _regular("learning_min_switches", "learner", "1", 0.0,
             "an interval with fewer mode switches is not counted: the estimate stays", 0.0,
             label="least switches per interval"),
    _regular("learning_max_reference", "learner", "1", 1.0,
             "a first interval with switches in more than this share of samples is not counted: the estimate stays",
             0.0, 1.0, open_lower=True, label="largest reference switch share"),
    _regular("learning_early_trip", "learner", "1", 0.0,
             "1 = step down as soon as an interval has too many switches, 0 = at its end", 0.0, 1.0, whole=True,
             label="early trip"),
    _regular("learning_growth", "learner", "1", 1.0,
             "each step up is this many times the one before, until the first step down", 1.0, 10.0,
             label="step growth"),
    _regular("learning_shrink", "learner", "1", 1.0, "factor applied to all steps after a step down", 0.0, 1.0,
             open_lower=True, label="step shrink"),
    _regular("learning_final", "learner", "1", 1.0, "factor applied to the estimate when learning stops", 0.0, 1.0,
             open_lower=True, label="final factor"),
    _regular("learning_reference", "learner", "1", 0.0,
             "intervals that the reference is the mean of, after a first one that is left out; 0 = the first interval "
             "is the reference", 0.0, 100.0, whole=True, label="intervals of the reference"),
    _regular("learning_error_ratio", "learner", "1", 0.0,
             "the learner steps down, too, if the settled rms error of an interval is more than this many times that "
             "of the reference; 0 = it does not look at the error", 0.0, label="error ratio of the learner"),
    _regular("learning_stop", "learner", "", "never", "whether the first step down ends the learning",
             choices=("never", "first_step_down"), label="learning stop"),
    _regular("hagglund_filter_ratio", "hagglund", "1", 0.1,
             "filter time of the control error over ti; 0 = not filtered", 0.0, 10.0, label="filter time / Ti"),
    _regular("hagglund_least_half_periods", "hagglund", "1", 10,
             "half periods that must count before there is an estimate: the median gap of the last five; it is final "
             "where estimate_share > 0", 5, 1000, whole=True, label="least half periods"),
    _positive("gradient_gain", "gradient", "K-1 s-1", 3e-4, "gain of the adaptation", label="adaptation gain"),
    _positive("gradient_filter_time", "gradient", "s", 60.0,
              "filter time of the regressor, about the dominant time constant of the loop", label="filter time"),
    _regular("gradient_reference_time", "gradient", "s", 60.0,
             "time constant with which the loop should follow its set-point", 0.0, label="reference time constant"),
    _regular("gradient_dead_zone", "gradient", "K", 0.05,
             "deviations from the reference up to this size are ignored; about twice the noise", 0.0,
             label="dead zone"),
    _regular("gradient_pause", "gradient", "s", 400.0,
             "time without adaptation after a start, or a step of set-point (over 0.1 K) or air flow (over 5 %)", 0.0,
             label="pause"),
    _regular("gradient_cap", "gradient", "1", 0.2, "largest estimate the adaptation may reach", 0.0, 0.9,
             open_lower=True, label="adaptation cap"),
    _regular("identify_stroke_time", "identify", "s", 90.0,
             "time for a full stroke that the identification reckons with; 0 = instantaneous", 0.0,
             label="reckoned stroke time"),
    _positive("identify_memory", "identify", "s", 86400.0,
              "time after which what was seen counts 1/e as much; only time within 2 h of a step of the set-point and "
              "of valve tests counts or passes", label="memory"),
    _positive("identify_interval", "identify", "s", 600.0, "time between comparisons of the possible sizes",
              label="interval of comparisons"),
    _regular("identify_certainty", "identify", "1", 0.7,
             "least probability of being right, to 20 % of the backlash or 1 % of stroke, at which an estimate is "
             "taken over", 0.0, 1.0, open_upper=True, label="certainty"),
)
# fmt: on

PARAMETERS: dict[str, Parameter] = {p.name: p for p in _TABLE}
"""Every parameter by name, in the order of the loop: coil, valve, actuator, sensor, controller, learner."""

ESTIMATOR_GROUPS = tuple(name for name in PARAMETERS["estimator"].choices if name != "none")
"""Groups of parameters that are read only by the estimator with the name of the group."""

INTEGER_PARAMETERS = ("n_volumes", "substeps")  # integers; all other numbers are floats
INSTALLED_VALVE_PARAMETERS = ("rangeability", "authority", "m_full")
_CURVE_PARAMETERS = ("m_max", "valve_a", "valve_b", "valve_c")
STAND_INS = {"estimate_ratio": ("backlash_estimate",), **dict.fromkeys(INSTALLED_VALVE_PARAMETERS, _CURVE_PARAMETERS)}
"""Parameters without a default, and the ones they replace."""

RESERVED_DIMS = ("sample", "replicate", "day", "controller", "tuning", "volume", "elapsed_time")
CHANCE_DIMS = ("sample", "design", "day", "replicate")
"""Dims of chance: which valve, day or noise; tables and figures pool over them."""


def require_parameter_name(name: str, table: Mapping[str, Parameter] = PARAMETERS) -> str:
    """Return ``name`` if ``table`` has it, else raise ``InputError`` with the most similar name."""
    if not isinstance(name, str):
        text = f"{short_repr(name)} is not the name of a parameter (see `fastcoil parameters`)"
        raise InputError(text, "name", "type")
    if name not in table:
        text = name if name.isidentifier() and len(name) < 60 else short_repr(name)
        sentence = f"{text} is not a parameter{did_you_mean(name, table)} (see `fastcoil parameters`)"
        raise InputError(sentence, name, "name")
    return name


class ParameterListing(dict[str, Parameter]):
    """Parameters by name; printed as a list, by the parts of the loop."""

    def __repr__(self) -> str:
        return "\n".join(parameter_lines(self.values()))


def parameter_lines(parameters: Iterable[Parameter]) -> list[str]:
    """Format parameters as lines: by part of the loop, each with default, unit, meaning and allowed values."""
    lines = []
    for group, group_parameters in groupby(parameters, attrgetter("group")):
        lines.append(group)
        for p in group_parameters:
            default = "-" if p.default is None else f"{p.default}"
            unit = "" if p.unit == "1" else p.unit
            lines.append(f"  {p.name:<22}{default:>10} {unit:<12} {p.text} ({p.bounds})")
    return lines
