"""What ``fastcoil explore`` shows is what the library says of the same loop, put together by hand here."""

import itertools
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from bokeh.models import BoxAnnotation
from helpers.advice_checks import any_loop

import fastcoil as fc
from fastcoil.deliver.explore import loop as explore
from fastcoil.deliver.explore.figures import LoopFigures
from fastcoil.loops.plan import plan_simulation
from fastcoil.loops.presets import PRESETS
from fastcoil.study.maintenance import Scenario, pick_scenario

full = partial(pytest.param, marks=pytest.mark.full)
MODEL = explore.Model()


def default_settings(model):
    """What a page shows first."""
    return explore.initial_settings(model.first, model.starts[model.first])


def tell(title):
    """The settings of a story, and the traces and words that are shown of it."""
    settings = explore.story_settings(title, MODEL.starts)
    return settings, MODEL.run(settings), MODEL.explain(settings)


@pytest.mark.kernel
@pytest.mark.parametrize(
    ("title", "by_hand", "begins", "has"),
    [
        full("A good valve", {"backlash": 0.0}, "This loop does not hunt.", "The valve has no gap."),
        full("7 % gap, plain PI", {}, "This loop hunts: ± 0.5", "Without the gap it does not hunt"),
        full("With the inverse", {"backlash_estimate": 0.065}, "This loop does not hunt",
             "Without the inverse it hunts: ± 0.5"),
        full("Estimate too large", {"backlash_estimate": 0.1}, "This loop hunts",
             "Without the inverse it hunts: ± 0.5"),
        ("Learning", {"estimator": "identify", "estimate_share": 0.95, "identify_stroke_time": 0.0},
         "This loop does not hunt.", "Without the inverse it hunts: ± 0.5"),
        full("Slower instead", {"ti": 40.0}, "This loop does not hunt.", "Without the gap it does not hunt"),
    ],
)  # fmt: skip
def test_a_story_shows_what_simulate_gives_to_the_bit_and_quotes_the_explanation(
    working_day, title, by_hand, begins, has
):
    _, run, texts = tell(title)
    ds = fc.simulate(fc.Loop(**by_hand), working_day, traces=explore.TRACES, trace_interval=5, n_jobs=1)
    for name in explore.TRACES:
        np.testing.assert_array_equal(run.traces[name], ds[name])
    for name in ("rmse", "hunts", "hunting_swing", "hunting_period", "motor_travel", "estimate_final"):
        np.testing.assert_array_equal(run.metric(name), ds[name])
    np.testing.assert_array_equal(run.traces["T_set"], working_day.series["T_set"][0][::5])
    explanation = fc.explain(fc.Loop(**by_hand), working_day)
    assert (texts.answer, texts.why, texts.advice) == (explanation.answer, explanation.why, explanation.advice)
    np.testing.assert_equal(texts.hunting_index, explanation.hunting_index)
    assert texts.answer.startswith(begins)
    assert ("its motor chatters, 117 reversals an hour" in texts.answer) == ("too large" in title)
    assert has in texts.compared
    assert run.error_text == f"RMS error {run.metric('rmse'):.2g} K"
    assert bool(run.learning_text) == (title == "Learning")


@pytest.mark.kernel
@pytest.mark.filterwarnings("ignore:action = ")
@pytest.mark.full
def test_whatever_the_loop_what_is_shown_is_the_explanation_beside_the_simulated_day():
    for seed in range(500):
        loop, day = any_loop(seed)
        scene, explanation = Scenario("any", loop, day, 1800, 0), fc.explain(loop, day)
        run, texts = explore.simulate_scene(scene), explore.explain_scene(scene)
        assert (texts.answer, texts.why, texts.advice) == (explanation.answer, explanation.why, explanation.advice)
        assert explanation.hunts == texts.answer.startswith(("This loop hunts", "This loop keeps swinging"))
        np.testing.assert_equal(run.metric("rmse"), float(explanation.cures["rmse"][0]))


@pytest.mark.kernel
def test_the_story_of_a_valve_test_shades_it_and_says_what_read_test_reads():
    settings, run, texts = tell("A valve test")
    start = run.scene.boundary.n_steps - 4500
    test = fc.ValveTest.gentle(start=start, settle=300)
    options = {"traces": ["command", "T_measured", "test"], "trace_interval": explore.TRACE_INTERVAL_S, "n_jobs": 1}
    ds = fc.simulate(run.scene.loop, run.scene.boundary, test=test, **options)
    np.testing.assert_array_equal(run.traces["command"], ds.command.values)
    r = fc.read_test(ds, stroke_time=0)
    assert r.identified
    assert abs(r.backlash - 0.07) <= 0.014
    assert f"reads a gap of {100 * r.backlash:.3g} %" in run.reading_text
    figures = LoopFigures()
    (shade,) = figures.temperature.select(BoxAnnotation)
    ends = {"left": start / 3600, "right": (start + 45 * 60 - explore.TRACE_INTERVAL_S) / 3600, "visible": True}
    assert dict(figures.show(run, settings.window))[shade.id] == ends
    without = MODEL.run(replace(settings, test="none"))
    assert without.reading_text == ""
    assert not dict(figures.show(without, settings.window))[shade.id]["visible"]
    assert MODEL.explain(replace(settings, test="none")) is texts
    assert MODEL.map(settings) is MODEL.map(replace(settings, test="none"))


@pytest.mark.kernel
@pytest.mark.parametrize("axes", explore.MAP_AXES)
def test_a_cell_of_the_map_is_its_loop_to_the_bit(axes, working_day):
    metrics = MODEL.map(replace(default_settings(MODEL), axes=axes))
    (x, along_x), (y, along_y) = explore.MAP_AXES[axes].items()
    for i, j in ((3, 2), (-1, -1)):
        ds = fc.simulate(fc.Loop(**{x: along_x[i], y: along_y[j]}), working_day, n_jobs=1)
        assert (metrics["rmse"][j, i], metrics["hunting_swing"][j, i]) == (ds.rmse, ds.hunting_swing)


@pytest.mark.kernel
def test_a_study_of_ones_own_is_shown_on_its_own_day(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('[loop]\npreset = "lbnl"\nkp = 0.4\nestimate_ratio = 0.5\n[boundary]\nhours = 1\nseed = 9\n')
    model = explore.Model(pick_scenario(path, {}, {}))
    assert default_settings(model).loop == "given"
    run = model.run(default_settings(model))
    ds = fc.simulate(fc.Loop.preset("lbnl").assign(kp=0.4, estimate_ratio=0.5), fc.paper_day(hours=1, seed=9), n_jobs=1)
    assert run.metric("rmse") == ds.rmse
    assert default_settings(model).kp == 0.4
    path.write_text('[loop]\npreset = "lbnl"\n[boundary]\nhours = 30\n')
    with pytest.raises(fc.InputError, match="its day lasts 30 h: give at most 24 h"):
        explore.Model(pick_scenario(path, {}, {}))


@pytest.mark.kernel
@pytest.mark.parametrize("step", [3, pytest.param(1, marks=pytest.mark.full)])
def test_the_experiments_of_the_page_show_what_it_says(step):
    """Those of docs/first-steps.md, in their order: every one, or each third."""
    plain_pi, *_ = tell("7 % gap, plain PI")
    inverse, run, _ = tell("With the inverse")
    learns, *_ = tell("Learning")
    constant_day = {"day": "constant"}
    experiments = (
        (plain_pi, constant_day, "This loop hunts: ± 0.47 K every 3 min."),
        (plain_pi, constant_day | {"backlash": 0.0}, "does not hunt.  Leave it: its error is below 0.01 K."),
        (inverse, {"backlash_estimate": 0.075}, "chatters, 113 reversals an hour"),
        (plain_pi, constant_day | {"ti": 12.0}, "hunting index 0.93"),
        (plain_pi, constant_day | {"ti": 15.0}, "hunting index 0.67"),
        (learns, {}, "right since hour 1.2"),
        (learns, constant_day | {"estimator": "learner"}, "right since hour 3.0"),
        (
            explore.initial_settings("lbnl", STARTS["lbnl"]),
            constant_day | {"estimator": "learner"},
            "does not hunt.  Leave it: ",
        ),
    )
    for settings, changes, expected_words in experiments[::step]:
        changed = replace(settings, **changes)
        texts = MODEL.explain(changed)
        learning_text = MODEL.run(changed).learning_text
        assert expected_words in f"{texts.answer}  {texts.advice} {learning_text} {texts.why}", changes
    errors = MODEL.map(plain_pi)["rmse"]
    j, i = np.unravel_index(np.argmin(errors), errors.shape)
    assert (explore.MAP_AXES["tuning"]["kp"][j], explore.MAP_AXES["tuning"]["ti"][i]) == (0.1, 64.0)
    assert round(float(errors[j, i]), 2) == 0.16 == round(run.metric("rmse"), 2)


STARTS = explore.start_loops()


def test_all_that_can_be_set_can_be_simulated_with_the_load_as_the_air_of_its_day():
    """Every loop to start from with every word, at both ends of all dials."""
    assert [*STARTS] == [name for name in PRESETS if name != "reheat"]  # which has a room
    for name, start in STARTS.items():
        usual = explore.initial_settings(name, start)
        words = itertools.product(*(explore.menu_words(c, start) for c in ("valve", "estimator", "day")))
        ends = [{name: dial.steps[k] for name, dial in explore.DIALS.items()} for k in (0, -1)]
        for k, ((valve, estimator, day), values) in enumerate(itertools.product(words, ends)):
            if k % 20 == 0:
                settings = replace(usual, valve=valve, estimator=estimator, day=day, **values)
                scene = explore.build_scene(settings, start)
                plan_simulation(scene.loop, scene.boundary)
                assert scene.loop["backlash"] == values["backlash"]
                series = scene.boundary.series
                assert (series["m_a"] == values["m_a"]).all() == (day != "steps")
                assert series["T_w_in"].mean() == pytest.approx(start.T_w_in, rel=0.01)
