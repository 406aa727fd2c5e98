"""What a caller wants of a log and declares about it, and the checks of both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from fastcoil.base.arguments import checking, mapping_of, path_of, plain
from fastcoil.base.errors import InputError
from fastcoil.model.parameter_table import Parameter

MAX_GAP = Parameter("max_gap", "boundary", "s", None, "longest step of a log that is bridged", 1.0)
_EXAMPLES = {"columns": "{'m_w': 'its header'}", "units": "{'m_w': 'kg/s'}", "constants": "{'m_a': 1.2}"}


class Wanted(NamedTuple):
    """The series that a caller reads.

    needed: must be in the log, of a tuple exactly one.  optional: may be in the log.  measured: outputs of the model
    among both; a bad value of one becomes NaN, and its row stays.
    """

    needed: Sequence[str | tuple[str, ...]]
    optional: Sequence[str] = ()
    measured: Sequence[str] = ()

    @property
    def names(self) -> list[str]:
        return [name for one in (*self.needed, *self.optional) for name in ((one,) if isinstance(one, str) else one)]


class Declared(NamedTuple):
    """What the caller declares about a log in addition to its header.

    columns: our name → header; None if the log has our names.  units: our name → unit, for headers without one.
    constants: our name → number, for series that the log lacks; None where the caller offers none.  has_command:
    whether a command offers the same as options, so that messages name these too.
    """

    columns: Mapping[str, str] | None
    units: Mapping[str, str]
    constants: Mapping[str, float] | None
    has_command: bool

    def cure(self, argument: str, option: str) -> str:
        """An argument of the function, and the option of the command that does the same."""
        return f"{argument}, {option}" if self.has_command else argument

    def column_cure(self, name: str) -> str:
        """How to say which column holds ``name``."""
        return self.cure(f"columns={{{name!r}: 'its header'}}", f"--column {name}='its header'")


def require_mappings(**given: Any) -> None:
    """Raise one `InputError` for all of columns, units and constants that do not map names; None passes."""
    with checking() as check:
        for name, value in given.items():
            cure = f"give a mapping of names, such as {_EXAMPLES[name]}"
            check.unless_none(mapping_of, name, value, cure, to_text=name != "constants")


def max_gap_of(max_gap: Any) -> float | None:
    """The longest step to be bridged; None passes."""
    value: float | None = plain(max_gap)
    if value is not None and (problem := MAX_GAP.problem(value)):
        raise InputError(problem)
    return value


def log_of(name: str, source: Any) -> Any:
    """A log as it can be read: the path of a CSV file, or a Dataset.

    Raises
    ------
    InputError
        If it is something else.
    """
    if hasattr(type(source), "data_vars"):
        return source
    return path_of(name, source, "give the path of a CSV file or an xarray.Dataset")
