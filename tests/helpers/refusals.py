"""What is refused: the sentences of an ``InputError``."""

from collections.abc import Callable, Iterable
from typing import Any

import pytest

from fastcoil.base.errors import InputError


def problems(function: Callable[..., Any], *args: Any, **options: Any) -> list[str]:
    """The sentences with which a call is refused."""
    with pytest.raises(InputError) as caught:
        function(*args, **options)
    assert caught.value.exit_code == 2
    return list(caught.value.problems)


def only_problem(function: Callable[..., Any], *args: Any, **options: Any) -> str:
    """The one sentence with which a call is refused."""
    (problem,) = problems(function, *args, **options)
    return problem


def assert_only_problem(words: Iterable[str], function: Callable[..., Any], *args: Any, **options: Any) -> None:
    """A call is refused with one sentence, in which all of these words stand."""
    problem = only_problem(function, *args, **options)
    for word in words:
        assert word in problem, problem


def refusal(function: Callable[..., Any], *args: Any, **options: Any) -> str:
    """All sentences with which a call is refused, a line each."""
    return "\n".join(problems(function, *args, **options))
