"""Versions of kernels: a kernel and the types of its arguments, as text that a file can hold, and compilation on purpose.

A kernel is compiled for the types of the arguments that it is first called with. A list of these types allows to compile a kernel
before, without data, and in another process than the one that calls it.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from importlib import import_module
from typing import Any

from numba import types

Encoded = str | list[Any]
"""A type as JSON: a string for numbers and arrays, `[kind, ..., parts]` for what is made of other types."""
RARE_COLLECTIONS = (20_000, 50, 100)
"""Thresholds of the garbage collector while kernels are compiled. The process grows by a tenth."""


@dataclass(frozen=True)
class Version:
    """A kernel for one set of argument types."""

    module: str
    kernel: str
    arguments: tuple[Any, ...]
    """numba's types."""

    @classmethod
    def of(cls, dispatcher: Any, arguments: Sequence[Any]) -> Version:
        """The version of a compiled function for numba's types of its arguments."""
        function = dispatcher.py_func
        return cls(function.__module__, function.__qualname__, tuple(arguments))

    @property
    def dispatcher(self) -> Any:
        """numba's compiled function. Raises ImportError or AttributeError if there is none of that name."""
        return _named(self.module, self.kernel)

    def is_kept(self) -> bool:
        """Whether the cache has it."""
        kernel: Any = self.dispatcher
        return bool(kernel._cache.has(self.arguments, kernel.targetctx))

    def compile(self) -> None:
        """Compile it for the cache, with all that it calls. Raises numba's errors for types that do not fit."""
        if not self.is_kept():
            self.dispatcher.compile(self.arguments)


@contextmanager
def rare_collections() -> Iterator[None]:
    """Fewer collections of garbage within the block, and none of what is there already: they take 15 % of a compilation."""
    before = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(*RARE_COLLECTIONS)
    try:
        yield
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()


def encode(kind: Any) -> Encoded:
    """A numba type as JSON. Raises TypeError for a kind of type that no kernel of this package takes."""
    if isinstance(kind, types.Array) and kind.aligned:
        writable = "" if kind.mutable else " readonly"
        return f"{kind.dtype.name}[{kind.ndim}{kind.layout}]{writable}"
    if isinstance(kind, types.BaseNamedTuple):
        record = kind.instance_class
        return ["record", record.__module__, record.__qualname__, [encode(each) for each in kind.types]]
    if isinstance(kind, types.BaseTuple):
        return ["tuple", [encode(each) for each in kind.types]]
    if isinstance(kind, types.Optional):
        return ["optional", [encode(kind.type)]]
    if isinstance(kind, types.Omitted):
        return ["omitted", kind.value]
    if isinstance(kind, types.Number | types.Boolean | types.NoneType):
        return str(kind.name)
    raise TypeError(f"{kind}: no type of an argument that a list of kernels can hold")


def decode(text: Encoded, before: Sequence[Any]) -> Any:
    """The type that `encode` wrote, where types within it are numbers of types `before`.

    Raises ImportError, AttributeError or ValueError if it does not exist any more.
    """
    if isinstance(text, str):
        name, _, rest = text.partition("[")
        scalar = {"bool": types.boolean}.get(name) or getattr(types, name)
        return types.Array(scalar, int(rest[0]), rest[1], readonly=rest.endswith("readonly")) if rest else scalar
    kind, *parts = text
    if kind == "omitted":
        return types.Omitted(parts[0])
    inner = [before[each] for each in parts[-1]]
    if None in inner:
        raise ValueError(f"{text} is made of a type that does not exist any more")
    if kind == "optional":
        return types.Optional(inner[0])
    if kind == "tuple":
        return types.BaseTuple.from_types(inner)
    module, name, _ = parts
    record = _named(module, name)
    if len(record._fields) != len(inner):
        raise ValueError(f"{module}.{name} has {len(record._fields)} fields, not {len(inner)}")
    return types.BaseTuple.from_types(inner, record)


def _named(module: str, name: str) -> Any:
    """What a module calls so."""
    return reduce(getattr, name.split("."), import_module(module))
