"""What is refused: field and code of each problem of an ``InputError``; its sentence stands in the snapshot."""

from collections.abc import Callable
from contextlib import contextmanager

import pytest

from fastcoil.base.errors import CODES, InputError
from helpers.sentences import assert_worded


@contextmanager
def refuses(*mistakes):
    """Assert that the block is refused for these mistakes, (field, code) each, with the sentences of the snapshot."""
    with pytest.raises(InputError) as caught:
        yield caught
    assert caught.value.exit_code == 2
    assert [(problem.field, problem.code) for problem in caught.value.problems] == list(mistakes)
    assert {code for _, code in mistakes} <= CODES.keys()
    assert_worded(*caught.value.problems)


def assert_mistakes(mistakes, function: Callable, *args, **options):
    """Assert that a call is refused for these mistakes, (field, code) each; return the error."""
    with refuses(*mistakes) as caught:
        function(*args, **options)
    return caught.value


def assert_refused(field, code, function: Callable, *args, **options):
    """Assert that a call is refused for one mistake; return the error."""
    return assert_mistakes([(field, code)], function, *args, **options)


def problems(function: Callable, *args, **options):
    """The sentences with which a call is refused."""
    with pytest.raises(InputError) as caught:
        function(*args, **options)
    assert caught.value.exit_code == 2
    return list(caught.value.problems)


def only_problem(function: Callable, *args, **options):
    """The one sentence with which a call is refused."""
    (problem,) = problems(function, *args, **options)
    return problem


def refusal(function: Callable, *args, **options):
    """All sentences with which a call is refused, a line each."""
    return "\n".join(problems(function, *args, **options))
