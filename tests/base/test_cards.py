"""Cards of notebooks: escaped, without a script or a colour of their own, and what was changed comes first."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import numpy as np
import pytest

import fastcoil as fc
from fastcoil.base.results import Result, Section, card
from fastcoil.design.tuning_result import Tuning
from fastcoil.measured.diagnosis import Diagnosis
from fastcoil.measured.fit import Fit
from fastcoil.measured.fit_loop import LoopFit
from fastcoil.model.parameter_table import ESTIMATOR_GROUPS

VOID = {"br", "hr", "img", "polyline"}


class Read(HTMLParser):
    """What a browser finds: sections with their rows of cells, curves, the names of all tags."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.open, self.texts, self.attributes = [], [], [], []
        self.sections, self.rows, self.curves, self.unfolded = {}, None, [], []
        self.feed(text)
        assert not self.open, self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)
        if tag == "summary":
            self.title = ""
        if tag == "tr":
            self.rows.append([])
        if tag == "td":
            self.rows[-1].append("")
        if tag == "details":
            self.rows, self.is_open = [], dict(attrs).get("open", "") is None
        if tag == "polyline":
            self.curves.append([tuple(map(float, p.split(","))) for p in dict(attrs)["points"].split()])

    def handle_endtag(self, tag):
        if tag in VOID:
            return
        assert self.open.pop() == tag
        if tag == "summary":
            self.sections[self.title] = self.rows
            self.unfolded += [self.title] * self.is_open

    def handle_data(self, data):
        if "style" in self.open:
            return
        self.texts.append(data)
        if self.open and self.open[-1] == "summary":
            self.title += data.strip()
        if "td" in self.open:
            self.rows[-1][-1] += data.strip()


def values(rows):
    return {row[0]: row[1:] for row in rows}


def test_whatever_text_is_shown_as_text():
    bad = "<script>alert(1)</script> & \"'"
    found = Read(card(bad, bad, [bad], [Section(bad, [(bad, bad)], soft=bad, text=bad)]))
    assert "script" not in found.tags
    assert "".join(found.texts).count(bad) == 8


@pytest.mark.parametrize("shown", [fc.Loop(backlash=[0.02, 0.07]), fc.constant_day(1)], ids=["loop", "boundary"])
def test_a_card_has_no_script_no_address_and_no_colour_but_those_of_the_page(shown):
    text = shown._repr_html_()
    found = Read(text)
    assert not {"script", "iframe", "link", "img"} & set(found.tags)
    assert not [name for name, _ in found.attributes if name.startswith("on") or name in ("src", "href")]
    assert "http" not in text
    assert {value for name, value in found.attributes if name == "stroke"} <= {"currentColor"}
    assert set(re.findall(r"#[0-9a-f]{3,6}\b|rgba?\([^)]*\)", text)) == {"rgba(128,128,128,.4)"}


def test_what_differs_from_the_nearest_preset_comes_first_and_unfolded():
    loop = fc.Loop.preset("lbnl").assign(kp=0.02, backlash=[0.02, 0.07], ti=("run", np.linspace(5, 300, 9)))
    found = Read(loop._repr_html_())
    assert found.unfolded == ["Differs from lbnl"] == list(found.sections)[:1]
    assert values(found.sections["Differs from lbnl"]) == {
        "backlash": ["0.02, 0.07 (backlash: 2)", "instead of 0.07", "backlash"],
        "ti": ["5 to 300 s (run: 9)", "instead of 30 s", "integral time Ti"],
        "kp": ["0.02 1/K", "instead of 0.018 1/K", "proportional gain Kp"],
    }
    assert "18 scenarios (backlash: 2, run: 9)" in found.texts
    assert list(Read(fc.Loop.preset("heating")._repr_html_()).sections)[0].startswith("coil")


def test_a_drawn_parameter_has_its_range_and_its_median():
    drawn = fc.Loop(kp=("sample", [0.05, 0.01, 0.02, 0.03, 0.04, 0.02]))
    rows = values(Read(drawn._repr_html_()).sections["Differs from paper_like"])
    assert rows["kp"][0] == "0.01 to 0.05, median 0.025 1/K (sample: 6)"


@pytest.mark.parametrize("estimator", [None, "identify"])
def test_every_parameter_is_in_its_part_and_other_estimators_are_left_out(estimator):
    loop = fc.Loop() if estimator is None else fc.Loop(estimator=estimator)
    sections = Read(loop._repr_html_()).sections
    listed = {row[0] for title, rows in sections.items() if not title.startswith("Differs") for row in rows}
    others = set(ESTIMATOR_GROUPS) - {estimator}
    assert listed == {name for name, _ in loop.items() if fc.parameters()[name].group not in others}


def test_a_boundary_has_a_curve_of_each_series_that_is_given_with_its_range():
    day = fc.constant_day(1, T_set=np.repeat([13.0, 15.0], 1800))
    found = Read(day._repr_html_())
    rows = values(found.sections["series"])
    assert list(rows) == ["m_a", "T_a_in", "W_a_in", "T_w_in", "T_set"]
    assert rows["T_set"][1:] == ["13 to 15 °C", "set-point of the supply air temperature"]
    assert len(found.curves) == 5
    flat, steps = found.curves[0], found.curves[-1]
    assert {y for _, y in flat} == {9.0}
    assert {y for x, y in steps if x < 54} == {17.0}
    assert {y for x, y in steps if x > 56} == {1.0}
    assert values(found.sections["about"])["sha256"] == [day.sha256]


def test_days_lie_over_each_other_and_have_labels_and_a_start():
    days = fc.paper_day(0.1, seed=range(3, 33)).assign(start=np.datetime64("2024-05-01") + np.arange(30))
    found = Read(days._repr_html_())
    assert len(found.curves) == 5 * 5
    about = values(found.sections["about"])
    assert about["day"] == ["3, 4, 5, 6, 7, 8, 9, 10, … 32"]
    assert about["start"] == ["2024-05-01 00:00:00"]


def test_a_look_at_a_stream_makes_its_first_day_only():
    made = []

    def make(label):
        made.append(label)
        return {"m_a": 1.0 + label, "T_a_in": 25.0, "W_a_in": 0.01, "T_w_in": 7.0, "T_set": np.full(60, 14.0)}

    stream = fc.Boundary.from_days(make, day=[4, 5, 6], n_steps=60)
    del made[:]
    found = Read(stream._repr_html_())
    assert made == [4]
    assert repr(stream) == "<fastcoil.Boundary 0.0166667 h x 3 days, made day by day>"
    assert made == [4]
    assert "sha256" not in values(found.sections["about"])
    assert any("of the first day" in text for text in found.texts)
    assert values(found.sections["series"])["m_a"][1] == "5 kg/s"


def test_the_parameters_are_a_list_to_read_with_default_unit_bounds_and_meaning():
    table = fc.parameters()
    lines = repr(table).splitlines()
    assert len(lines) == len(table) + len({p.group for p in table.values()})
    kp = table["kp"]
    assert next(line.split() for line in lines if line.split()[0] == "kp")[:3] == ["kp", f"{kp.default}", "K-1"]
    found = Read(table._repr_html_())
    rows = {row[0]: row[1:] for rows in found.sections.values() for row in rows}
    assert rows.keys() == table.keys()
    assert rows["kp"] == [f"{kp.default} K-1", kp.bounds, kp.text]


class Short(Result):
    def summary(self):
        return ["The answer", "why", "        now    chosen", "rmse    1 K    0.5 K", "a note"]

    def to_toml(self, path=None):
        return "[loop]\nkp = 0.02\n"


def test_a_result_tells_its_summary_in_a_terminal_and_in_a_notebook():
    assert repr(Short()).splitlines() == ["<fastcoil Short>", *Short().summary()]
    found = Read(Short()._repr_html_())
    assert "The answer" in found.texts
    assert "        now    chosen\nrmse    1 K    0.5 K" in found.texts
    assert any("kp = 0.02" in text for text in found.texts)


@pytest.mark.parametrize("kind", [Fit, LoopFit, Diagnosis, Tuning])
def test_no_result_prints_all_of_its_arrays(kind):
    assert kind.__repr__ is Result.__repr__
    assert kind.summary is not Result.summary
    assert kind.to_toml is not Result.to_toml
