"""``@fc.estimator``, ``@fc.law``, ``@fc.plant``: a plain function becomes a rule of the user."""

from __future__ import annotations

import inspect
import math
import platform
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from keyword import iskeyword
from typing import Any

from fastcoil.base.arguments import is_number, raise_problems, require_number, require_text, to_builtin
from fastcoil.base.errors import InputError, Problem, did_you_mean, short_repr
from fastcoil.model.engine.lanes import UserRules
from fastcoil.model.engine.plant import PlantInputs
from fastcoil.model.estimators.interface import Estimator, Sample, StepRule
from fastcoil.model.metric_table import METRICS, TRACES
from fastcoil.model.numerics.compile_user_function import UserFunction
from fastcoil.model.parameter_table import COVERED, ESTIMATOR_GROUPS, PARAMETERS, RESERVED_DIMS, Parameter

_HIDDEN_GROUPS = ("plant", "room", "coil", "valve", "actuator")  # of what a controller in the field cannot know
_TAKEN_NAMES = {  # that no parameter of a rule can have
    *METRICS, *TRACES, *RESERVED_DIMS, "status", "design", "scenario", "preset", "include", "size",
    "seed", "method", "tolerance", "drop", "indexers", "missing_dims",
}  # fmt: skip


class RuleParameter(float):
    """Default of a rule's parameter, a number with unit, bounds and meaning."""

    declared: Parameter


def parameter(
    default: float, *, unit: str = "1", lower: float = -math.inf, upper: float = math.inf, text: str = ""
) -> float:
    """Declare a parameter of a user's rule, as the default of a field of its ``Parameters``.

    Parameters
    ----------
    default : float
        Value where a loop does not give one.
    unit : str, default "1"
        Such as ``"K-1 s-1"``; ``"1"`` for a fraction or a count.
    lower, upper : float
        Bounds, inclusive.
    text : str
        Meaning, for help and the attributes of results.

    Returns
    -------
    float
        The default; the rest is in its attribute ``declared``.

    Raises
    ------
    InputError
        If the default is no finite number within the bounds, or a text is none.

    Examples
    --------
    >>> import fastcoil as fc
    >>> from typing import NamedTuple
    >>> class Parameters(NamedTuple):
    ...     sample_time: float  # of the loop
    ...     gain: float = fc.parameter(3e-4, unit="K-1 s-1", lower=0.0, text="how fast the estimate moves")
    >>> Parameters(30.0).gain
    0.0003
    """
    lower, upper = _require_bound("lower", lower, -math.inf), _require_bound("upper", upper, math.inf)
    declaration = Parameter("", "", unit, None, text, lower, upper, theory=COVERED)
    cure, most = f"give a number ({declaration.bounds})", min(upper, sys.float_info.max)
    number = RuleParameter(require_number("default", default, cure, least=lower, most=most))
    number.declared = replace(declaration, unit=require_text("unit", unit), text=require_text("text", text))
    return number


def _require_bound(name: str, value: object, no_bound: float) -> float:
    """Require a number as a bound, or ``no_bound``, which is -inf or inf."""
    value = to_builtin(value)
    return no_bound if isinstance(value, float) and value == no_bound else require_number(name, value, "give a number")


def declared_parameters(rule: str, kind: str, fields: Mapping[str, Any]) -> dict[str, Parameter]:
    """Return the parameters that a rule declares; fields: name → default, None for those of the loop that it reads."""
    unknown_groups = ESTIMATOR_GROUPS if kind == "plant" else (*_HIDDEN_GROUPS, *ESTIMATOR_GROUPS)
    parameters: dict[str, Parameter] = {}
    problems: list[str] = []
    for name, default in fields.items():
        p, sentence, code = PARAMETERS.get(name), "", ""
        if p and (p.group in unknown_groups or p.is_word or name == "estimate_ratio"):
            cure, code = "leave it out, or call its own parameter otherwise", "unsupported"
            sentence = f"{rule} reads {name}, which a rule must not know: {cure}"
        elif p and default is not None:
            cure, code = f"{name} is a parameter of the loop, which has its value; write {name}: float", "conflict"
            sentence = f"{rule}: {name} = {short_repr(default)}: {cure}"
        elif default is None and not p:
            cure, code = f"make it one of the rule's own, {name}: float = fc.parameter(0.0, text=…)", "name"
            suggestion = did_you_mean(name, PARAMETERS)
            sentence = f"{rule}: {name} is no parameter of the loop{suggestion}: give it a default to {cure}"
        elif not p and (name in _TAKEN_NAMES or iskeyword(name) or not name.isidentifier() or name.startswith("_")):
            sentence, code = f"{rule}: the name {name} is taken: call the parameter something else", "name"
        elif not p:
            number: Any = default if isinstance(default, RuleParameter) else parameter(default)
            text, label = number.declared.text or f"parameter of {rule}", name.replace("_", " ")
            rule_fields = {"name": name, "group": rule, "default": float(number), "text": text, "label": label}
            parameters[name] = replace(number.declared, **rule_fields)
        if sentence:
            problems.append(Problem(sentence, name, code))
    raise_problems(problems)
    return parameters


RULE_KINDS = ("estimator", "law", "plant")  # parameters of a loop that a rule can be the value of


class Rule:
    """A rule of the user, which calls its function.  own: parameters that it declares; reads: those of the loop."""

    def __init__(self, kind: str, name: str, own: Mapping[str, Parameter], reads: tuple[str, ...], sha256: str) -> None:
        self.kind, self.name, self.own, self.reads, self.sha256 = kind, name, dict(own), reads, sha256
        self._definition: tuple[Any, Any, Any] | None = None
        self._code: UserFunction | None = None

    @classmethod
    def from_function(cls, kind: str, function: Any, Parameters: Any, Memory: Any) -> Rule:  # noqa: N803 — classes
        """Make a rule from a decorated function and its two classes; refuse what cannot be one."""
        name = getattr(function, "__name__", "")
        if not inspect.isfunction(function) or not name.isidentifier():
            sentence = f"@fc.{kind}(…) stands before {short_repr(function)}: put it before a function"
            raise InputError(sentence, kind, "type")
        if is_built_in_rule(name):
            raise InputError(f"{name} is taken, call the function something else", name, "name")
        arguments = list(inspect.signature(function).parameters.values())
        if len(arguments) != 3 or any(p.kind is not p.POSITIONAL_OR_KEYWORD for p in arguments):
            raise InputError(f"{name}: write it as def {name}(now, p, memory)", name, "code")
        parameters = declared_parameters(name, kind, {n: Parameters._field_defaults.get(n) for n in Parameters._fields})
        rule = cls(kind, name, parameters, tuple(n for n in Parameters._fields if n not in parameters), "")
        rule._definition = (function, Parameters, Memory)
        return rule

    @property
    def is_loaded(self) -> bool:
        """Whether its code has been run; that of a study that is only inspected has not."""
        return self._definition is not None

    @property
    def parts(self) -> tuple[Any, Any, Any]:
        """The function and the classes Parameters and Memory that the rule was made from."""
        if self._definition is None:
            sentence = f"the code of {self.name} has not been run: run the study with `fastcoil run`"
            raise InputError(sentence, self.name, "missing")
        return self._definition

    def adopt_code(self, loaded: object) -> None:
        """Take over the code of a rule that was just loaded from its source; refuse one that differs as declared."""
        declaration = (self.kind, self.name, self.own, self.reads)
        if not isinstance(loaded, Rule) or (loaded.kind, loaded.name, loaded.own, loaded.reads) != declaration:
            sentence = (
                f"{self.name} is not the {self.kind} that its source declares: put @fc.{self.kind}(Parameters, Memory) "
                "before its function, write every default as a number, and give each rule a name of its own"
            )
            raise InputError(sentence, self.name, "code")
        self._definition = loaded.parts

    def check(self) -> None:
        """Compile the rule with its module's present values; refuse what does not compile, allocates or may raise."""
        function, Parameters, Memory = self.parts
        code = UserFunction(self.name, function, Memory)
        if self._code is None or code.sha256 != self._code.sha256:
            code.check(PlantInputs if self.kind == "plant" else Sample, Parameters)
            self._code = code

    @property
    def code_sha256(self) -> str:
        """Hash of the rule's code and of the values of its module when it was compiled, or now."""
        function, _, Memory = self.parts
        return (self._code or UserFunction(self.name, function, Memory)).sha256

    @property
    def kernel_rule(self) -> StepRule:
        """The rule with compiled code: a `StepRule`, of an estimator an `Estimator`."""
        if self._code is None:
            self.check()
        assert self._code is not None
        _, Parameters, Memory = self.parts
        fingerprint = repr((self.name, Parameters._fields, Memory._fields, Memory._field_defaults, self._code.sha256))
        kernel_class = Estimator if self.kind == "estimator" else StepRule
        return kernel_class(self.name, Parameters, Memory, self._code.function, fingerprint=fingerprint)

    def __call__(self, now: Any, p: Any, memory: Any) -> Any:
        return self.parts[0](now, p, memory)

    def __repr__(self) -> str:
        return f"<fastcoil {self.kind} {self.name}>"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Rule) and self.__dict__ | {"_code": None} == other.__dict__ | {"_code": None}

    def __hash__(self) -> int:
        return hash((self.kind, self.name))

    def __getstate__(self) -> dict[str, Any]:
        # code goes to other processes as text
        return self.__dict__ | {"_definition": None, "_code": None}


def estimator(Parameters: Any, Memory: Any = None) -> Callable[[Any], Rule]:  # noqa: N803 — classes
    """Make an estimator from a function ``(now, p, memory) -> (estimate, Memory)``.

    It is called at every controller sample but the first, before the control law.  Its estimate, a fraction of stroke,
    is limited to 0–1 and is what the inverse assumes from then on.

    Parameters
    ----------
    Parameters, Memory : type
        Two classes, each a ``typing.NamedTuple`` of floats.  ``Parameters`` has names of parameters of the loop, such
        as ``sample_time``, and new parameters with ``fc.parameter(…)`` as default.  ``Memory`` is what one call
        leaves to the next; its defaults are the initial values.

    Returns
    -------
    callable
        A decorator for the function.  The rule that it returns stands for the estimator in ``fc.Loop(estimator=…)``.

    Raises
    ------
    InputError
        With one sentence for each mistake in the classes or the function.

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
    """
    return _make_decorator("estimator", Parameters, Memory)


def law(Parameters: Any, Memory: Any = None) -> Callable[[Any], Rule]:  # noqa: N803 — classes
    """Make a control law, in place of the PI, from a function ``(now, p, memory) -> (u, Memory)``.

    It is called at every controller sample; in ``now``, ``T`` and ``e`` belong to this sample, ``u`` and what follows
    to the previous one.  Its u, the requested opening, is limited to 0–1; the inverse stays behind it.

    Arguments and errors are as for ``fc.estimator``; the rule stands for the law in ``fc.Loop(law=…)``.

    Examples
    --------
    >>> import fastcoil as fc
    >>> from typing import NamedTuple
    >>> class Parameters(NamedTuple):
    ...     ki: float = fc.parameter(0.003, unit="K-1", lower=0.0, text="integral gain per sample")
    >>> class Memory(NamedTuple):
    ...     u: float = 0.0
    >>> @fc.law(Parameters, Memory)
    ... def integrate(now, p, memory):
    ...     u = min(max(memory.u + p.ki * now.e, 0.0), 1.0)
    ...     return u, Memory(u)
    >>> fc.Loop(law=["pi", integrate], ki=0.002).sizes
    {'law': 2}
    """
    return _make_decorator("law", Parameters, Memory)


def plant(Parameters: Any, Memory: Any = None) -> Callable[[Any], Rule]:  # noqa: N803 — classes
    """Make a plant, in place of the coil, from a function ``(now, p, memory) -> (T, Memory)``.

    It is called every second, before the controller.  ``now`` has t [s]; m_w [kg/s] and opening of the valve as they
    were ``dead_time`` seconds ago (of the second before where that is 0); m_a [kg/s], T_a_in [°C], W_a_in and T_w_in
    [°C] of this second.  T is the temperature of what leaves, °C: T_sup.  Energy, frost and condensate are then NaN.

    Arguments and errors are as for ``fc.estimator``; ``Parameters`` may also name parameters of the valve, such as
    ``m_max``.  The rule stands for the plant in ``fc.Loop(plant=…)``.

    Examples
    --------
    >>> import fastcoil as fc
    >>> from typing import NamedTuple
    >>> class Parameters(NamedTuple):
    ...     gain: float = fc.parameter(-20.0, unit="K", text="change of T for a full opening")
    ...     lag: float = fc.parameter(120.0, unit="s", lower=1.0, text="time constant")
    >>> class Memory(NamedTuple):
    ...     T: float = 25.0
    >>> @fc.plant(Parameters, Memory)
    ... def first_order(now, p, memory):
    ...     T = memory.T + (now.T_a_in + p.gain * now.opening - memory.T) / p.lag
    ...     return T, Memory(T)
    >>> fc.Loop(plant=first_order, dead_time=30, lag=[60.0, 120.0]).sizes
    {'lag': 2}
    """
    return _make_decorator("plant", Parameters, Memory)


def rules_for_kernels(rules: Mapping[str, Rule]) -> UserRules:
    """Return the user's rules of a loop, by kind, with compiled code."""
    by_kind: dict[str, list[Any]] = {
        kind: [rule.kernel_rule for rule in rules.values() if rule.kind == kind] for kind in RULE_KINDS
    }
    return UserRules(*map(tuple, by_kind.values()))


def _make_decorator(kind: str, Parameters: Any, Memory: Any) -> Callable[[Any], Rule]:  # noqa: N803 — classes
    raise_problems(_field_problems("Parameters", Parameters) + _field_problems("Memory", Memory))
    return lambda function: Rule.from_function(kind, function, Parameters, Memory)


def is_built_in_rule(name: str) -> bool:
    """Whether an estimator or law of the package has this name."""
    return any(name in PARAMETERS[kind].choices for kind in RULE_KINDS)


def _field_problems(role: str, cls: Any) -> list[Problem]:
    """Return the mistakes in the class of parameters or memory."""
    is_class: bool = isinstance(cls, type)
    if not is_class or not getattr(cls, "_fields", ()) or not hasattr(cls, "_field_defaults"):
        sentence = f"{role} is {short_repr(cls)}: give a class made with typing.NamedTuple that has fields"
        return [Problem(sentence, role, "type")]
    hints = getattr(cls, "__annotations__", {})
    # with annotations from the future they are texts
    not_float = [n for n in cls._fields if getattr(hints.get(n, float), "__forward_arg__", "float") != "float"]
    not_float += [n for n in cls._fields if isinstance(hints.get(n), type) and hints[n] is not float]
    not_float += [n for n, v in cls._field_defaults.items() if not is_number(v) or not isinstance(v, (int, float))]
    sentence = "{0} of {1} is no float: a rule works with numbers, write {0}: float"
    return [Problem(sentence.format(n, role), n, "code") for n in dict.fromkeys(not_float)]


RuleHashes = Mapping[str, Mapping[str, str]]
"""Name of a rule → version of Python, on which the machine code depends → ``Rule.code_sha256``."""


def hash_user_code(rules: Iterable[Rule], earlier: RuleHashes) -> RuleHashes:
    """Return the hashes of the rules whose code has run, next to earlier ones; refuse a rule that behaves otherwise."""
    version = ".".join(platform.python_version_tuple()[:2])
    hashes = {rule.name: rule.code_sha256 for rule in rules if rule.is_loaded}
    raise_problems([
        Problem(
            f"{name} is another rule than in the rest of the study: its module takes a value from elsewhere, such as "
            "a variable of the environment, a file or another module, and it changed: restore it, or choose another "
            "folder with -o", name, "code",
        )
        for name, sha256 in hashes.items()
        if earlier.get(name, {}).get(version, sha256) != sha256
    ])  # fmt: skip
    return {**earlier, **{name: {**earlier.get(name, {}), version: sha256} for name, sha256 in hashes.items()}}
