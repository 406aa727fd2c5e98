"""Stages: loops over lanes that are compiled apart and called by their address, so that a kernel is compiled once.

A kernel takes the address of a stage as an argument.  All stages of one kind have one signature, so that the kernel is
the same machine code whichever of them it is given; one more stage costs about a second, one more kernel 16.

A call costs some 20 ns, 3 % of a step in which all lanes sample: what every loop needs is BUILT_IN.  Addresses are
plain numbers: Numba's own function type takes three pointers and keeps references, which made the whole
loop 5 to 8 % slower.
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

from fastcoil.model.numerics.jit import FLAGS, JIT_ENABLED, exact, fingerprint, with_rare_collection
from fastcoil.model.numerics.kernel_cache import KernelCache, kernel_folder

NUMBER, FLAG, ROW_POINTER, INTEGER = types.float64, types.boolean, types.CPointer(types.float64), types.int64
"""Types of a stage's arguments and of what it returns.  Rows go by their address alone: seven words less a call."""
BUILT_IN = np.intp(0) if JIT_ENABLED else 0
"""In place of an address: the kernel has this stage in its own machine code."""
_COMPILE_LOCK = threading.RLock()
_COMPILED_STAGES: list[Any] = []  # what has been compiled: machine code must not go away while its address is known


class StageSignature:
    """A kind of stage: the types of its arguments and of what it returns.

    ``call(address, arguments)`` is how a kernel calls one.
    """

    def __init__(self, *arguments: Any, returns: Any = types.void) -> None:
        self._arguments, self._returns = arguments, returns
        self.call = _make_caller(self._arguments, returns)

    def compiled(self, function: Callable[..., Any], identity: str) -> Any:
        """The address of ``function``, compiled.  In the interpreter: the function itself.

        identity: all that the function closes over, in words, by which it is found in the cache again.
        """
        if not JIT_ENABLED:
            return function
        stage: Any = CFunc(function, (self._arguments, self._returns), {}, dict(FLAGS))
        folder = kernel_folder(fingerprint())
        if folder is not None:
            stage._cache = KernelCache(function, folder, identity)
        with _COMPILE_LOCK:
            with_rare_collection(stage.compile)()
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
                    is_array = isinstance(given_type, types.Array)
                    llvm_values.append(
                        context.make_array(given_type)(context, builder, value).data
                        if is_array
                        else context.cast(builder, value, given_type, stage_type)
                    )
                result = builder.call(pointer, llvm_values)
                return context.get_dummy_value() if returns == types.void else result

            return returns(types.intp, stage_arguments), codegen

        return call

    @intrinsic(prefer_literal=True)
    def values_at(typingctx: Any, cls: Any, rows: Any, place: Any, stride: Any) -> Any:
        """A named tuple of class ``cls`` from ``rows[place]``, ``rows[place + stride]`` and so on."""
        tuple_class = cls.instance_class
        n = len(tuple_class._fields)

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            pointers = _pointers(builder, args[1:], n)
            return cgutils.pack_array(builder, [builder.load(p) for p in pointers], ir.DoubleType())

        tuple_type = types.NamedUniTuple(types.float64, n, tuple_class)
        return tuple_type(cls, rows, types.int64, types.int64), codegen

    @intrinsic
    def store_if_due(typingctx: Any, due: Any, values: Any, before: Any, rows: Any, place: Any, stride: Any) -> Any:
        """Store a tuple of numbers where ``values_at`` found it, or what was there ``before`` unless it is ``due``."""
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
        """``size`` numbers from ``rows[place]`` on, to be read and changed."""
        return carray(rows, (place + size,))[place:]

    def _pointers(builder: Any, args: Any, n: int) -> list[Any]:
        rows, place, stride = args
        steps = [builder.add(place, builder.mul(stride, stride.type(k))) for k in range(n)]
        return [builder.gep(rows, [step]) for step in steps]

else:

    def _make_caller(arguments: Any, returns: Any) -> Any:
        return lambda address, given: address(*given)

    def values_at(cls: Any, rows: Any, place: Any, stride: Any) -> Any:  # type: ignore[misc]
        """A named tuple of class ``cls`` from ``rows[place]``, ``rows[place + stride]`` and so on."""
        return cls(*(rows[place + stride * k] for k in range(len(cls._fields))))

    def store_if_due(due: Any, values: Any, before: Any, rows: Any, place: Any, stride: Any) -> None:  # type: ignore[misc]
        """Store a tuple of numbers where ``values_at`` found it, or what was there ``before`` unless it is ``due``."""
        for k, (new, old) in enumerate(zip(values, before, strict=True)):
            rows[place + stride * k] = new if due else old

    def array_at(rows: Any, place: Any, size: Any) -> Any:
        """``size`` numbers from ``rows[place]`` on, to be read and changed."""
        return rows[place : place + size]
