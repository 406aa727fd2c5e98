"""Whatever is done to a study's folder, in whatever order: run to its end, it holds what an undisturbed run finds."""

import os
import shutil
import tempfile
import warnings
from pathlib import Path

import netCDF4
import pytest
from helpers.studies import (
    DAYS,
    PLAIN_STUDY,
    TRACED_STUDY,
    folder_contents,
    run,
    run_until_interrupted,
    shard_files,
    undisturbed_hash,
)
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from fastcoil.study import maintenance

BACKLASH = ("0.02, 0.07", "0.02, 0.07, 0.1", "0.01, 0.02, 0.07, 0.1")


def study_text(text, values, replicates):
    """A study, larger with each number."""
    text = text.replace("0.02, 0.07", BACKLASH[values])
    return text.replace("[run]", f"[run]\nreplicates = {replicates}") if replicates > 1 else text


class AStudyInItsFolder(RuleBasedStateMachine):
    """Runs, interruptions, damage and extensions of one study."""

    def __init__(self) -> None:
        super().__init__()
        self.root = Path(tempfile.mkdtemp())
        self.folder = self.root / "out"
        self.values, self.replicates = 0, 1
        self.complete = False
        self.recorded: str | None = None

    @initialize(base=st.sampled_from([PLAIN_STUDY, TRACED_STUDY]))
    def choose(self, base):
        self.base = base

    @property
    def text(self):
        return study_text(self.base, self.values, self.replicates)

    @rule()
    def run(self):
        self.without_damage_warnings(lambda: run(self.text, self.folder, extend=True))
        self.recorded, self.complete = self.text, True

    @precondition(lambda self: not self.complete)
    @rule(k=st.integers(1, DAYS))
    def run_until_interrupted(self, k):
        try:
            self.without_damage_warnings(lambda: run_until_interrupted(self.text, self.folder, k, extend=True))
        except AssertionError:  # fewer shards were left
            self.complete = True
        self.recorded = self.text

    def without_damage_warnings(self, act):
        """Warnings tell of the damage that was done here."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*moved to quarantine")
            act()

    @precondition(lambda self: shard_files(self.folder))
    @rule(data=st.data())
    def damage_a_shard(self, data):
        path = data.draw(st.sampled_from(shard_files(self.folder)))
        image = path.read_bytes()
        kind = data.draw(st.sampled_from(["cut", "anywhere", "value"]))
        if kind == "value" and path.suffix == ".nc" and len(image) > 100:
            # one that the library reads without a complaint
            at = image.find(self.rmse(path))
            if at > 0:
                path.write_bytes(image[:at] + bytes([image[at] ^ 1]) + image[at + 1 :])
        elif kind == "anywhere" and image:
            at = data.draw(st.integers(0, len(image) - 1))
            path.write_bytes(image[:at] + bytes([image[at] ^ 1]) + image[at + 1 :])
        else:
            path.write_bytes(image[: data.draw(st.integers(0, len(image)))])

    @staticmethod
    def rmse(path):
        try:
            with netCDF4.Dataset(path.name, memory=path.read_bytes()) as file:
                return bytes(file["rmse"][:].data)
        except (OSError, RuntimeError, AttributeError):  # damaged before
            return b"not there"

    @precondition(lambda self: shard_files(self.folder))
    @rule(data=st.data())
    def delete_a_shard(self, data):
        data.draw(st.sampled_from(shard_files(self.folder))).unlink()

    @precondition(lambda self: (self.folder / "shards").is_dir())
    @rule(name=st.sampled_from(["notes.txt", "000000000-" + 32 * "0" + ".nc", ".half.nc.1.tmp", "a.nc"]))
    def leave_a_file(self, name):
        (self.folder / "shards" / name).write_text("foreign")

    @precondition(lambda self: self.recorded == self.text)
    @precondition(lambda self: self.complete or not (self.folder / "results.nc").exists())
    @rule(name=st.sampled_from(["run.json", "study.toml"]))
    def lose_a_file(self, name):
        """Not while the results are still those of a smaller study: without run.json they are refused."""
        (self.folder / name).unlink(missing_ok=True)
        # the extension of an unfinished study needs both files: first the same study again
        self.run()

    @precondition(lambda self: (self.folder / "run.json").exists())
    @rule()
    def inspect_it(self):
        before = {name: data for name, (data, _) in folder_contents(self.folder).items()}
        maintenance.verify(self.folder)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*would be computed again")
            assert maintenance.status(self.folder)
        assert {name: data for name, (data, _) in folder_contents(self.folder).items()} == before

    @precondition(lambda self: self.complete and self.values < len(BACKLASH) - 1)
    @rule()
    def add_a_value(self):
        self.values += 1
        self.complete = False

    @precondition(lambda self: self.complete and self.replicates < 2)
    @rule()
    def add_a_replicate(self):
        self.replicates += 1
        self.complete = False

    @invariant()
    def is_sound_when_complete(self):
        if self.complete:
            assert maintenance.verify(self.folder) == []
            assert run(self.text, self.folder) == undisturbed_hash(self.text)

    def teardown(self):
        try:
            if not self.complete:  # the invariant has just looked at one that is
                self.run()
                self.is_sound_when_complete()
        finally:
            shutil.rmtree(self.root)


FULL = bool(os.environ.get("FASTCOIL_FULL"))
TestAStudyInItsFolder = pytest.mark.kernel(AStudyInItsFolder.TestCase)
TestAStudyInItsFolder.settings = settings(
    max_examples=100 if FULL else 1,
    stateful_step_count=20 if FULL else 8,
    phases=[Phase.generate],  # to shrink takes minutes, and a failing sequence is short enough to read
)
