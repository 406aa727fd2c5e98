"""What the page on tuning says in words stands in its tables."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = " ".join((ROOT / "docs" / "findings" / "tuning.md").read_text().split())


def cells(table, *start):
    """Column → cell of the row of a table that begins so."""
    text = (ROOT / "studies" / "tuning" / "tables" / f"{table}.md").read_text()
    head, _, *rows = ([c.strip() for c in line.strip("|").split("|")] for line in text.splitlines() if line[:1] == "|")
    (found,) = [row for row in rows if tuple(row[: len(start)]) == start]
    return dict(zip(head, found, strict=True))


def change(loop, tuning):
    """The change of the 95 % quantile of the error, as the page says it: 73 for -73 %."""
    return cells("tuning", loop, tuning)["change"].split(" %")[0].lstrip("-")


def test_what_holds():
    names = ("`paper_like`", "`paper_like_fast`", "`g36`", "`lbnl`, heating")
    found = [change(name, "tuned PI") for name in names]
    assert "by {} % on `paper_like`, {} % on `paper_like_fast`, {} % on `g36`, {} % in heating".format(*found) in PAGE
    assert all(cells("tuning", name, "tuned PI")["hunting"].startswith("0 %") for name in names)
    assert f"On `lbnl`, where travel is short, it is {change('`lbnl`', 'tuned PI')} %" in PAGE
    simc = [change(name, "SIMC") for name in names]
    assert "**SIMC comes near**: {}, {}, {} and {} %".format(*simc) in PAGE
    with_inverse, plain = (cells("tuning", "`paper_like`", name) for name in ("tuned 95 % inverse", "tuned PI"))
    error = "RMSE, 95 % quantile, K"
    assert (
        f"{with_inverse[error][:5]} K instead of {plain[error][:5]} K on `paper_like`, at four times the travel" in PAGE
    )
    travels = [float(row["motor travel, 95 % quantile"].split(" ")[0]) for row in (with_inverse, plain)]
    assert 3.5 < travels[0] / travels[1] < 4.5


def test_what_fails():
    change_of = "change of RMSE (95 %)"
    worst = cells("tuning_failures", "`paper_like`", "constant", "best PI of 7 %", "X = 0")
    assert worst["hunting (95 %)"].startswith("100 %")
    times = 1 + float(worst[change_of].split(" %")[0]) / 100
    assert f"its error {times:.0f} times that of the preset" in PAGE
    quiet = cells("tuning_failures", "`paper_like`", "constant", "tuned PI", "X = 0")[change_of]
    heating = cells("tuning_failures", "`lbnl`, heating", "heating", "tuned PI", "X = 0")[change_of]
    said = f"{quiet[1:3]} % more error on `paper_like` with a constant set-point, {heating[1:3]} % more in heating"
    assert said in PAGE
    travel = "motor travel, 95 % quantile"
    strokes = cells("tuning", "`lbnl`", "preset")[travel].split(" ")[0]
    stepped = cells("tuning_failures", "`lbnl`", "stepped", "tuned 95 % inverse", "all")[change_of]
    assert f"moves its motor {strokes} strokes a day" in PAGE
    assert f"has {stepped[1:3]} % more error on days with set-point steps" in PAGE
    names = ("tuned 95 % inverse", "preset")
    ours, preset = (cells("tuning", "`lbnl`, heating", name)[travel].split(" ")[0] for name in names)
    assert f"In heating the tuned inverse travels {ours} strokes, the preset {preset}." in PAGE
    assert float(ours) > float(preset)
