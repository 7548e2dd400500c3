"""Where the machine code of kernels goes, so that the first run does not make the same code several times.

numba gives every compiled function a *library*: a module of LLVM code and the machine code made of it. The module of a caller
contains a copy of each callee, and of all that these call, so that small functions can be merged into their callers. numba also
makes machine code of each callee by itself. Much of the time that LLVM takes goes into code that is never run, or was already
made. Three kinds of libraries avoid this:

- `EntryLibrary`: the kernel is called from Python. As numba's, in all but the environments, see there.
- `LinkedLibrary`: only kernels call the kernel. It is copied into its callers, and has no machine code of its own.
- `SharedLibrary`: a large kernel that several kernels call. Callers call its one machine code instead of a copy of it.

Machine code in the cache that calls a shared kernel names the code by a symbol. The symbol must be the same in every process, so
it contains a digest of the sources instead of numba's count of compilations. What the cache keeps of a caller names the shared
kernels that it calls, and they are loaded before it.

These classes are not part of numba's documented interface, as those of `kernel_cache`; the tests run on the lowest version, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import reduce
from importlib import import_module
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.environment import lookup_environment

from .source_digest import source_digest

_DIGITS_OF_A_SYMBOL = 15
"""Hexadecimal digits of the digest in a symbol: the number has less than 64 bits."""
_ENVIRONMENT = "_ZN08NumbaEnv"
"""How symbols of environments begin."""


@dataclass(frozen=True)
class SharedKernel:
    """A shared kernel that other code calls."""

    symbol: str
    module: str
    kernel: str
    arguments: tuple[Any, ...]
    """numba's types."""

    def load(self) -> None:
        """Load its machine code from the cache, or make it."""
        dispatcher: Any = reduce(getattr, self.kernel.split("."), import_module(self.module))
        dispatcher.compile(self.arguments)


_SHARED: dict[str, SharedKernel] = {}
"""The shared kernels of this process by their symbols."""


def _called_by(code: Any) -> tuple[SharedKernel, ...]:
    """The shared kernels that an LLVM module calls."""
    return tuple(_SHARED[one.name] for one in code.functions if one.is_declaration and one.name in _SHARED)


@dataclass(frozen=True)
class _Kept:
    """What the cache keeps of a library."""

    bitcode: bytes
    """LLVM's code, for copies in callers."""
    calls: tuple[SharedKernel, ...]
    machine_code: bytes = b""
    symbols: tuple[str, ...] = ()
    """Those that the machine code defines."""


class MissingCodeError(RuntimeError):
    """Machine code calls shared kernels that are not there. LLVM would end the process."""


class EntryLibrary(JITCodeLibrary):
    """The library of a kernel that Python calls.

    The machine code of each function holds where its environment (constants that are Python objects) lies, which numba writes
    into it. The code of a kernel that is copied into this one holds it here.
    """

    KIND = "entry"
    _bitcode = b""
    _shared_module: Any

    def _finalize_specific(self) -> None:
        super()._finalize_specific()
        for variable in self._final_module.global_variables:
            environment = lookup_environment(variable.name) if variable.name.startswith(_ENVIRONMENT) else None
            if environment is not None and not variable.is_declaration:
                self._codegen.set_env(variable.name, environment)

    def _finalize_final_module(self) -> None:
        self._demand(_called_by(self._final_module))
        super()._finalize_final_module()

    def _demand(self, kernels: Iterable[SharedKernel]) -> None:
        """Raises MissingCodeError unless there is machine code of the kernels."""
        missing = [one.kernel for one in kernels if not self._codegen._engine.is_symbol_defined(one.symbol)]
        if missing:
            raise MissingCodeError(f"{self.name} calls {', '.join(missing)}, which could not be loaded")

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None and self._bitcode:
            self._shared_module = llvm.parse_bitcode(self._bitcode)
        return super()._get_module_for_linking()

    def serialize_using_object_code(self) -> tuple[str, str, _Kept]:
        """What the cache keeps."""
        bitcode = self._get_module_for_linking().as_bitcode()
        code = self._final_module
        symbols = [value.name for value in (*code.functions, *code.global_variables) if not value.is_declaration]
        kept = _Kept(bitcode, _called_by(code), self._get_compiled_object(), tuple(symbols))
        return self.name, self.KIND, kept

    @classmethod
    def loaded(cls, codegen: Any, name: str, kept: _Kept) -> EntryLibrary:
        """The library as the cache has it. Raises MissingCodeError."""
        library = cls(codegen, name)
        library._demand(kept.calls)
        library.enable_object_caching()
        library._set_compiled_object(kept.machine_code)
        library._bitcode = kept.bitcode
        library._finalize_final_module()
        codegen._engine._defined_symbols.update(kept.symbols)
        return library


class SharedLibrary(EntryLibrary):
    """The library of a kernel that kernels call by its symbol."""

    KIND = "shared"

    def _get_module_for_linking(self) -> Any:
        """Nothing: the caller's own module declares the symbol."""
        self._ensure_finalized()
        if self._shared_module is None:
            self._shared_module = llvm.parse_assembly(str(self._codegen._create_empty_module(self.name)))
        return self._shared_module


class LinkedLibrary(JITCodeLibrary):
    """The library of a kernel that only kernels call: copied into them, without machine code of its own."""

    KIND = "linked"

    @property
    def codegen(self) -> Any:
        return _WithoutEnvironments(self._codegen)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Null: there is no machine code."""
        self._ensure_finalized()
        return 0

    def serialize_using_object_code(self) -> tuple[str, str, _Kept]:
        """What the cache keeps."""
        code = self._get_module_for_linking()
        return self.name, self.KIND, _Kept(code.as_bitcode(), _called_by(code))

    @classmethod
    def loaded(cls, codegen: Any, name: str, kept: _Kept) -> LinkedLibrary:
        """The library as the cache has it."""
        library = cls(codegen, name)
        library._shared_module = library._final_module = llvm.parse_bitcode(kept.bitcode)
        library._finalized = True
        return library


class _WithoutEnvironments:
    """A code generator for kernels whose environments no machine code reads."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, name: str, environment: Any) -> None:
        """Nothing to set."""


class EntryCompiler(Compiler):
    """numba's compiler, for a kernel that Python calls."""

    _library: type[JITCodeLibrary] = EntryLibrary

    def define_pipelines(self) -> Any:
        """numba's passes, with the library that they fill."""
        state = self.state
        if state.library is None:
            state.library = self._library(state.targetctx.codegen(), state.func_id.func_qualname)
            state.library.enable_object_caching()
        return super().define_pipelines()


class LinkedCompiler(EntryCompiler):
    """numba's compiler, for a kernel that is copied into its callers."""

    _library = LinkedLibrary


class SharedCompiler(EntryCompiler):
    """numba's compiler, for a kernel that kernels call by a symbol that is the same in every process."""

    _library = SharedLibrary

    def define_pipelines(self) -> Any:
        """numba's passes, with the library that they fill and the symbol."""
        function = self.state.func_id
        digest = source_digest(Path(function.func.__code__.co_filename))
        function.unique_id = int(digest[:_DIGITS_OF_A_SYMBOL], 16)
        return super().define_pipelines()


def from_cache(target: Any, rebuild: Callable[..., Any], payload: Any) -> Any:
    """numba's result of a compilation from what the cache keeps of it, with a library of the right kind.

    Raises MissingCodeError if it calls a shared kernel that could not be loaded.
    """
    result = rebuild(_Target(target), payload)._replace(target_context=target)
    note_shared(result)
    return result


def note_shared(result: Any) -> None:
    """Note a shared kernel that was compiled or loaded, for what the cache keeps of its callers."""
    if isinstance(result.library, SharedLibrary):
        described = result.fndesc
        symbol, arguments = described.mangled_name, tuple(result.signature.args)
        _SHARED[symbol] = SharedKernel(symbol, described.modname, described.qualname, arguments)


class _Target:
    """A target of compilation whose code generator knows the libraries here."""

    def __init__(self, target: Any) -> None:
        self._target = target

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)

    def codegen(self) -> Any:
        """The code generator."""
        return _Codegen(self._target.codegen())


class _Codegen:
    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def unserialize_library(self, kept: tuple[str, str, Any]) -> Any:
        """The library of a kernel as the cache keeps it."""
        name, kind, data = kept
        if isinstance(data, _Kept):
            for each in data.calls:
                each.load()
        for library in (EntryLibrary, LinkedLibrary, SharedLibrary):
            if kind == library.KIND:
                return library.loaded(self._codegen, name, data)
        return self._codegen.unserialize_library(kept)
