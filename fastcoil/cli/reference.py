"""``fastcoil parameters``, ``presets`` and ``schema``: what a study file may say."""

from __future__ import annotations

import click

from fastcoil.cli.terminal import say


@click.command()
@click.argument("names", nargs=-1)
def parameters(names: tuple[str, ...]) -> None:
    """List the parameters of a loop (or only NAMES): default, unit, meaning, allowed values."""
    from fastcoil.model.parameter_table import PARAMETERS, check_name, lines_of

    say(*lines_of([PARAMETERS[check_name(n)] for n in names] or PARAMETERS.values()))


@click.command()
def presets() -> None:
    """List the named loops that a study can start from, and how they differ from the defaults."""
    from fastcoil.loops.presets import PRESETS

    say(*repr(PRESETS).split("\n"))


@click.command()
def schema() -> None:
    """Print the JSON Schema of study files, for editors that complete and check TOML."""
    import json

    from fastcoil.study.file.schema import study_schema

    say(*json.dumps(study_schema(), indent=2, ensure_ascii=False).split("\n"))
