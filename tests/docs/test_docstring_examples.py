"""The examples in the docstrings of public names run and print what they say."""

import doctest

import matplotlib
import numpy as np
import pytest

import fastcoil as fc

FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
EXAMPLES = {
    test.name: test
    for name in fc.__all__
    if name not in ("__version__", "plot")
    for test in doctest.DocTestFinder(recurse=False).find(getattr(fc, name), f"fc.{name}", globs={"fc": fc, "np": np})
    if test.examples
}


@pytest.mark.kernel
@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_in_docstrings_print_what_they_say(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    matplotlib.use("agg")
    failures = []
    doctest.DocTestRunner(optionflags=FLAGS, verbose=False).run(EXAMPLES[name], out=failures.append)
    assert not failures, "".join(failures)
