"""The power fails at any moment: what was reported as finished is there, and the same command gives the same results.

A whole command is recorded, call by call; then its calls are replayed on a model of a disk that keeps only what was
synced, and the folders that may be left are looked at and run again.
"""

import shutil
import warnings
from contextlib import suppress
from itertools import accumulate

import numpy as np
import pytest
from helpers import power_loss
from helpers.calls import Call, read_records
from helpers.studies import SITUATIONS, TRACED, golden, larger, unfinished, write_study

from fastcoil.base.errors import FastcoilError
from fastcoil.model.metric_table import METRICS, STATUS_OK
from fastcoil.study import maintenance
from fastcoil.study import run as runner
from fastcoil.study.folder.results import open_study

pytestmark = pytest.mark.kernel


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """The results of the largest study."""
    out = tmp_path_factory.mktemp("expected") / "out"
    return runner.execute(write_study(larger(TRACED), out), out, n_jobs=1).results.load()


class Recorded:
    """A command, call by call, on a disk of its own."""

    def __init__(self, watched, tmp_path, situation, figures=False):
        self.text, prepare = SITUATIONS[situation]
        self.place, self.figures = tmp_path / "disk", figures
        self.place.mkdir()
        out, record = self.place / "out", tmp_path / "record"
        prepare(out)
        (self.place / "study.toml").unlink(missing_ok=True)
        self.before = [] if not out.exists() else [power_loss.Disk.holding(self.place)]
        self.n_before = n_finished(out)
        study = tmp_path / "study.toml"
        study.write_text(self.text)
        options = ["-j", "1", "--extend"] + ["--no-figures"] * (not figures)

        def command(out, **order):
            # the server writes a copy of the study next to the folder: not on the disk
            words = ["run", str(study), "-o", str(out), *options]
            code, _, said = watched(self.text, tmp_path / "out", arguments=words, **order)
            assert code == 0, said

        self.command = command
        shutil.copytree(self.place, tmp_path / "start")
        command(out, calls={"folder": str(self.place), "record": str(record)})
        self.records = list(read_records(record))
        self.start = tmp_path / "start"
        reported = accumulate((int(r.first) if r.call is Call.MARK else 0 for r in self.records), initial=0)
        self.reported = [self.n_before + n for n in reported][1:]

    def disk(self, n):
        """The disk after n + 1 calls."""
        disk = power_loss.Disk.holding(self.start)
        disk.top = self.place
        for record in self.records[: n + 1]:
            disk.do(record)
        return disk


def n_finished(out):
    """Scenarios that are finished in a folder."""
    try:
        return int((open_study(out)["status"] == STATUS_OK).sum()) if out.exists() else 0
    except FastcoilError:
        return 0


def figures(out):
    """The figures of a study."""
    return {p.name: p.read_bytes() for p in (out / "figures").iterdir()}


def check_sound(out, expected):
    """Looking at a folder gives a sentence or true numbers.  Returns how many scenarios are finished in it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # the words of an error are a sentence; no other kind of error comes
        for look in (maintenance.status, maintenance.verify):
            with suppress(FastcoilError):
                look(out)
        try:
            ds = open_study(out).load()
        except FastcoilError:
            return 0
    wanted = expected.sel({d: ds[d] for d in ("backlash", "estimate_ratio", "day") if d in ds.dims})
    wanted = wanted.transpose(*ds["status"].dims, ...)
    ok = ds["status"].values == STATUS_OK
    for name in (*METRICS, *(t for t in ("T_sup", "mode") if t in ds)):
        np.testing.assert_array_equal(ds[name].values[ok], wanted[name].values[ok], err_msg=name)
    return int(ok.sum())


def lose_power(recorded, n, found, tmp_path, expected):
    """Lose power after the n-th call: nothing that was reported is run again, and the results are the same."""
    place = tmp_path / "found"
    shutil.rmtree(place, ignore_errors=True)
    power_loss.lay_out(found, place)
    out, reported = place / "out", recorded.reported[n]
    finished = check_sound(out, expected) if out.exists() else 0
    # while a study is extended, the old text may be there with the new manifest
    assert finished >= reported or (recorded.n_before and n < len(recorded.records) - 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing is found damaged
        again = runner.execute(write_study(recorded.text, out), out, n_jobs=1, extend=True)
    assert again.results.attrs["content_sha256"] == golden(recorded.text)
    assert again.results["status"].size - again.n_run >= reported
    if recorded.figures:
        recorded.command(out)
        assert figures(out) == figures(recorded.place / "out")
    assert maintenance.verify(out) == []
    assert unfinished(out) == []
    assert not (out / "shards").exists()
    assert not (out / "quarantine").exists()


def replay(recorded, ways, tmp_path, expected):
    """Lose power in some ways, each at some moments; try each folder that may be left.  Returns how many these were."""
    kept = recorded.disk(len(recorded.records)).left(power_loss.everything)
    assert kept == power_loss.Disk.holding(recorded.place).left(power_loss.nothing)  # the record is true
    seen: list[tuple[dict, int]] = []
    for keep, moments in ways:
        for n in moments:
            found, reported = recorded.disk(n).left(keep), recorded.reported[n]
            if any(same == found and known >= reported for same, known in seen):
                continue
            seen.append((found, reported))
            try:
                lose_power(recorded, n, found, tmp_path, expected)
            except BaseException as error:
                error.add_note(f"after call {n}, {recorded.records[n]._replace(second=b'')!r:.300}")
                error.add_note(f"{ {name: data if data is None else len(data) for name, data in found.items()} }")
                raise
    return len(seen)


def test_after_a_power_loss_nothing_reported_is_lost(watched, tmp_path, expected):
    recorded = Recorded(watched, tmp_path, "traced")
    named = [k for k, r in enumerate(recorded.records) if r.call is Call.RENAME]
    ways = [
        (power_loss.nothing, [len(recorded.records) - 1, *named[3::6]]),
        (power_loss.only_names, [k - 1 for k in named[-1:]]),
        (power_loss.anything(1), named[1::5]),
    ]
    assert replay(recorded, ways, tmp_path, expected) > 3


@pytest.mark.full
@pytest.mark.parametrize("situation", SITUATIONS)
def test_after_a_power_loss_at_any_moment_nothing_reported_is_lost(watched, tmp_path, expected, situation):
    recorded = Recorded(watched, tmp_path, situation)
    moments = power_loss.moments(recorded.records)
    # from the last on: there most was reported
    ways = [(power_loss.nothing, moments[::-1]), (power_loss.only_names, moments[::-3])]
    ways += [(power_loss.anything(seed), moments[-1 - seed :: -5]) for seed in range(5)]
    assert replay(recorded, ways, tmp_path, expected) > 30


@pytest.mark.full
def test_after_a_power_loss_among_the_figures_all_of_them_are_drawn(watched, tmp_path, expected):
    recorded = Recorded(watched, tmp_path, "plain", figures=True)
    first = next(k for k, r in enumerate(recorded.records) if r.call is Call.MKDIR and r.path.endswith("/figures"))
    moments = [k for k in power_loss.moments(recorded.records) if k >= first]
    ways = [(power_loss.nothing, moments), (power_loss.only_names, moments[::2]), (power_loss.anything(1), moments)]
    assert replay(recorded, ways, tmp_path, expected) > 5
