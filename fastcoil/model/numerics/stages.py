"""Stages: loops over lanes that are compiled apart and called by their address, so that a kernel is compiled once.

All stages of one kind have one signature; one more stage costs about a second, one more kernel 16.  A call costs some
20 ns, 3 % of a step in which all lanes sample: what every loop needs is BUILT_IN.  Numba's own function type, in place
of addresses, made the loop 5 to 8 % slower.
"""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.ccallback import CFunc
from numba.extending import intrinsic
from numba.np.numpy_support import carray

from fastcoil.model.numerics.jit import FLAGS, JIT_ENABLED, exact, fingerprint, observed_compile, widest_vectors
from fastcoil.model.numerics.kernel_cache import KernelCache, kernel_folder

NUMBER = types.float64
FLAG = types.boolean
INTEGER = types.int64
ROW_POINTER = types.CPointer(types.float64)
"""Type of flat states, which are passed by their address alone: seven words less a call."""
BUILT_IN = np.intp(0) if JIT_ENABLED else 0
"""In place of an address: the kernel has this stage in its own machine code."""
_COMPILE_LOCK = threading.RLock()
_COMPILED_STAGES: list[Any] = []  # machine code must not go away while its address is known


class StageSignature:
    """Names and types of the arguments of a kind of stage and of its result; ``call`` takes an address and these."""

    def __init__(self, *, returns: Any = types.void, **arguments: Any) -> None:
        self._arguments, self._returns = arguments, returns
        self.call = _make_caller(tuple(arguments.values()), returns)

    def compile(self, function: Callable[..., Any], identity: str) -> Any:
        """Compile ``function`` and return its address, or in the interpreter itself; identity: what it closes over."""
        assert function.__code__.co_varnames[: function.__code__.co_argcount] == tuple(self._arguments)
        if not JIT_ENABLED:
            return function
        stage: Any = CFunc(function, (tuple(self._arguments.values()), self._returns), {}, dict(FLAGS))
        stage._compiler.compile = observed_compile(stage._compiler.compile, function)
        folder = kernel_folder(fingerprint())
        if folder is not None:
            stage._cache = KernelCache(function, folder, identity)
        with _COMPILE_LOCK, widest_vectors():  # what it is emitted with
            stage.compile()
            _COMPILED_STAGES.append(stage)
        return np.intp(stage.address)


if JIT_ENABLED:

    def _make_caller(arguments: Any, returns: Any) -> Any:
        @intrinsic
        def call(typingctx: Any, address: Any, stage_arguments: Any) -> Any:
            """Call the stage at an address with a tuple of arguments."""

            def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
                llvm_types = [context.get_value_type(kind) for kind in arguments]
                function = ir.FunctionType(context.get_value_type(returns), llvm_types)
                pointer = builder.inttoptr(args[0], function.as_pointer())
                llvm_values = []
                for k, (given_type, stage_type) in enumerate(zip(stage_arguments, arguments, strict=True)):
                    value = builder.extract_value(args[1], k)
                    if isinstance(given_type, types.Array):
                        value = context.make_array(given_type)(context, builder, value).data
                    else:
                        value = context.cast(builder, value, given_type, stage_type)
                    llvm_values.append(value)
                result = builder.call(pointer, llvm_values)
                return context.get_dummy_value() if returns == types.void else result

            return returns(types.intp, stage_arguments), codegen

        return call

    @intrinsic(prefer_literal=True)
    def values_at(typingctx: Any, cls: Any, rows: Any, place: Any, stride: Any) -> Any:
        """Return a named tuple of class ``cls`` from ``rows[place]``, ``rows[place + stride]`` and so on."""
        tuple_class = cls.instance_class
        n = len(tuple_class._fields)

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            pointers = _pointers(builder, args[1:], n)
            return cgutils.pack_array(builder, [builder.load(p) for p in pointers], ir.DoubleType())

        tuple_type = types.NamedUniTuple(types.float64, n, tuple_class)
        return tuple_type(cls, rows, types.int64, types.int64), codegen

    @intrinsic
    def store_if_due(typingctx: Any, due: Any, values: Any, before: Any, rows: Any, place: Any, stride: Any) -> Any:
        """Store a tuple of numbers at the place of ``values_at`` if it is ``due``, else the tuple ``before``."""
        value_types = list(values)

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            pointers = _pointers(builder, args[3:], len(value_types))
            for k, (kind, pointer) in enumerate(zip(value_types, pointers, strict=True)):
                new = context.cast(builder, builder.extract_value(args[1], k), kind, types.float64)
                old = builder.extract_value(args[2], k)
                builder.store(builder.select(args[0], new, old), pointer)
            return context.get_dummy_value()

        return types.void(types.boolean, values, before, rows, types.int64, types.int64), codegen

    @exact
    def array_at(rows: Any, place: Any, size: Any) -> Any:
        """Return a view of ``size`` numbers from ``rows[place]`` on."""
        return carray(rows, (place + size,))[place:]

    def _pointers(builder: Any, args: Any, n: int) -> list[Any]:
        rows, place, stride = args
        steps = [builder.add(place, builder.mul(stride, stride.type(k))) for k in range(n)]
        return [builder.gep(rows, [step]) for step in steps]

else:

    def _make_caller(arguments: Any, returns: Any) -> Any:
        return lambda address, stage_arguments: address(*stage_arguments)

    def values_at(cls: Any, rows: Any, place: Any, stride: Any) -> Any:  # type: ignore[misc]
        """Return a named tuple of class ``cls`` from ``rows[place]``, ``rows[place + stride]`` and so on."""
        return cls(*(rows[place + stride * k] for k in range(len(cls._fields))))

    def store_if_due(due: Any, values: Any, before: Any, rows: Any, place: Any, stride: Any) -> None:  # type: ignore[misc]
        """Store a tuple of numbers at the place of ``values_at`` if it is ``due``, else the tuple ``before``."""
        for k, (new, old) in enumerate(zip(values, before, strict=True)):
            rows[place + stride * k] = new if due else old

    def array_at(rows: Any, place: Any, size: Any) -> Any:
        """Return a view of ``size`` numbers from ``rows[place]`` on."""
        return rows[place : place + size]
