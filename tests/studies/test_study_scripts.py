"""The scripts in ``studies/``: each runs on its study made small, and its tables hold what plain Python finds."""

from __future__ import annotations

import math
import re
import statistics

import answers
import conditions
import learning
import learning_maps
import numpy as np
import population
import pytest
import report
import scorecard
import xarray as xr
from scipy import stats

import fastcoil as fc

pytestmark = pytest.mark.kernel

STUDIES = report.HERE
PAGES = report.PAGES
SHORT = {r"(seed = \[\d+, \d+).*\]": r"\1]", r"hours = \d+": "hours = 2", r"size = 4096": "size = 16",
         r"size = 1024": "size = 4"}  # fmt: skip
FEW_RULES = {
    r"\n(learning_step) = \[.*": r"\n\1 = [0.007, 0.028]",
    r"\n(learning_interval) = \[.*": r"\n\1 = [900, 1800]",
    r"\n(learning_ratio) = \[.*": r"\n\1 = [1.5, 2.0]",
    r"\n(noise_std) = \[.*": r"\n\1 = [0.0, 0.1]",
    r"\n(sample_time) = \[.*": r"\n\1 = [1, 30]",
    r"\n(hold|early|stopping|paper_like_fast|lbnl) = .*": "",
}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Return a function that runs a study of the repository made small, once, in place of ``report.results``."""
    folder = tmp_path_factory.mktemp("studies")

    def small(name):
        text = (STUDIES / f"{name}.toml").read_text()
        for long, short in (SHORT | FEW_RULES if name.startswith("learning") else SHORT).items():
            text = re.sub(long, short, text)
        (folder / f"{name}.toml").write_text(text)
        return fc.run_study(folder / f"{name}.toml", folder / name).load()

    return small


@pytest.fixture
def written(monkeypatch, tmp_path):
    """Have tables written elsewhere; return a function that reads one: title, then rows of cells, head first."""
    monkeypatch.setattr(report, "TABLES", tmp_path / "tables")
    monkeypatch.setattr(report, "PAGES", tmp_path / "docs")

    def written(name):
        title, table = (tmp_path / "tables" / f"{name}.md").read_text().split("\n\n")
        rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
        assert set(rows.pop(1)) == {"---"}
        assert len({len(row) for row in rows}) == 1
        return title.strip("*"), rows

    return written


def median_low(values):
    return statistics.median_low([math.inf if math.isnan(v) else v for v in np.asarray(values).ravel()])


# ------------------------------------------------------------------------------------ learning: numbers and choices


@pytest.mark.parametrize(("k", "n"), [(0, 10), (3, 10), (10, 10), (16, 100)])
def test_a_share_has_the_interval_of_clopper_and_pearson(k, n):
    exact = stats.binomtest(k, n).proportion_ci(0.95, method="exact")
    assert (
        learning.share_with_interval(k / n, n)
        == f"{100 * k / n:.0f} % ({100 * exact.low:.0f} to {100 * exact.high:.0f})"
    )


def learners(**metrics):
    """Learners of 10 % backlash over days and starts: final size, hours until reached and confirmed."""
    dims = ("day", "backlash_estimate")
    ds = xr.Dataset({name: (dims, np.array(values, dtype=float)) for name, values in metrics.items()})
    return ds.assign_coords(backlash=0.1, day=range(ds.sizes["day"]))


def test_failures_errors_and_censored_times_are_counted_one_by_one():
    ds = learners(
        estimate_final=[[0.10, 0.12], [0.08, 0.0799], [0.121, np.nan], [0.11, 0.02]],
        learn_time_reached=3600 * np.array([[1.0, 2.0], [3.0, np.nan], [0.5, np.nan], [1.5, 1.0]]),
        learn_time_confirmed=3600 * np.array([[1.0, 2.0], [np.nan, np.nan], [0.5, np.nan], [np.nan, 1.0]]),
    )
    found = {n: float(v) for n, v in learning.judged(ds, ["day", "backlash_estimate"]).items()}
    assert (found["low"], found["high"], found["failed"]) == (2 / 8, 1 / 8, 4 / 8)
    assert found["never"] == 4 / 8
    assert found["reached"] == median_low(ds.learn_time_reached) / 3600 == 1.5
    assert found["confirmed"] == median_low(ds.learn_time_confirmed) / 3600 == 2.0
    by_day = learning.judged(ds, ["backlash_estimate"]).confirmed
    assert by_day.values.tolist() == [1.0, np.inf, 0.5, 1.0]


def test_the_interval_of_a_median_draws_whole_days():
    of_day = np.random.default_rng(3).normal(1.0, 0.2, 60)
    learner = xr.DataArray(np.repeat(of_day[:, None], 8, axis=1), dims=("day", "backlash"))
    middle, low, high = learning.median_with_interval(learner)
    assert middle == statistics.median_low(of_day)
    days = stats.bootstrap((of_day,), np.median, method="percentile", rng=1).confidence_interval
    np.testing.assert_allclose((low, high), days, atol=0.02)
    never = learner.where(learner < np.median(of_day) - 0.1, np.inf)
    assert learning.words(never, "{:.1f}") == f"> {learning.HOURS} (> {learning.HOURS} to > {learning.HOURS})"


def choices(**metrics):
    """Choices that differ in the rule only."""
    ds = xr.Dataset({name: ("rule", np.array(values, dtype=float)) for name, values in metrics.items()})
    others = {dim: [0.01] for dim in learning.CHOICE[1:]}
    return ds.assign_coords(rule=list("abcd")).expand_dims(others)


@pytest.mark.parametrize(
    ("failed", "confirmed", "error", "best"),
    [
        ((0.2, 0.05, 0.0, 0.0), (1.0, 2.0, 3.0, 4.0), (0, 0, 0, 0), "b"),
        ((0.0, 0.0, 0.0, 0.0), (np.inf, 2.0, 2.0, 4.0), (0, 0.2, 0.1, 0), "c"),
        ((0.3, 0.2, 0.1, 0.4), (1.0, 2.0, 9.0, 0.5), (0, 0, 0, 0), "c"),
    ],
)
def test_the_choice_is_the_fastest_safe_one_or_the_safest(failed, confirmed, error, best):
    assert learning.chosen(choices(failed=failed, confirmed=confirmed, error=error))["rule"] == best


@pytest.mark.parametrize(("low", "high", "arrow"), [(0, 0, ""), (0.4, 0, "↓"), (0.1, 0.4, "↑"), (0.2, 0.3, "↕")])
def test_arrows_show_early_stops_and_runaways(low, high, arrow):
    assert learning_maps.way(low, high) == arrow


# -------------------------------------------------------------------------------------------- learning: the script


@pytest.fixture
def quick(monkeypatch, small):
    """The learning script on small studies and few fresh days."""
    monkeypatch.setattr(learning, "results", small)
    monkeypatch.setattr(learning, "FRESH_DAYS", range(301, 303))
    monkeypatch.setattr(learning, "HOURS", 2)
    return small("learning_step")


def test_learning_writes_what_it_found_and_draws_its_figures(quick, written, monkeypatch, tmp_path):
    monkeypatch.setattr(learning, "HERE", tmp_path / "studies")
    learning.main()
    _, (head, *ship) = written("learning_choice")
    assert [row[:2] for row in ship] == [["paper_like", "0"], ["paper_like", "0.1"], ["g36", "0"], ["g36", "0.1"],
                                         ["all", "all"]]  # fmt: skip
    for row in ship:
        failed = float(row[head.index("2 fresh days")].split(" %")[0])
        assert (row[head.index("safe?")] == "yes") == (failed <= 5.0)
        assert row[head.index("safe?")] in ("yes", "**none is safe**; the best:")
    assert {row[head.index("safe?")] for row in ship if row[1] == "0.1"} == {"**none is safe**; the best:"}
    title, cost = written("learning_cost")
    assert title == "What it does on the 2 fresh days: medians"
    assert [row[:2] for row in cost[1:]] == [row[:2] for row in ship]
    assert len(written("learning_failures")[1]) == len(ship)
    assert [row[0] for row in written("learning_quiet")[1][1:]] == ["paper_like", "g36"]
    figures = tmp_path / "results" / "learning_step" / "figures"
    assert {p.name for p in figures.iterdir()} == {
        "learning_front.png", "learning_front_error.png", "learning_settings.png", "learning_failures.png"
    }  # fmt: skip


def test_the_front_is_the_least_that_can_be_had_by_a_time(quick):
    of = learning.judged(quick)
    figure = learning_maps.front(of, "error", "error", 50.0, 16, "")
    panel = figure.axes[0]
    cell = of.isel(tuning=0, noise_std=0)
    drawn = 0
    for line in panel.get_lines():
        at = cell.sel(rule=line.get_label())
        pairs = [(t, e) for t, e in zip(at.confirmed.values.ravel(), at.error.values.ravel(), strict=True) if t < 99]
        for time, least in line.get_xydata():
            assert least == pytest.approx(100 * min(e for t, e in pairs if t <= time))
            drawn += 1
    assert drawn > 1


def test_a_choice_is_tried_on_fresh_days_against_the_plain_pi_and_a_known_backlash(quick):
    loop = {"tuning": "g36", "noise_std": 0.1}
    settings = {"learning_step": 0.028, "learning_interval": 900, "learning_ratio": 1.5, "buffer": 0.01}
    day = fc.paper_day(hours=2, seed=[301, 302])
    found = learning.tried(quick, {"rule": "growing"} | settings, loop, day)
    found = found.sel(backlash=0.12, backlash_estimate=0.014)
    real = fc.Loop.preset("g36").assign(backlash=0.12, noise_std=0.1)
    rule = settings | {
        "learning_min_switches": 1, "learning_max_reference": 0.4, "learning_early_trip": 1, "learning_growth": 2,
        "learning_shrink": 0.5, "backlash_estimate": 0.014,
    }  # fmt: skip
    learner, plain = fc.simulate(real.assign(**rule), day), fc.simulate(real, day)
    known = fc.simulate(real.assign(backlash_estimate=0.12, buffer=0.01), day)
    np.testing.assert_array_equal(found.estimate_final, learner.estimate_final)
    np.testing.assert_allclose(found.rmse, learner.rmse / plain.rmse - 1)
    np.testing.assert_allclose(found.rmse_known, learner.rmse / known.rmse - 1)
    np.testing.assert_allclose(found.travel, learner.motor_travel / plain.motor_travel)
    np.testing.assert_array_equal(found.plain_switches, plain.switch_frequency)


def test_the_failure_map_shows_the_share_of_learners_in_every_cell(small):
    ds = small("learning_failures")
    figure = learning_maps.failure_map(learning.judged(ds, ["backlash", "day"]), 0.05, "")
    (panel,) = (a for a in figure.axes if a.get_title() == "g36")  # of the first rule, without a buffer
    texts = {text.get_position(): text for text in panel.texts}
    cell = ds.isel(buffer=0).sel(rule="literal", tuning="g36")
    for x, sample_time in enumerate(ds.sample_time.values):
        for y, noise in enumerate(ds.noise_std.values):
            at = cell.sel(sample_time=sample_time, noise_std=noise)
            learned = [float(final / size) for size, row in zip(ds.backlash.values, at.estimate_final.transpose(
                "backlash", "day").values, strict=True) for final in row]  # fmt: skip
            low, high = sum(v < 0.8 for v in learned), sum(v > 1.2 for v in learned)
            failed = (low + high) / len(learned)
            assert re.match(r"\d+", texts[x, y].get_text())[0] == f"{100 * failed:.0f}"
            assert texts[x, y].get_weight() == ("bold" if failed <= 0.05 else "normal")


# ------------------------------------------------------------------------------------------------ the other scripts


def test_population_writes_what_plain_python_finds(small, written, monkeypatch):
    monkeypatch.setattr(population, "results", small)
    population.main()
    ds = small("valve_population")
    names = [str(name) for name in ds.controller.values]
    rmse = {name: [float(x) for x in ds.rmse.sel(controller=name)] for name in names}
    title, (head, *table) = written("population")
    assert title == "A population of 16 valves and loops (0 of 128 days failed)"
    assert [row[0] for row in table] == names[1:]
    for row in table:
        pairs = list(zip(rmse[row[0]], rmse["pi"], strict=True))
        assert row[1].split(" ")[0] == f"{statistics.mean(a - b for a, b in pairs):+.4f}"
        changes = [a / b - 1 for a, b in pairs]
        assert row[2].split(", ")[1] == f"{100 * statistics.median(changes):+.0f} %"
        assert row[head.index("lower RMSE in")] == f"{100 * sum(c < 0 for c in changes) / len(changes):.0f} %"
    _, (_, *ended) = written("population_learners")
    for name, valves, _, within in ended:
        assert sum(int(n.replace(",", "")) for n in re.findall(r"[\d,]*\d", valves)) == 16
        learned = [float(x) for x in (ds.estimate_final / ds.backlash).sel(controller=name)]
        assert within == f"{100 * sum(0.8 <= x <= 1.2 for x in learned) / 16:.0f} %"
    _, (_, *indices) = written("sensitivity")
    assert len(indices) == 11


def test_answers_write_what_plain_python_finds(small, written, monkeypatch):
    monkeypatch.setattr(answers, "results", small)
    answers.main()
    ds = small("robustness")
    title, (_, *table) = written("robustness")
    assert title.endswith("11,160 days")
    for row in table:
        pairs = zip(ds.rmse.sel(estimate_ratio=float(row[0])).values.ravel(),
                    ds.rmse.sel(estimate_ratio=0.0).values.ravel(), strict=True)  # fmt: skip
        changes = [a / b - 1 for a, b in pairs]
        assert row[1] == f"{100 * statistics.median(changes):+.0f} %"
        assert row[3] == f"{sum(c < 0 for c in changes) / len(changes):.1%}"
    _, (_, *table) = written("robustness_by_backlash")
    for row in table:
        at = ds.sel(backlash=float(row[0].rstrip("%")) / 100).rmse
        pairs = zip(at.sel(estimate_ratio=0.95).values, at.sel(estimate_ratio=0.0).values, strict=True)
        assert row[2] == f"{100 * statistics.median(a / b - 1 for a, b in pairs):+.0f} %"
    ds = small("paper_like")
    title, (_, *table) = written("paper_like")
    assert title.endswith("median of 2 days")
    of_sixty = ds.sel(backlash=0.07, estimate_ratio=0.6).rmse
    assert ["estimate 60%", f"{statistics.mean(map(float, of_sixty)):.3f}"] in [row[:2] for row in table]
    ds = small("learner")
    _, (_, *table) = written("learner")
    for rule, loop, _, _, confirmed, after, *_ in table:
        times = ds.learn_time_confirmed.sel(rule=rule, loop=loop).values
        n = sum(not math.isnan(t) for t in times)
        assert confirmed == f"{n} of 2"
        assert (after == "—") == (n < 2)


def test_times_that_never_came_count_as_later_than_all_others():
    assert answers.hours(xr.DataArray([3600.0, np.nan, 7200.0])) == "2.00 h"
    assert answers.hours(xr.DataArray([3600.0, np.nan, np.nan])) == "—"


def test_conditions_count_what_plain_python_counts(written, monkeypatch):
    ds = conditions.tunings(n=2)
    counted = [cells for _, *cells in conditions.hunting_rows(ds)]
    for column, plant in enumerate(conditions.PLANTS):
        *classes, alone = [[int(n) for n in re.findall(r"\d+", row[column])] for row in counted]
        assert sum(n for _, n in classes) + alone[0] == ds.sel(plant=plant).overshoot.size == 16
        hunt = zip(ds.hunts.sel(plant=plant).values.ravel(), ds.alone.sel(plant=plant).values.ravel(), strict=True)
        assert sum(k for k, _ in classes) == sum(bool(h and not a) for h, a in hunt)
    above = conditions.overestimates(n=2)
    for row, Ts in zip(conditions.overestimate_rows(above), above.sample_time.values, strict=True):
        rmse = above.rmse_settled.sel(sample_time=Ts)
        exact, larger = (rmse.sel(estimate_ratio=r).values.ravel().tolist() for r in (1.0, 1.5))
        rises = [b > a for a, b in zip(exact, larger, strict=True)]
        assert row[-1] == f"{sum(rises) / 4:.0%}"
    end = conditions.learned_when_quiet(n=2)
    lines = ((p, b) for p in conditions.PLANTS for b in end.buffer.values)
    for row, (plant, buffer) in zip(conditions.quiet_rows(end), lines, strict=True):
        sizes = end.sel(plant=plant, buffer=buffer).values.ravel().tolist()
        found = sum(0.063 - 1e-4 <= x <= 0.077 + 1e-4 for x in sizes) / len(sizes)
        assert row[2:] == [f"{found:.0%}", f"{sum(x > 0.2 for x in sizes) / len(sizes):.0%}"]
    for name, few in (("tunings", ds), ("overestimates", above), ("learned_when_quiet", end)):
        monkeypatch.setattr(conditions, name, lambda few=few: few)
    conditions.main()
    mild = [float(x) < 0.2 for x in ds.overshoot.values.ravel()]
    alone, hunts = (ds[name].values.ravel().tolist() for name in ("alone", "hunts"))
    counted = [bool(h) for m, a, h in zip(mild, alone, hunts, strict=True) if m and not a]
    title, _ = written("conditions_hunting")
    assert title.endswith(f"of the {len(counted)} with less than 20 % overshoot {sum(counted)} hunt")
    assert [row[0] for row in written("conditions_overestimates")[1][1:]] == ["1 s", "5 s", "15 s", "30 s", "60 s"]
    assert len(written("conditions_quiet")[1]) == 1 + 2 * 3


# ------------------------------------------------------------------------------------------------ tables and pages


def test_a_table_is_written_into_the_pages_that_quote_it(written, tmp_path):
    page = tmp_path / "docs" / "page.md"
    page.parent.mkdir()
    page.write_text(
        "before\n\n<!-- table one -->\nold\n<!-- end one -->\n\n<!-- table two -->\nkept\n<!-- end two -->\n"
    )
    for _ in range(2):
        report.write_table("one", "A \\title", ["a", "b"], [["1", "2"]])
    assert written("one") == ("A \\title", [["a", "b"], ["1", "2"]])
    table = "**A \\title**\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n"
    assert page.read_text() == (
        f"before\n\n<!-- table one -->\n\n{table}\n<!-- end one -->\n\n<!-- table two -->\nkept\n<!-- end two -->\n"
    )


def test_every_table_is_quoted_by_exactly_one_page_as_it_is():
    quoted = []
    for page in sorted(PAGES.glob("*.md")):
        text = page.read_text()
        for name in re.findall("<!-- table (.*) -->", text):
            table = (STUDIES / "tables" / f"{name}.md").read_text()
            assert report.quoting(text, name, table) == text, f"{page.name} quotes an old {name}: run its script"
            assert f"<!-- end {name} -->" in text
            quoted.append(name)
    assert sorted(quoted) == sorted(path.stem for path in (STUDIES / "tables").iterdir())


def test_the_scorecard_quotes_the_first_table_of_the_paper_s(written, monkeypatch, tmp_path):
    def regenerate(folder, *, quick):
        folder.mkdir(parents=True)
        (folder / "scorecard.md").write_text(
            "# Title\n\nwords\n\n| a | b |\n| --- | --- |\n| 1 | 2 |\n\nmore\n\n| c |\n| --- |\n| 3 |\n"
        )

    monkeypatch.setattr(scorecard, "HERE", tmp_path / "studies")
    monkeypatch.setattr(scorecard, "regenerate", regenerate)
    scorecard.main()
    assert written("scorecard")[1] == [["a", "b"], ["1", "2"]]
