"""Settings, and the links that hold them."""

import itertools
from pathlib import Path
from urllib.parse import parse_qsl

import pytest

from fastcoil.deliver.explore import loop, words
from fastcoil.deliver.explore import settings as settings_module
from fastcoil.deliver.explore.loop import scene_of
from fastcoil.deliver.explore.settings import (
    CHOICES,
    DIALS,
    STORIES,
    query_of,
    read_query,
    settings_of,
    settings_of_story,
    starts,
    words_of,
)
from fastcoil.loops.plan import plan_simulation
from fastcoil.loops.presets import PRESETS

STARTS = starts()


def read(query):
    return read_query(dict(parse_qsl(query, keep_blank_values=True)), STARTS, "paper_like")


def test_a_link_gives_the_settings_back():
    asked = [settings_of_story(story, STARTS) for story in STORIES]
    for name, start in STARTS.items():
        usual = settings_of(name, start)
        asked += [usual.turned(**{dial.name: step}) for dial in DIALS.values() for step in dial.steps]
        asked += [usual.turned(**{c.name: w}) for c in CHOICES.values() for w in words_of(c, start)]
    for settings in asked:
        assert read(query_of(settings, STARTS, "paper_like")) == (settings, [])
    assert query_of(asked[1], STARTS, "paper_like") == ""


@pytest.mark.parametrize(
    ("query", "sentence"),
    [
        ("backlash=300", "backlash = '300': give a number from 0 to 0.15"),
        ("kp=-1", "kp = '-1': give a number from 0.002 to 0.15"),
        ("kp=nan", "kp = 'nan': give a number from 0.002 to 0.15"),
        ("ti=", "ti = '': give a number from 4 to 800"),
        ("ti=<script>", "ti = '<script>': give a number from 4 to 800"),
        ("day=own", "day = 'own': choose one of steps, constant, design"),
        ("loop=lbln", "loop = 'lbln': unknown, did you mean 'lbnl'?; choose one of paper_like, paper_like_fast, lbnl"),
        ("backlas=0.1", "'backlas' is not a setting, did you mean 'backlash'?: leave it out"),
        ("m_a=1e400", "m_a = '1e400': give a number from 0.3 to 1.5"),
    ],
)
def test_a_link_with_a_mistake_is_refused_in_words_and_the_rest_is_shown(query, sentence):
    settings, problems = read(f"{query}&noise_std=0.02")
    assert len(problems) == 1
    assert problems[0].startswith(sentence)
    assert settings == settings_of("paper_like", STARTS["paper_like"]).turned(noise_std=0.02)


def test_all_that_can_be_set_can_be_simulated():
    """Every preset with every word, at both ends of all dials."""
    for name in PRESETS:
        start = STARTS[name]
        words = [words_of(CHOICES[c], start) for c in ("valve", "estimator", "day")]
        ends = [{d.name: d.steps[k] for d in DIALS.values()} for k in (0, -1)]
        for k, ((valve, estimator, day), values) in enumerate(itertools.product(itertools.product(*words), ends)):
            if k % 5 == 0 or valve == "own":
                settings = settings_of(name, start).turned(valve=valve, estimator=estimator, day=day, **values)
                scene = scene_of(settings, start)
                plan_simulation(scene.loop, scene.day)
                assert scene.loop["backlash"] == values["backlash"]


@pytest.mark.parametrize("name", ["lbnl", "heating_45"])
def test_the_load_is_the_air_of_days_that_have_none_of_their_own(name):
    settings = settings_of(name, STARTS[name]).turned(m_a=0.65)
    for day in ("constant", "design"):
        made = scene_of(settings.turned(day=day), STARTS[name]).day.series
        assert (made["m_a"] == 0.65).all()
        water = made["T_w_in"].mean()
        assert water == pytest.approx(45.0 if name == "heating_45" else 7.0)
    assert scene_of(settings, STARTS[name]).day.series["m_a"].std() > 0.0


def test_the_model_knows_no_page():
    for module in (settings_module, loop, words):
        source = Path(module.__file__).read_text(encoding="utf-8")
        assert not [w for w in ("bokeh", "tornado", "explore.page", "explore.figures", "explore.server") if w in source]
