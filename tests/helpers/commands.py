"""The command line, and commands on studies with code of their own."""

from collections.abc import Iterator
from pathlib import Path

from click.testing import CliRunner, Result

from fastcoil.cli.main import main
from fastcoil.study.file.user_code import load_function


def fastcoil(*words: object) -> Result:
    """Run a command of the command line, of any words."""
    return CliRunner().invoke(main, [str(word) for word in words])


def plan_and_run(path: Path, out: Path) -> Iterator[Result]:
    """Plan a study with code of its own, then run it: what each command said, which loads the code anew."""
    for command in (["plan", path], ["run", path, "-o", out, "-j", 1, "--no-figures"]):
        load_function.cache_clear()
        result = fastcoil(*command)
        assert result.exit_code == 0, result.output
        yield result
