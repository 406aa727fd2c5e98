"""The numbers in the answers of ``docs/hunting.md`` are those of its tables."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def text(name):
    """A table's title and its lines."""
    lines = (ROOT / "studies" / "hunting" / "tables" / f"{name}.md").read_text().splitlines()
    return lines[0].strip("*"), [line for line in lines if line.startswith("|")]


def table(name):
    """First cell of a row → its other cells."""
    _, (_, _, *rows) = text(name)
    parted = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|"))] for line in rows]
    return {first: cells for first, *cells in parted}


def like(rows, start):
    """The cells of the only row that begins so."""
    (found,) = [cells for first, cells in rows.items() if first.startswith(start)]
    return found


def answers():
    """What the page must say."""
    rules, practice = table("hunting_rules"), table("hunting_practice")
    margin, formula = like(rules, "margin of"), like(rules, "(kp K)")
    (name,) = [first for first in rules if first.startswith("(kp K)^")]
    power, delays = re.findall(r"\^([\d.]+) \(T \+ ([\d.]+) θ", name)[0]
    asked = [row for row in practice if row.startswith(f"Ti ≥ (kp K)^{power} (T + {delays} θ) / ")]
    safe = min(asked, key=lambda row: float(row.split("/ ")[1]))
    yield f"    {safe}\n"
    obey, hunt, broken, refused = practice[safe]
    yield f"{hunt} of the loops that obey hunt"
    yield f"and {broken} of those that do not; of the calm ones it forbids {refused}"
    limit = formula[0]
    yield f"With {limit} in place of {safe.split('/ ')[1]}"
    yield f"tells {formula[1]} of fresh loops right, {formula[2]} of those that hunt, {formula[3]} of those that do not"
    yield f"above {margin[0]} tells {margin[1]} right"
    cycle = like(rules, "`fc.limit_cycle`")
    yield f"the margin is right on {margin[4]}, the formula on {formula[4]}, `fc.limit_cycle` on {cycle[4]}"
    yield f"the curve of the valve, {cycle[1]}"
    for start, words in (("T / Ti", "T / Ti alone"), ("180°", "The phase margin"), ("1 / gain", "The gain margin"),
                         ("overshoot", "An overshoot"), ("kp K (T", "The plain product")):  # fmt: skip
        assert words in page_text()
        yield f"{like(rules, start)[1]}"
    for rule in ("Ti ≥ T", "Ti ≥ kp K (T + 2 θ)"):
        row = practice[rule] if rule in practice else like(practice, rule)
        yield f"{row[1]} of those who obey"
        yield f"forbids {row[3]} of the calm"
    cures = table("hunting_cures")
    half = cures["half of kp"]
    yield f"expects to hunt {half[0]} still do with half of their kp"
    yield f"With half of their kp {half[0]} still hunt"
    assert like(cures, "Ti by the formula")[-1].endswith("+0 %, +0 %")
    slow, by_rule, weak = (like(cures, start) for start in ("Ti at least T", "Ti by the formula", "kp by the formula"))
    yield f"Raise Ti to T: {slow[0]} still hunt"
    yield f"with Ti from the formula {by_rule[0]} still hunt, with kp from the formula {weak[0]}"
    sizes, (title, _) = table("hunting_backlash"), text("hunting_backlash")
    grows, changes = re.findall(r"to the power (-?[\d.]+ \(-?[\d.]+ to -?[\d.]+\))", title)
    yield f"to the power {grows} of the backlash"
    yield f"to the power {changes}"
    yield f"{sizes['0%'][3]} of the loops are calm without a gap and cycle with one of 1 %"
    yield f"from 1 % to 15 % only {sizes['15%'][2]} more begin to"
    yield f"{sizes['7%'][5].split(' (')[0]} X K"
    warned = re.findall(r"\) (\d+ % \(\d+ to \d+\)) cycle with one of 1 %", title)[0]
    yield f"of its false alarms {warned} cycle with a gap of 1 %"
    by_size = table("hunting_by_backlash")
    yield f"Of loops without backlash {by_size['0%'][0]} hunt"
    yield f"The margin tells {by_size['0%'][1]} of them right"
    yield f"With 1 % of backlash the margin is right on {by_size['1%'][1]}"
    yield f"knows its size: {by_size['1%'][5]}"
    title, _ = text("hunting_start")
    yield re.findall(r"cycle after any kick (\d+ % \(\d+ to \d+\))", title)[0]
    one = table("hunting_one_step")
    yield f"at the smallest opening foretells {one['at the smallest opening'][1]} of what hunts at the other conditions"
    yield f"at the largest {one['at the largest opening'][1]}"
    yield f"each off by 20 % it is {one['where it works, K, T and θ off by 20%'][1]}"
    parts = table("hunting_parts")
    for change in ("sensor lag 5 s", "sensor lag 60 s", "sample time 30 s", "stroke 300 s", "ti × 2", "noise 0.05 K"):
        yield parts[change][1]
    yield parts["stroke 300 s"][2]
    cost = table("hunting_cost")
    assert all(cell in ("0", "-0 % (-0 to +0)") for cell in like(cost, "(kp K)^")[:4])
    days = table("hunting_days")
    worst = min(days, key=lambda kind: float(days[kind][3].split(" %")[0]))
    yield f"On days on which air, water and set-point move, {worst} ones are the worst: {days[worst][3]}"
    presets = table("hunting_presets")
    yield f"the margin is right for {presets['`paper_like`'][1]} of the gains"
    yield f"on the map of `lbnl` it misses {presets['`lbnl`'][4].split(', ')[1]} of 1,156 tunings"


def page_text():
    return " ".join((ROOT / "docs" / "hunting.md").read_text().split())


def test_the_answers_say_what_the_tables_say():
    page = re.sub(r"<!-- table .*?<!-- end \w+ -->", "", (ROOT / "docs" / "hunting.md").read_text(), flags=re.DOTALL)
    page = " ".join(page.split())
    assert [sentence for sentence in answers() if " ".join(sentence.split()) not in page] == []
