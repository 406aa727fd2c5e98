"""Every metric and trace once: name, unit, meaning.  The order is that of the kernel's output rows."""

from dataclasses import dataclass

from fastcoil.base.errors import did_you_mean

STATUS_MEANINGS = ("ok", "non_finite", "out_of_range", "not_run", "crashed")
STATUS_OK, STATUS_NON_FINITE, STATUS_OUT_OF_RANGE, STATUS_NOT_RUN, STATUS_CRASHED = range(5)

LEARNING_STATUS_MEANINGS = ("off", "learning", "stepped_down", "stopped", "no_evidence", "not_identifiable")
TEST_ABORTED_MEANINGS = ("no", "excursion", "end_of_stroke", "swing", "disabled", "varying_air")

WARM_UP_S = 1800  # default of the time left out of every metric, as in section 2.2 of the paper
SETTLING_TIME_S = 600  # after a step of the set-point, or a start of the loop, that the settled metrics leave out
SET_POINT_STEP_K = 0.05  # change of the set-point from one second to the next that is a step; less is a reset
SWITCH_BLOCK_S = 600  # of the switch frequency, as in section 3.3 of the paper
PEAK_BLOCK_S = 900  # averaging time of the peak power
ESTIMATE_WINDOW_S = 7200  # last part of a run, over which the estimate is averaged
HUNTING_SWING_K = 0.1  # peak-to-peak supply temperature above which a loop may hunt: less is not worth a repair
OFF_SET_POINT_ERROR_K = 0.5  # control error beyond which the supply temperature counts as off its set-point


@dataclass(frozen=True, slots=True)
class Output:
    """One result variable.

    ``long_name`` and ``comment`` are its attributes in a result, ``label`` is a few words for the axis of a figure.
    ``difference`` marks temperature differences, ``per_volume`` a dim ``volume``, ``censored`` that NaN means "not
    within the run"; ``flags`` are the meanings of a variable that is 0, 1, ….
    """

    name: str
    unit: str
    long_name: str
    comment: str = ""
    difference: bool = False
    per_volume: bool = False
    flags: tuple[str, ...] = ()
    label: str = ""
    censored: bool = False


def _by_name(*outputs: Output) -> dict[str, Output]:
    return {output.name: output for output in outputs}


# fmt: off
METRICS = _by_name(
    Output("rmse", "K", "RMS control error",
           "sqrt of mean e^2, e = T - T_set, T the true supply air, or room where it is controlled", difference=True,
           label="RMS error"),
    Output("rmse_settled", "K", "RMS control error, settled",
           f"as rmse, where {SETTLING_TIME_S} s have passed since the last step of the set-point or start of the "
           "loop", difference=True, label="settled RMS error"),
    Output("iae", "K h", "integral of absolute control error", "sum of |e| dt / 3600",
           label="integrated absolute error"),
    Output("share_off", "1", "share of the time off the set-point",
           f"share of the counted seconds with |e| > {OFF_SET_POINT_ERROR_K} K",
           label=f"share of time with |e| > {OFF_SET_POINT_ERROR_K} K"),
    Output("hunting_swing", "K", "swing of the supply temperature",
           "median over the settled 20-min blocks of max - min of T_sup - T_set less its 300-s mean", difference=True,
           label="swing, peak to peak"),
    Output("settled_range", "K", "range of the controlled temperature, settled",
           "mean over settled windows of max - min of T_sup, or T_room where it is controlled, less the moves of the "
           "set-point", difference=True,
           label="settled range"),
    Output("hunting_period", "s", "period of the swing",
           "mean time between the lower turns of T_sup - T_set less its 300-s mean; NaN without a whole period",
           label="period of the swing"),
    Output("swing_regularity", "1", "regularity of the swing",
           "share of its periods as long, to 20 % or a sample and 10 s, as the one before; NaN below two periods",
           label="regular periods"),
    Output("hunts", "1", "whether the loop hunts",
           f"1 where in at least half of the settled 20-min blocks T_sup swings by more than {HUNTING_SWING_K} K, and "
           "entering air, water and set-point do not explain it; else 0; NaN without 10 settled minutes",
           label="share that hunts"),
    Output("switch_frequency", "1", "mode switches per 10 min",
           f"mean over whole {SWITCH_BLOCK_S}-s blocks from the end of the warm-up", label="mode switches per 10 min"),
    Output("stem_travel", "1", "travel of the valve stem", "sum of |change of opening|, strokes",
           label="stem travel, strokes"),
    Output("motor_travel", "1", "travel of the actuator motor", "sum of |change of position|, strokes",
           label="motor travel, strokes"),
    Output("reversals", "1", "reversals of the valve stem", "sign changes of successive opening changes above 1e-9",
           label="stem reversals"),
    Output("estimate_final", "1", "backlash estimate at the end", label="final estimate"),
    Output("estimate_largest", "1", "largest backlash estimate", "counted or not", label="largest estimate"),
    Output("estimate_settled", "1", f"mean backlash estimate of the last {ESTIMATE_WINDOW_S} s",
           label="settled estimate"),
    Output("size_error", "1", "error of the estimated backlash",
           "estimate_settled - backlash_final; NaN for a plain PI, which assumes no backlash",
           label="estimate - backlash"),
    Output("backlash_final", "1", "true backlash at the end", "worn, and scaled by the boundary; at most 0.9",
           label="true backlash"),
    Output("learn_time_reached", "s", "time at which the estimate reached the backlash",
           "first update with estimate >= backlash - step/2; NaN = never (censored)", censored=True,
           label="time to reach the backlash"),
    Output("learn_time_confirmed", "s", "time at which the learned backlash was confirmed",
           "first step down at or after learn_time_reached; NaN = never (censored)", censored=True,
           label="time to confirm the backlash"),
    Output("time_identified", "s", "time from which the estimate was right",
           "to 20 % of the backlash or 1 % of stroke, until the end; NaN = never (censored)", censored=True,
           label="time to identify the backlash"),
    Output("learn_time_first_down", "s", "time of the first step down", "NaN = never (censored)", censored=True,
           label="time of the first step down"),
    Output("estimate_first_down", "1", "backlash estimate after the first step down", "NaN = never (censored)",
           censored=True, label="estimate after the first step down"),
    Output("learning_status", "1", "how the learning went",
           "no_evidence, not_identifiable: no interval could serve as reference; the last one had too few switches or "
           "too many", flags=LEARNING_STATUS_MEANINGS, label="learning status"),
    Output("half_periods", "1", "half periods of the control error that counted",
           "those that Hägglund's rules of acceptance let through, from the start of the run",
           label="counted half periods"),
    Output("half_period_spread", "1", "spread of the gaps of single half periods",
           "largest - smallest of the last five that counted; NaN below five", label="spread of single gaps"),
    Output("test_aborted", "1", "whether the valve test was aborted",
           "no: it was not, or there was none; by an excursion beyond its limit, at an end of the stroke that did not "
           "bring the temperature back, by a swing that went on while the command was held, because the loop was "
           "switched off or the air flow never calm", flags=TEST_ABORTED_MEANINGS, label="abortion of the test"),
    Output("coil_energy", "kW h", "heat exchanged by the water",
           "sum of m_w cp_w (T_w_out - T_w_in) dt; sign turned for heating", label="coil energy"),
    Output("coil_peak_power", "kW", "peak heat rate of the water", f"largest mean over whole {PEAK_BLOCK_S}-s blocks",
           label="peak coil power"),
    Output("reheat_energy", "kW h", "heat that the supply air lacks of its set-point",
           "sum of m_a cp_a (T_set - T_sup) dt where that is positive", label="reheat energy"),
    Output("recool_energy", "kW h", "heat that the supply air has above its set-point",
           "sum of m_a cp_a (T_sup - T_set) dt where that is positive", label="recool energy"),
    Output("water_volume", "m3", "water through the coil", "at 1000 kg/m3", label="water volume"),
    Output("condensate", "kg", "condensate", "sum over the volumes of m_a (W_in - W_out) dt", label="condensate"),
    Output("frost_time", "s", "time in which frost forms on the coil",
           "metal of a wet control volume below 0 degC, seen every 60 s of the whole run, counted or not; frost is "
           "not simulated", label="time with frost"),
    Output("freeze_time", "s", "time in which water freezes in the coil",
           "water of a control volume, or its metal where the water stands still, at or below 0 degC, seen every 60 s "
           "of the whole run, counted or not; ice is not simulated", label="time with ice"),
)

SUPPLY_METRICS = ("reheat_energy", "recool_energy")
"""Metrics of the error of the supply air; NaN where the room is controlled."""
COIL_METRICS = (*SUPPLY_METRICS, "coil_energy", "coil_peak_power", "condensate", "frost_time", "freeze_time")
"""Metrics that only the coil has; NaN with another plant."""
COIL_TRACES = ("T_w_out", "W_sup", "wet_volumes", "power", "T_w", "T_c", "T_a", "W_a")
"""Traces that only the coil has; NaN with another plant."""

COSTS = _by_name(
    Output("coil_cost", "currency", "cost of the coil's energy",
           "chilled water at the price of electricity over the COP, hot water at the price of heat",
           label="cost of the coil's energy"),
    Output("demand", "kW", "billed demand",
           "highest of the days' coil_peak_power over the COP; of hot water only where it is made by electricity",
           label="billed demand"),
    Output("demand_cost", "currency", "cost of the demand", "an incomplete month pays its share of the days",
           label="cost of the demand"),
    Output("reheat_cost", "currency", "cost of heating supply air that is too cold",
           "reheat_energy at the price of heat", label="cost of reheat"),
    Output("recool_cost", "currency", "cost of cooling supply air that is too warm",
           "recool_energy at the price of electricity over the COP", label="cost of recooling"),
    Output("cost", "currency", "cost of energy and demand", "sum of coil, demand, reheat and recooling", label="cost"),
)
"""What ``fc.cost`` gives of every billing month; of a year the names begin with ``yearly_``."""
YEARLY_PREFIX = "yearly_"

TRACES = _by_name(
    Output("T_sup", "degC", "supply air temperature", "leaves control volume 1", label="supply air"),
    Output("T_room", "degC", "room temperature", "NaN without a room", label="room"),
    Output("T_measured", "degC", "measured temperature", "sensor lag, noise and resolution applied",
           label="measured supply air"),
    Output("u", "1", "PI output, desired opening", label="desired opening u"),
    Output("integral", "1", "integral part of the PI output", label="integral part of u"),
    Output("command", "1", "command to the actuator", label="command"),
    Output("position", "1", "motor position", label="motor position"),
    Output("opening", "1", "valve opening, Eq (1)", label="opening"),
    Output("m_w", "kg s-1", "water flow, Eq (2)", label="water flow"),
    Output("estimate", "1", "backlash estimate of the inverse", label="backlash estimate"),
    Output("mode", "1", "mode of the inverse", "-1 falling, +1 rising, 0 open loop or failed", label="mode"),
    Output("test", "1", "whether the valve test runs", "1 while it does", label="valve test"),
    Output("T_w_out", "degC", "leaving water temperature", label="leaving water"),
    Output("W_sup", "1", "humidity ratio of the supply air", "kg/kg dry air", label="supply humidity ratio"),
    Output("wet_volumes", "1", "number of wet control volumes", label="wet volumes"),
    Output("power", "kW", "heat rate of the water", label="coil power"),
    Output("T_w", "degC", "water temperature", "leaving each control volume", per_volume=True, label="water"),
    Output("T_c", "degC", "coil material temperature", per_volume=True, label="coil metal"),
    Output("T_a", "degC", "air temperature", "leaving each control volume", per_volume=True, label="air"),
    Output("W_a", "1", "humidity ratio of the air", "leaving each control volume, kg/kg dry air", per_volume=True,
           label="humidity ratio"),
)
# fmt: on


def metric_hint(name: str) -> str:
    """Return the clause ``, did you mean …?`` with the metric most similar to a wrong name; empty without one."""
    return "" if name in METRICS else did_you_mean(name, METRICS)
