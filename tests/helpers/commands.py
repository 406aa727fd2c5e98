"""The command line, and commands on studies with user code."""

from collections.abc import Iterator
from pathlib import Path

from click.testing import CliRunner, Result

from fastcoil.base.errors import EXIT_INPUT
from fastcoil.cli import terminal
from fastcoil.cli.main import main
from fastcoil.study.file.user_code import load_function
from helpers.sentences import assert_worded

terminal.show_compilation.is_announced = True  # commands say the same, whatever is compiled


def fastcoil(*words: object) -> Result:
    """Run a command of the command line, of any words."""
    return CliRunner().invoke(main, [str(word) for word in words])


def assert_command_refused(*words: object, exit_code: int = EXIT_INPUT) -> None:
    """Assert that a command ends with an exit code, and on stderr with the sentences of the snapshot alone."""
    result = fastcoil(*words)
    assert result.exit_code == exit_code, result.output
    lines = result.stderr.splitlines()
    assert all(line.startswith("fastcoil: ") for line in lines), result.output
    assert_worded(*(line.removeprefix("fastcoil: ") for line in lines))


def plan_and_run(path: Path, out: Path) -> Iterator[Result]:
    """Plan a study with code of its own, then run it: what each command said, which loads the code anew."""
    for command in (["plan", path], ["run", path, "-o", out, "-j", 1, "--no-figures"]):
        load_function.cache_clear()
        result = fastcoil(*command)
        assert result.exit_code == 0, result.output
        yield result
