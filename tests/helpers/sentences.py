"""The snapshot of the sentences that users read: tests/sentences.tsv, one line a sentence, by test.

Tests assert what a message is about (``error.field``, ``error.code``) and, through this file, that its words are the
reviewed ones.  After a rewording, ``make reword`` runs the suite and rewrites the snapshot; commit it on its own.
"""

import os
import re
from collections import Counter
from functools import cache
from pathlib import Path

SNAPSHOT = Path(__file__).parents[1] / "sentences.tsv"
CURE = "run `make reword` (or the test with FASTCOIL_REWORD=1) and review the diff of tests/sentences.tsv"
_TEMPORARY = re.compile(r"[^\s'\"]*pytest-of-[^/\\]+[/\\]pytest-\d+[/\\](?:popen-gw\d+[/\\])?[^/\\\s'\",:;]*")
_ESCAPES = str.maketrans({"\\": r"\\", "\n": r"\n", "\r": r"\r", "\t": r"\t"})
_n_seen = Counter()  # by test, sentences of the call that is running


def is_rewording():
    return bool(os.environ.get("FASTCOIL_REWORD"))


def assert_worded(*sentences):
    """Assert that the next sentences of this test stand in the snapshot; paths of temporary folders become ``TMP``."""
    test, _, phase = os.environ["PYTEST_CURRENT_TEST"].rpartition(" ")
    for sentence in sentences:
        words = _TEMPORARY.sub("TMP", str(sentence)).translate(_ESCAPES)
        if is_rewording():
            _append(test, words)
            continue
        reviewed = read_snapshot().get(test, [])
        k = _n_seen[test, phase]
        _n_seen[test, phase] += 1
        assert k < len(reviewed), f"this test has no sentence {k + 1} in the snapshot, {CURE}:\n{words}"
        assert words == reviewed[k], f"not as reviewed, {CURE}"


@cache
def read_snapshot():
    """Sentences by test."""
    return _read(SNAPSHOT)


def _read(path):
    sentences = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").split("\n")[:-1]:
            test, words = line.split("\t")
            sentences.setdefault(test, []).append(words)
    return sentences


def _append(test, words):
    with Path(os.environ["FASTCOIL_REWORD_FILE"]).open("a", encoding="utf-8", newline="\n") as file:
        file.write(f"{test}\t{words}\n")  # one write: lines of several processes do not mix


def rewrite_snapshot(path):
    """Replace the sentences of the tests that ran by those in ``path``; drop tests that no longer exist."""
    merged = _read(SNAPSHOT) | _read(path)
    lines = [f"{test}\t{words}\n" for test in sorted(merged) if _exists(test) for words in merged[test]]
    SNAPSHOT.write_text("".join(lines), encoding="utf-8", newline="\n")


@cache
def _source(path):
    file = SNAPSHOT.parents[1] / path
    return file.read_text(encoding="utf-8") if file.exists() else ""


def _exists(test):
    path, _, name = test.partition("::")
    return f"def {name.split('[')[0].split('::')[-1]}(" in _source(path)


def stale_tests():
    """Tests of the snapshot that no longer exist."""
    return [test for test in read_snapshot() if not _exists(test)]
