"""Sweeps of which most cases run only in `make test-full`."""

import pytest


def full_except(cases, chosen):
    """Mark the cases that are not chosen to run in `make test-full` only."""
    chosen = list(chosen)
    marks = [() if case in chosen else pytest.mark.full for case in cases]
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=mark)
        for case, mark in zip(cases, marks, strict=True)
    ]
