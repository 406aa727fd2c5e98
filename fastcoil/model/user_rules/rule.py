"""``@fc.estimator`` and ``@fc.law``: a plain function becomes a rule of the user's own."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from fastcoil.base.arguments import is_number
from fastcoil.base.errors import InputError, WrongType, shown
from fastcoil.model.control.interface import Law
from fastcoil.model.engine.lanes import Rules
from fastcoil.model.estimators.interface import Estimator, Sample
from fastcoil.model.numerics.compile_user_function import OwnCode
from fastcoil.model.parameter_table import PARAMETERS, Parameter
from fastcoil.model.user_rules.parameter import own_parameters

KINDS = ("estimator", "law")
"""Parameters of a loop that a rule can be the value of."""


class Rule:
    """A rule of the user's own.  Called, it is the function that it was made of.

    name: the word in the results.  kind: the parameter that it is a value of.  own: the parameters that it brings.
    reads: those of the loop that it reads.  sha256: of its source, where it comes from a study file.
    """

    def __init__(self, kind: str, name: str, own: Mapping[str, Parameter], reads: tuple[str, ...], sha256: str) -> None:
        self.kind, self.name, self.own, self.reads, self.sha256 = kind, name, dict(own), reads, sha256
        self._made_of: tuple[Any, Any, Any] | None = None
        self._code: OwnCode | None = None

    @classmethod
    def of(cls, kind: str, function: Any, Parameters: Any, Memory: Any) -> Rule:  # noqa: N803 — classes
        """Check what a decorator is given.

        Raises
        ------
        InputError
            With one sentence for each mistake.
        """
        name = getattr(function, "__name__", "")
        if not inspect.isfunction(function) or not name.isidentifier():
            raise InputError(WrongType(f"@fc.{kind}(…) stands before {shown(function)}: put it before a function"))
        problems = [f"{name}: {word} is taken, call the function something else" for word in [name] if is_word(name)]
        if inspect.iscoroutinefunction(function) or inspect.isasyncgenfunction(function):
            problems.append(f"{name}: a rule cannot wait, write def without async")
        takes = list(inspect.signature(function).parameters.values())
        if len(takes) != 3 or any(p.kind is not p.POSITIONAL_OR_KEYWORD for p in takes):
            problems.append(f"{name}: it must take three things, def {name}(now, p, memory)")
        if problems:
            raise InputError(problems)
        defaults = Parameters._field_defaults
        own = own_parameters(name, {n: defaults.get(n) for n in Parameters._fields})
        made = cls(kind, name, own, tuple(n for n in Parameters._fields if n not in own), "")
        made._made_of = (function, Parameters, Memory)
        return made

    @property
    def is_loaded(self) -> bool:
        """Whether its code is here; of a study that is only looked at, it is not."""
        return self._made_of is not None

    @property
    def parts(self) -> tuple[Any, Any, Any]:
        """Function, Parameters and Memory."""
        if self._made_of is None:
            raise InputError(f"the code of {self.name} has not been run: run the study with `fastcoil run`")
        return self._made_of

    def adopt(self, made: object) -> None:
        """Take over the code that the source of this rule makes.

        Raises
        ------
        InputError
            If it makes something else than it declares.
        """
        if not isinstance(made, Rule) or made.kind != self.kind:
            raise InputError(f"{self.name} is no {self.kind}: put @fc.{self.kind}(Parameters, Memory) before it")
        if made.name != self.name:
            raise InputError(f"{self.name} is the rule {made.name} in the end: give each a name of its own")
        if made.own != self.own or made.reads != self.reads:
            raise InputError(
                f"{self.name}: its Parameters are not those that its source declares: write every default as a number"
            )
        self._made_of = made.parts

    def check(self) -> None:
        """Compile it as its module is now.

        Raises
        ------
        InputError
            If it does not compile, allocates, may raise, or returns something else.
        """
        function, Parameters, Memory = self.parts
        code = OwnCode(self.name, function, Memory)
        if self._code is None or code.sha256 != self._code.sha256:
            code.check(Sample, Parameters)
            self._code = code

    @property
    def code_sha256(self) -> str:
        """Hash of all that decides what it does, the values included that its module had when it was compiled, or now.

        Raises
        ------
        InputError
            If it uses something that cannot be compiled.
        """
        if self._code is None:
            function, _, Memory = self.parts
            return OwnCode(self.name, function, Memory).sha256
        return self._code.sha256

    @property
    def family(self) -> Estimator | Law:
        """The rule for the kernels."""
        if self._code is None:
            self.check()
        assert self._code is not None
        _, Parameters, Memory = self.parts
        identity = repr((self.name, Parameters._fields, Memory._fields, Memory._field_defaults, self._code.sha256))
        if self.kind == "law":
            return Law(self.name, Parameters, Memory, self._code.function, identity)
        return Estimator(self.name, Parameters, Memory, self._code.function, identity=identity)

    def __call__(self, now: Sample, p: Any, memory: Any) -> Any:
        return self.parts[0](now, p, memory)

    def __repr__(self) -> str:
        return f"<fastcoil {self.kind} {self.name}>"

    def _key(self) -> tuple[Any, ...]:
        return (self.kind, self.name, tuple(self.own.items()), self.reads, self.sha256, self._made_of)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rule) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash((self.kind, self.name))

    def __getstate__(self) -> dict[str, Any]:
        # code goes to other processes as text
        return self.__dict__ | {"_made_of": None, "_code": None}


def estimator(Parameters: Any, Memory: Any) -> Callable[[Any], Rule]:  # noqa: N803 — classes
    """Make an estimator of your own of a function ``(now, p, memory) -> (estimate, Memory)``.

    It is called at every controller sample but the first, before the control law.  Its estimate, a fraction of stroke,
    is limited to 0–1 and is what the inverse assumes from then on.

    Parameters
    ----------
    Parameters, Memory
        Two classes, each a ``typing.NamedTuple`` of floats.  ``Parameters`` has names of parameters of the loop, such
        as ``sample_time``, and parameters of your own, with ``fc.parameter(…)`` as default.  ``Memory`` is what one
        call leaves to the next; its defaults are where it starts.

    Returns
    -------
    callable
        A decorator for the function.  What it makes of it stands for the estimator in ``fc.Loop(estimator=…)``.

    Examples
    --------
    >>> import fastcoil as fc
    >>> from typing import NamedTuple
    >>> class Parameters(NamedTuple):
    ...     gain: float = fc.parameter(0.01, lower=0.0, text="share of |e| that the estimate moves by")
    >>> class Memory(NamedTuple):
    ...     largest: float = 0.0
    >>> @fc.estimator(Parameters, Memory)
    ... def by_largest_error(now, p, memory):
    ...     largest = max(memory.largest, abs(now.e))
    ...     return p.gain * largest, Memory(largest)
    >>> fc.Loop(estimator=by_largest_error, gain=[0.0, 0.02]).sizes
    {'gain': 2}

    Raises
    ------
    InputError
        With one sentence for each mistake in the classes or the function.
    """
    return _decorator("estimator", Parameters, Memory)


def law(Parameters: Any, Memory: Any) -> Callable[[Any], Rule]:  # noqa: N803 — classes
    """Make a control law of your own of a function ``(now, p, memory) -> (u, Memory)``, in place of the PI.

    It is called at every controller sample; in ``now``, ``T`` and ``e`` are of this sample, ``u`` and what follows of
    the one before.  Its u, the opening it asks for, is limited to 0–1; the inverse stays behind it.

    Parameters
    ----------
    Parameters, Memory
        As for ``fc.estimator``.

    Returns
    -------
    callable
        A decorator for the function.  What it makes of it stands for the law in ``fc.Loop(law=…)``.

    Raises
    ------
    InputError
        With one sentence for each mistake in the classes or the function.
    """
    return _decorator("law", Parameters, Memory)


def rules_for_kernels(rules: Mapping[str, Rule]) -> Rules:
    """The rules as the kernels take them."""
    made = [rule.family for rule in rules.values()]
    return Rules(tuple(f for f in made if isinstance(f, Estimator)), tuple(f for f in made if isinstance(f, Law)))


def _decorator(kind: str, Parameters: Any, Memory: Any) -> Callable[[Any], Rule]:  # noqa: N803 — classes
    problems = _field_problems("Parameters", Parameters) + _field_problems("Memory", Memory)
    if problems:
        raise InputError(problems)
    return lambda function: Rule.of(kind, function, Parameters, Memory)


def is_word(name: str) -> bool:
    """Whether a word of the package is called so."""
    return any(name in PARAMETERS[kind].choices for kind in KINDS)


def _field_problems(what: str, given: Any) -> list[str]:
    """What is wrong with the class of parameters or memory."""
    is_class: bool = isinstance(given, type)
    if not is_class or not hasattr(given, "_field_defaults"):
        return [WrongType(f"{what} is {shown(given)}: give a class made with typing.NamedTuple")]
    if not given._fields:
        return [f"{what} has no fields: give it one, such as {_EXAMPLES[what]}"]
    hints = getattr(given, "__annotations__", {})
    # with annotations from the future they are texts
    wrong = [n for n in given._fields if getattr(hints.get(n, float), "__forward_arg__", "float") != "float"]
    wrong += [n for n in given._fields if isinstance(hints.get(n), type) and hints[n] is not float]
    odd = [n for n, v in given._field_defaults.items() if not is_number(v) or not isinstance(v, (int, float))]
    return [
        f"{n} of {what} is no float: a rule works with numbers, write {n}: float" for n in dict.fromkeys(wrong + odd)
    ]


_EXAMPLES = {"Parameters": "sample_time: float", "Memory": "last: float = 0.0"}
