"""Random loops, and contradictions in their explanation, or between it and the simulation."""

import re
from typing import NamedTuple

import numpy as np

import fastcoil as fc
from fastcoil.design.operating_points import operating_points

DAY = fc.paper_day(hours=2)
DAYS = {
    "cooling": (DAY, fc.constant_day(hours=2), fc.paper_day(hours=2, seed=4)),
    "heating": (fc.heating_day(hours=2), fc.constant_day(hours=2, T_a_in=12.0, W_a_in=0.005, T_w_in=60.0, T_set=25.0)),
}
PLAIN_PI = {"law": "pi", "estimator": "none", "learning_step": 0.0}


def random_loop(seed):
    """Draw a loop: any gains, a backlash, and in half of them an element that theory does not cover."""
    rng = np.random.default_rng([7, seed])
    loop = fc.Loop.preset(str(rng.choice(["lbnl", "g36", "paper_like_fast", "paper_like"])))
    kp, ti = loop["kp"] * 4.0 ** rng.uniform(-1, 1), 10 ** rng.uniform(0.5, 2.5)
    gains = {"kp": float(f"{kp:.2g}"), "ti": float(f"{ti:.2g}")}
    backlash = round(rng.choice([0.0, *rng.uniform(0.01, 0.15, 5)]), 3)
    valve = {"backlash": backlash, "stroke_time": float(rng.choice([0, 90, 300]))}
    odd = [
        {}, {}, {}, {}, {"command_resolution": 0.001}, {"sensor_resolution": 0.05}, {"neutral_zone": 0.01},
        {"estimator": "identify"}, {"estimator": "gradient"}, {"error_dead_band": 0.2},
        {"slip_jump": round(0.3 * backlash, 4)}, {"learning_step": 0.007, "estimator": "learner"},
    ]  # fmt: skip
    return loop.assign(noise_std=float(rng.choice([0.0, 0.02, 0.05])), **gains, **valve, **odd[rng.integers(len(odd))])


class Gain(NamedTuple):
    sample_time: float
    ki: float = fc.parameter(0.003, unit="K-1 s-1", lower=0.0, text="integral gain")


class Integral(NamedTuple):
    u: float = 0.0


@fc.law(Gain, Integral)
def integrate(now, p, memory):
    u = min(max(memory.u + p.ki * p.sample_time * now.e, 0.0), 1.0)
    return u, Integral(u)


def any_loop(seed):
    """Draw (loop, day): any preset, gains, law, estimator, compensation, coarseness, action and kind of day."""
    rng = np.random.default_rng([28, seed])

    def draw(*words):
        return words[rng.integers(len(words))]

    preset = draw("lbnl", "g36", "paper_like_fast", "paper_like", "heating", "heating")
    heats = preset == "heating"
    gap = draw(0.0, 0.01, 0.02, 0.04, 0.07, 0.1, 0.15)
    changes = {
        "kp": float(f"{np.exp(rng.uniform(np.log(0.003), np.log(0.15))):.2g}"),
        "ti": float(f"{10 ** rng.uniform(0.7, 2.7):.2g}"),
        "sample_time": draw(1, 5, 15, 30),
        "stroke_time": draw(0.0, 60.0, 90.0, 150.0),
        "noise_std": draw(0.0, 0.0, 0.02, 0.05),
        "backlash": gap,
    }
    estimate = draw(0.0, 0.5, 0.95, 1.1) * gap
    ways = {"compensation": draw("inverse", "additive", "smooth"), "backlash_estimate": round(estimate, 4)}
    learner = draw(
        {"estimator": "learner", "learning_step": 0.007}, {"estimator": "gradient"},
        {"estimator": "hagglund", "plant_gain": 15.0}, {"estimator": "identify", "estimate_share": 0.95},
    )  # fmt: skip
    coarse = {"sensor_resolution": 0.05, "command_resolution": 0.005, "neutral_zone": 0.01, "error_dead_band": 0.2}
    odd = draw("sensor_resolution", "command_resolution", "neutral_zone", "error_dead_band")
    changes |= draw({}, {}, {}, ways, ways, learner, {odd: coarse[odd]}, {"slip_jump": 0.3 * gap},
                   {"law": integrate, "ki": draw(0.0005, 0.002, 0.01)})  # fmt: skip
    if rng.random() < 0.06:
        changes["action"] = "cooling" if heats else "heating"
    return fc.Loop.preset(preset).assign(**changes), draw(*DAYS["heating" if heats else "cooling"])


def change_loop(loop, changes):
    """Change values of the loop; the PI in place of its law removes the parameters of that law."""
    if changes.get("law") == "pi" and loop["law"] != "pi":
        loop = fc.Loop(**{name: value for name, value in loop.constants.items() if name not in ("law", "ki")})
    return loop.assign(**changes)


def simulate_loop(loop, day, **changes):
    return fc.simulate(change_loop(loop, changes), day, n_jobs=1, progress=False)


def makes_its_swing(loop, days, **options):
    """Whether loops swing on days, and at half of the points of a day with all constant; there a third as much."""
    options |= {"n_jobs": 1, "progress": False}
    warm_up = options.get("warm_up", 1800)
    swing = fc.simulate(loop, days, **options).hunting_swing
    hunts, alone = [], []
    for day in [days.isel(day=k) for k in range(days.n_days)] if days.has_day_dim else [days]:
        points, n = operating_points(day, warm_up), min(days.n_steps, warm_up + 3 * 3600)
        still = {name: np.repeat(values[:, None], n, axis=1) for name, values in points.conditions.items()}
        twins = fc.simulate(loop, fc.Boundary(**still), **options)
        hunts.append(((twins.hunting_swing > 0.1).mean("day") >= 0.5).values)
        alone.append(twins.hunting_swing.mean("day").values)
    hunts, alone = (np.stack(rows, axis=-1) if days.has_day_dim else rows[0] for rows in (hunts, alone))
    swing = swing.transpose(..., "day").values if days.has_day_dim else swing.values
    return (swing > 0.1) & hunts & (3.0 * alone >= swing)


def follow_advice(explanation):
    """Return the loop with the recommended parameters."""
    cures = explanation.cures
    row = cures.sel(cure=explanation.recommended)
    return change_loop(explanation.loop, {n: row[n].item() for n in cures.coords if cures[n].ndim and n != "cure"})


def advice_problems(explanation):
    """Return the problems of the advice on the loop that has followed the advice.

    It may require nothing but what was offered the first time.
    """
    if explanation.recommended == "as_it_is":
        return []
    again = fc.explain(follow_advice(explanation), explanation.boundary)
    follows, with_gap = f"follows {explanation.recommended}", "If the backlash is known"
    problems = [f"{follows}, but hunts"] * again.hunts
    if again.recommended == "as_it_is" or (again.advice.startswith(with_gap) and with_gap in explanation.advice):
        return problems
    return [*problems, f"{follows}, then {again.recommended}: {explanation.advice} THEN {again.advice}"]


def contradictions(explanation):
    """Return every contradiction in an explanation."""
    loop, day = explanation.loop, explanation.boundary
    text, cures, problems = explanation.text, explanation.cures, []
    first, reason = text.splitlines()[:2]
    result = simulate_loop(loop, day)
    says_hunts = first.startswith(("This loop hunts: ", "This loop keeps swinging, irregularly: "))
    words = dict(zip(cures["cure"].values.tolist(), cures["words"].values.tolist(), strict=True))
    row = next(line for line in text.splitlines() if line.startswith("as it is"))
    advice = "\n".join(text.splitlines()[text.splitlines().index(row) + len(words) :])
    error = dict(zip(words, (cures["rmse"] / cures["rmse"][0]).values.tolist(), strict=True))

    def check(name, is_wrong):
        if is_wrong:
            problems.append(name)

    check("answer against twin", says_hunts != makes_its_swing(loop, day))
    check("answer against row", says_hunts == row.endswith("does not hunt"))
    troubled = "does not hold" in first or "chatters" in first
    check("calm, but to be cured", not says_hunts and "Do this" in advice and not troubled)
    check("chatters, but left alone", "chatters" in first and not says_hunts and "Leave it" in advice)
    check("hunts, but left alone", says_hunts and ("Leave it" in advice or "If the error matters" in advice))
    gains_are_calm = [
        not makes_its_swing(change_loop(loop, PLAIN_PI | {"kp": k * float(m.kp_simc), "ti": n * float(m.ti_simc)}), day)
        for m in [fc.linearise(change_loop(loop, {**PLAIN_PI, "kp": 0.01}), day)]
        for k, n in ((1.0, 1.0), (0.5, 1.0), (0.5, 2.0))
        if np.isfinite(m.kp_simc)
    ] if says_hunts and explanation.recommended in ("as_it_is", "dead_band", "repaired_valve") else []  # fmt: skip
    check("gains cure it, but none is proposed", any(gains_are_calm))
    better = {name for name, change in error.items() if change < 0.95}
    better -= {"repaired_valve"} if "a repaired valve would" in advice else set()
    verdicts = dict(zip(words, cures["verdict"].values.tolist(), strict=True))
    if "and stays calm" in advice:
        better -= {name for name, verdict in verdicts.items() if verdict == "makes it hunt"}
    better -= {"dead_band", "repaired_valve"} if "none of these gains" in advice else set()
    check("none is better, but a row is", "Leave it" in advice and "below 0.01 K" not in advice and better)
    recommended = explanation.recommended
    is_cured = any(verdict.startswith("cures it") for verdict in verdicts.values())
    is_untouched = "None of these " in advice and recommended == "as_it_is"
    check("none stops it, but a row does", is_untouched and is_cured)
    hunting_index = re.search(r"hunting index ([\d.e+-]+); a loop hunts above ([\d.]+\d)", reason)
    if hunting_index:
        above = float(hunting_index[1]) > float(hunting_index[2])
        names_theory = "go by the simulation" in text and ("theory" in reason or "swing" in reason)
        explained = "no swing large enough" in reason or names_theory
        is_unexplained = not above and "large swing" not in reason and not explained
        check("hunting index below its limit, but hunts", says_hunts and is_unexplained)
        check("hunting index above its limit, but calm", not says_hunts and above and not explained)
    perfect = "even with a perfect valve" in reason
    if "repaired_valve" in error:
        stops = not makes_its_swing(loop.assign(backlash=0.0, backlash_estimate=0.0, slip_jump=0.0), day)
        repair_cures = verdicts["repaired_valve"].startswith("cures")
        check("the valve is to blame and is not", perfect and stops and repair_cures)
        check("the valve is not to blame and is", "Any backlash triggers it" in reason and not repair_cures)
    if recommended != "as_it_is":
        check("the advice is not the recommended row", words[recommended] not in advice)
        quoted = re.search(r"RMSE [\d.]+ K \(([+-]\d+) %", advice[advice.find(words[recommended]) :])
        change = 100 * (error[recommended] - 1)
        check("another number than the row", not quoted or abs(float(quoted[1]) - change) > 0.51)
        advised = simulate_loop(follow_advice(explanation), day)
        check("recommended, but it hunts", makes_its_swing(follow_advice(explanation), day))
        check("simulated otherwise", abs(float(advised.rmse / result.rmse) - error[recommended]) > 1e-9)
    return problems


def contradictions_of_log(loop):
    """Return the same for the diagnosis of a log of 6 h of the loop, every 10 s, and its advice on that day."""
    day, problems = fc.paper_day(hours=6), []
    result = fc.simulate(loop, day, traces=["T_measured", "command"], trace_interval=10, n_jobs=1, progress=False)
    log = result.assign(T_set=("elapsed_time", day.series["T_set"][0][::10], {"units": "degC"}))
    diagnosis = fc.diagnose(log, stroke_time=loop["stroke_time"])
    calls = diagnosis.advice.reason.partition(":")[0]
    if diagnosis.hunts != (calls in ("Do this", "Leave the gains")):
        problems.append(f"hunts: {diagnosis.hunts}, but: {calls}")
    predictions = diagnosis.predictions
    if "log again" in diagnosis.advice.reason and predictions is not None and predictions.sel(case="simc").hunts == 0:
        problems.append("other gains are predicted to be calm, but none is advised")
    gains = re.search(r": kp ([\d.e-]+) 1/K, ti ([\d.e+]+) s: RMSE", diagnosis.advice.reason)
    if gains:
        advised = simulate_loop(loop, day, kp=float(gains[1]), ti=float(gains[2]))
        problems += ["advised gains hunt"] * int(advised.hunts > 0)
        problems += ["advised gains are worse"] * int(advised.rmse > 1.05 * result.rmse)
    return problems
