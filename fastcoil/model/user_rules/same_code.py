"""Whether rules are what they were: their source is known, but not what their modules read elsewhere as they run."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping

from fastcoil.base.errors import InputError
from fastcoil.model.user_rules.rule import Rule

OwnCode = Mapping[str, Mapping[str, str]]
"""Name of a rule → version of Python, whose machine code differs → hash of all that decides what the rule does."""


def own_code_of(rules: Iterable[Rule]) -> OwnCode:
    """The hashes of those whose code is here."""
    version = ".".join(platform.python_version_tuple()[:2])
    return {rule.name: {version: rule.code_sha256} for rule in rules if rule.is_loaded}


def joined(one: OwnCode, other: OwnCode) -> OwnCode:
    """The hashes of both."""
    return {name: {**one.get(name, {}), **other.get(name, {})} for name in sorted({*one, *other})}


def refuse_other_code(now: OwnCode, before: OwnCode) -> None:
    """Refuse a rule that does something else than before, though its source is the same.

    Raises
    ------
    InputError
        With a sentence for each.
    """
    both = [name for name in now if name in before]
    differ = [n for n in both if any(before[n].get(version, sha256) != sha256 for version, sha256 in now[n].items())]
    if differ:
        raise InputError([
            f"{name} is another rule than in the rest of the study: its module takes a value from elsewhere, such as a "
            "variable of the environment, a file or another module, and it changed: restore it, or choose another "
            "folder with -o"
            for name in differ
        ])  # fmt: skip
