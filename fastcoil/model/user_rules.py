"""``@fc.estimator`` and ``@fc.law``: a plain function becomes a rule of the user.

What parameters a rule may read and declare, the rule itself, and whether it is still the rule that it was.
"""

from __future__ import annotations

import inspect
import math
import platform
import sys
from collections.abc import Callable, Iterable, Mapping
from keyword import iskeyword
from typing import Any

from fastcoil.base.arguments import is_number, raise_problems, require_number, require_text, to_builtin
from fastcoil.base.errors import InputError, WrongTypeMessage, did_you_mean, short_repr
from fastcoil.model.control import Law
from fastcoil.model.engine.lanes import UserRules
from fastcoil.model.estimators.interface import Estimator, Sample
from fastcoil.model.metric_table import METRICS, PREDICTIONS, TRACES
from fastcoil.model.numerics.compile_user_function import UserFunction
from fastcoil.model.parameter_table import ESTIMATOR_GROUPS, PARAMETERS, RESERVED_DIMS, Parameter

_HIDDEN_GROUPS = ("coil", "valve", "actuator")  # groups of what a controller in the field cannot know
_TAKEN_NAMES = {
    *METRICS, *PREDICTIONS, *TRACES, *RESERVED_DIMS, "status", "design", "scenario", "preset", "include", "size",
    "seed", "method", "tolerance", "drop", "indexers", "missing_dims",
}  # fmt: skip


class RuleParameter(float):
    """The default of a rule's own parameter, with what is known of it; a number like any other."""

    unit: str
    lower: float
    upper: float
    text: str


def parameter(
    default: float, *, unit: str = "1", lower: float = -math.inf, upper: float = math.inf, text: str = ""
) -> float:
    """Declare a parameter of a rule of your own, as the default of a field of its ``Parameters``.

    Parameters
    ----------
    default
        Its value where a loop does not give it.
    unit
        Such as ``"K-1 s-1"``; ``"1"`` for a fraction or a count.
    lower, upper
        Its bounds, inclusive.
    text
        What it is, for help and the attributes of results.

    Examples
    --------
    >>> import fastcoil as fc
    >>> from typing import NamedTuple
    >>> class Parameters(NamedTuple):
    ...     sample_time: float  # of the loop
    ...     gain: float = fc.parameter(3e-4, unit="K-1 s-1", lower=0.0, text="how fast the estimate moves")

    Raises
    ------
    InputError
        If the default is no finite number within the bounds, or a text is none.
    """
    lower, upper = _require_bound("lower", lower, -math.inf), _require_bound("upper", upper, math.inf)
    cure = f"give a number ({Parameter('', '', unit, None, text, lower, upper).bounds})"
    rule_parameter = RuleParameter(
        require_number("default", default, cure, least=lower, most=min(upper, sys.float_info.max))
    )
    rule_parameter.unit, rule_parameter.text = require_text("unit", unit), require_text("text", text)
    rule_parameter.lower, rule_parameter.upper = lower, upper
    return rule_parameter


def _require_bound(name: str, value: object, no_bound: float) -> float:
    """A bound; ``no_bound`` stands for the lack of one."""
    value = to_builtin(value)
    return no_bound if isinstance(value, float) and value == no_bound else require_number(name, value, "give a number")


def declared_parameters(rule: str, fields: Mapping[str, object]) -> dict[str, Parameter]:
    """What a rule declares of its own; the other fields are parameters of the loop that it may read.

    fields: name → default, ``None`` for a field without one.
    """
    parameters, problems = {}, []
    for name, default in fields.items():
        loop_parameter = PARAMETERS.get(name)
        if loop_parameter and (
            loop_parameter.group in (*_HIDDEN_GROUPS, *ESTIMATOR_GROUPS)
            or loop_parameter.is_word
            or name == "estimate_ratio"
        ):
            problems.append(
                f"{rule} reads {name}, which a rule must not know: leave it out, or call its own parameter otherwise"
            )
        elif loop_parameter and default is not None:
            problems.append(
                f"{rule}: {name} = {short_repr(default)}: {name} is a parameter of the loop, which has its value; write "
                f"{name}: float"
            )
        elif loop_parameter:
            continue
        elif default is None:
            problems.append(
                f"{rule}: {name} is no parameter of the loop{did_you_mean(name, PARAMETERS)}: give it a default to make it "
                f"one of the rule's own, {name}: float = fc.parameter(0.0, text=…)"
            )
        elif name in _TAKEN_NAMES or iskeyword(name) or not name.isidentifier() or name.startswith("_"):
            problems.append(f"{rule}: the name {name} is taken: call the parameter something else")
        else:
            rule_parameter: Any = default if isinstance(default, RuleParameter) else parameter(default)  # type: ignore[arg-type]
            parameters[name] = Parameter(
                name, rule, rule_parameter.unit, float(rule_parameter), rule_parameter.text or f"parameter of {rule}", rule_parameter.lower,
                rule_parameter.upper, label=name.replace("_", " "),
            )  # fmt: skip
    raise_problems(problems)
    return parameters


RULE_KINDS = ("estimator", "law")
"""Parameters of a loop that a rule can be the value of."""


class Rule:
    """A rule of the user's own.  Called, it is the function that it was made of.

    name: the word in the results.  kind: the parameter that it is a value of.  own: the parameters that it brings.
    reads: those of the loop that it reads.  sha256: of its source, where it comes from a study file.
    """

    def __init__(self, kind: str, name: str, own: Mapping[str, Parameter], reads: tuple[str, ...], sha256: str) -> None:
        self.kind, self.name, self.own, self.reads, self.sha256 = kind, name, dict(own), reads, sha256
        self._made_of: tuple[Any, Any, Any] | None = None
        self._code: UserFunction | None = None

    @classmethod
    def of(cls, kind: str, function: Any, Parameters: Any, Memory: Any) -> Rule:  # noqa: N803 — classes
        """Check what a decorator is given."""
        name = getattr(function, "__name__", "")
        if not inspect.isfunction(function) or not name.isidentifier():
            raise InputError(
                WrongTypeMessage(f"@fc.{kind}(…) stands before {short_repr(function)}: put it before a function")
            )
        if is_built_in_rule(name):
            raise InputError(f"{name} is taken, call the function something else")
        arguments = list(inspect.signature(function).parameters.values())
        if len(arguments) != 3 or any(p.kind is not p.POSITIONAL_OR_KEYWORD for p in arguments):
            raise InputError(f"{name}: write it as def {name}(now, p, memory)")
        defaults = Parameters._field_defaults
        parameters = declared_parameters(name, {n: defaults.get(n) for n in Parameters._fields})
        rule = cls(kind, name, parameters, tuple(n for n in Parameters._fields if n not in parameters), "")
        rule._made_of = (function, Parameters, Memory)
        return rule

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

    def adopt_code(self, loaded_rule: object) -> None:
        """Take over the code that the source of this rule makes, which has to be what it declares."""
        declared = (self.kind, self.name, self.own, self.reads)
        if (
            not isinstance(loaded_rule, Rule)
            or (loaded_rule.kind, loaded_rule.name, loaded_rule.own, loaded_rule.reads) != declared
        ):
            raise InputError(
                f"{self.name} is not the {self.kind} that its source declares: put @fc.{self.kind}(Parameters, Memory) "
                "before its function, write every default as a number, and give each rule a name of its own"
            )
        self._made_of = loaded_rule.parts

    def check(self) -> None:
        """Compile it as its module is now; refused if it does not compile, allocates or may raise."""
        function, Parameters, Memory = self.parts
        code = UserFunction(self.name, function, Memory)
        if self._code is None or code.sha256 != self._code.sha256:
            code.check(Sample, Parameters)
            self._code = code

    @property
    def code_sha256(self) -> str:
        """Hash of all that decides what it does, with the values of its module when it was compiled, or now."""
        function, _, Memory = self.parts
        return (self._code or UserFunction(self.name, function, Memory)).sha256

    @property
    def kernel_rule(self) -> Estimator | Law:
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

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rule) and self.__dict__ | {"_code": None} == other.__dict__ | {"_code": None}

    def __hash__(self) -> int:
        return hash((self.kind, self.name))

    def __getstate__(self) -> dict[str, Any]:
        # code goes to other processes as text
        return self.__dict__ | {"_made_of": None, "_code": None}


def estimator(Parameters: Any, Memory: Any = None) -> Callable[[Any], Rule]:  # noqa: N803 — classes
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
    return _make_decorator("estimator", Parameters, Memory)


def law(Parameters: Any, Memory: Any = None) -> Callable[[Any], Rule]:  # noqa: N803 — classes
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
    return _make_decorator("law", Parameters, Memory)


def rules_for_kernels(rules: Mapping[str, Rule]) -> UserRules:
    """The rules as the kernels take them."""
    kernel_rules = [rule.kernel_rule for rule in rules.values()]
    return UserRules(
        tuple(f for f in kernel_rules if isinstance(f, Estimator)), tuple(f for f in kernel_rules if isinstance(f, Law))
    )


def _make_decorator(kind: str, Parameters: Any, Memory: Any) -> Callable[[Any], Rule]:  # noqa: N803 — classes
    raise_problems(_field_problems("Parameters", Parameters) + _field_problems("Memory", Memory))
    return lambda function: Rule.of(kind, function, Parameters, Memory)


def is_built_in_rule(name: str) -> bool:
    """Whether a word of the package is called so."""
    return any(name in PARAMETERS[kind].choices for kind in RULE_KINDS)


def _field_problems(role: str, namedtuple_class: Any) -> list[str]:
    """What is wrong with the class of parameters or memory."""
    is_class: bool = isinstance(namedtuple_class, type)
    if not is_class or not getattr(namedtuple_class, "_fields", ()) or not hasattr(namedtuple_class, "_field_defaults"):
        return [
            WrongTypeMessage(
                f"{role} is {short_repr(namedtuple_class)}: give a class made with typing.NamedTuple that has fields"
            )
        ]
    hints = getattr(namedtuple_class, "__annotations__", {})
    # with annotations from the future they are texts
    not_float = [
        n for n in namedtuple_class._fields if getattr(hints.get(n, float), "__forward_arg__", "float") != "float"
    ]
    not_float += [n for n in namedtuple_class._fields if isinstance(hints.get(n), type) and hints[n] is not float]
    not_float += [
        n for n, v in namedtuple_class._field_defaults.items() if not is_number(v) or not isinstance(v, (int, float))
    ]
    return [f"{n} of {role} is no float: a rule works with numbers, write {n}: float" for n in dict.fromkeys(not_float)]


RuleHashes = Mapping[str, Mapping[str, str]]
"""Name of a rule → version of Python, whose machine code differs → hash of all that decides what the rule does."""


def user_code_hashes(rules: Iterable[Rule]) -> RuleHashes:
    """The hashes of those whose code is here."""
    version = ".".join(platform.python_version_tuple()[:2])
    return {rule.name: {version: rule.code_sha256} for rule in rules if rule.is_loaded}


def merge_rule_hashes(hashes: RuleHashes, added_hashes: RuleHashes) -> RuleHashes:
    """The hashes of both."""
    return {name: {**hashes.get(name, {}), **added_hashes.get(name, {})} for name in sorted({*hashes, *added_hashes})}


def refuse_changed_code(current_hashes: RuleHashes, stored_hashes: RuleHashes) -> None:
    """Refuse a rule that does something else than before, though its source is the same."""
    raise_problems([
        f"{name} is another rule than in the rest of the study: its module takes a value from elsewhere, such as a "
        "variable of the environment, a file or another module, and it changed: restore it, or choose another folder "
        "with -o"
        for name, hashes in current_hashes.items()
        if any(stored_hashes.get(name, {}).get(version, sha256) != sha256 for version, sha256 in hashes.items())
    ])  # fmt: skip
