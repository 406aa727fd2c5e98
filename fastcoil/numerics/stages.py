"""Stages: loops over lanes that are compiled apart and called by their address, so that a kernel is compiled once.

A kernel takes a stage as an argument.  All stages of one kind have one signature, so that the kernel is the same
machine code whichever of them it is given; one more stage costs about a second, one more kernel 16.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.ccallback import CFunc
from numba.extending import intrinsic

from fastcoil.numerics.jit import FLAGS, JIT_ENABLED, fingerprint
from fastcoil.numerics.kernel_cache import KernelCache, kernel_folder

NUMBER, FLAG, ROWS, WHOLE, NOTHING = types.float64, types.boolean, types.float64[::1], types.int64, types.void
"""Types of a stage's arguments and of what it returns."""
_COMPILING = threading.RLock()


class Stage(types.WrapperAddressProtocol):  # type: ignore[misc]
    """A compiled loop over lanes; numba takes it for a function of its signature.

    function: the loop.  signature: (types of its arguments, type of its result).  identity: all that the loop closes
    over, in words, by which it is found in the cache again.  about: what it was made of, for the host.
    """

    def __init__(self, function: Callable[..., Any], signature: Any, identity: str, about: Any = None) -> None:
        self.about = about
        self._function = function
        self._arguments, self._result = signature
        if JIT_ENABLED:
            self._compiled = CFunc(function, (self._arguments, self._result), {}, dict(FLAGS))
            folder = kernel_folder(fingerprint())
            if folder is not None:
                self._compiled._cache = KernelCache(function, folder, identity)
            with _COMPILING:
                self._compiled.compile()

    def __wrapper_address__(self) -> int:
        """Where the machine code starts."""
        return int(self._compiled.address)

    def signature(self) -> Any:
        """The signature, in Numba's types."""
        return self._result(*self._arguments)

    def __call__(self, *arguments: Any) -> Any:
        """Run the loop in the interpreter."""
        return self._function(*arguments)


if JIT_ENABLED:

    @intrinsic(prefer_literal=True)
    def values_at(typingctx: Any, cls: Any, rows: Any, place: Any, stride: Any) -> Any:
        """A named tuple of class ``cls`` from ``rows[place]``, ``rows[place + stride]``, …"""
        made = cls.instance_class
        n = len(made._fields)

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            pointers = _pointers(context, builder, signature.args[1], args[1:], n)
            return cgutils.pack_array(builder, [builder.load(p) for p in pointers], ir.DoubleType())

        named = types.NamedUniTuple(types.float64, n, made)
        return named(cls, rows, types.int64, types.int64), codegen

    @intrinsic
    def keep(typingctx: Any, due: Any, values: Any, before: Any, rows: Any, place: Any, stride: Any) -> Any:
        """Store a tuple of numbers where ``values_at`` found it, or what was there ``before`` unless it is ``due``."""
        kinds = list(values)

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            pointers = _pointers(context, builder, signature.args[3], args[3:], len(kinds))
            for k, (kind, pointer) in enumerate(zip(kinds, pointers, strict=True)):
                new = context.cast(builder, builder.extract_value(args[1], k), kind, types.float64)
                old = builder.extract_value(args[2], k)
                builder.store(builder.select(args[0], new, old), pointer)
            return context.get_dummy_value()

        return types.void(types.boolean, values, before, rows, types.int64, types.int64), codegen

    def _pointers(context: Any, builder: Any, array: Any, args: Any, n: int) -> list[Any]:
        rows, place, stride = args
        data = context.make_array(array)(context, builder, rows).data
        steps = [builder.add(place, builder.mul(stride, stride.type(k))) for k in range(n)]
        return [builder.gep(data, [step]) for step in steps]

else:

    def values_at(cls: Any, rows: Any, place: int, stride: int) -> Any:
        """A named tuple of class ``cls`` from ``rows[place]``, ``rows[place + stride]``, …"""
        return cls(*(rows[place + stride * k] for k in range(len(cls._fields))))

    def keep(due: bool, values: Any, before: Any, rows: Any, place: int, stride: int) -> None:
        """Store a tuple of numbers where ``values_at`` found it, or what was there ``before`` unless it is ``due``."""
        for k, (new, old) in enumerate(zip(values, before, strict=True)):
            rows[place + stride * k] = new if due else old
