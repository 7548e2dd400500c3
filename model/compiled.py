"""How kernels are compiled: `@compiled` for a function of numbers and arrays, `@inner` for one that only kernels call.

A kernel is compiled when it is first called, and kept in a cache beside its file. A user waits for that first call, and most of
the time is numba's own work on types and code, for each set of argument types. Six rules keep it short:

- No wrapper for calls from C, because there are none. It contains the whole kernel once more, and takes a quarter of the time.
- No wrapper for calls from Python where there are none. It takes 25 ms of the 60 ms of the smallest function. A call of such
  a kernel from Python ends the process without an error message.
- No literals as arguments. numba takes a literal such as -1 for a type of its own, so that f(-1) and f(i) are two functions, and
  all that f calls is compiled twice. Kernels made here take it for an integer as any other.
- No `a[:] = b` for arrays in kernels that every throw needs. Its check of shapes formats strings, which takes some seconds in
  the first file that has it. A loop takes a tenth of a second.
- No machine code for what only kernels call: `inner` kernels are copied into their callers.
- One machine code for a large kernel that several kernels call: `@inner(shared=True)`. Copied into its callers, it would be
  optimised in each of them. A call takes its time, too, so small kernels are better copied.

After a change of kernels or of their arguments, `python benchmarks/kernel_list.py` writes the list of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit, types

from .kernel_cache import KernelCache
from .kernel_library import EntryCompiler, LinkedCompiler, SharedCompiler


def compiled(function: Callable[..., Any] | None = None, *, shared: bool = False, **options: Any) -> Any:
    """`@compiled`, or `@compiled(nogil=True)` for what several threads call.

    `shared` is for a large kernel that several kernels call, or one from several places. They call its one machine code; others
    are copied into their callers, and optimised there once more.
    """
    if function is None:
        return partial(compiled, shared=shared, **options)
    only_kernels_call = options.get("no_cpython_wrapper", False)
    compiler = SharedCompiler if shared else LinkedCompiler if only_kernels_call else EntryCompiler
    kernel: Any = njit(function, no_cfunc_wrapper=True, pipeline_class=compiler, **options)
    if kernel is not function:  # with NUMBA_DISABLE_JIT it is the function itself
        kernel._cache = KernelCache(function)
        kernel.get_call_template = partial(_call_without_literals, kernel.get_call_template)
    return kernel


def _call_without_literals(template: Callable[..., Any], arguments: Any, named: Any) -> Any:
    """numba's choice of a version for a call from a kernel, where a literal such as -1 is an integer as any other."""
    return template(
        tuple(map(types.unliteral, arguments)), {name: types.unliteral(each) for name, each in named.items()}
    )


inner: Any = partial(compiled, no_cpython_wrapper=True)
"""For a kernel that only kernels call."""

_SUMS_IN_ANY_ORDER = {"reassoc", "contract", "nsz"}
inner_nogil: Any = inner(nogil=True)
"""For an inner kernel that threads call."""
inner_no_memory: Any = inner(nogil=True, _nrt=False)
"""The same for a kernel that allocates nothing. It counts no references to arrays, which takes a quarter of the time of a small
kernel."""
inner_fast_sums: Any = inner(nogil=True, fastmath=_SUMS_IN_ANY_ORDER)
"""The same for plain sums over pixels, whose order is left to the compiler: four times the speed at the same accuracy."""
inner_fast_sums_no_memory: Any = inner(nogil=True, _nrt=False, fastmath=_SUMS_IN_ANY_ORDER)
"""Such a sum that allocates nothing."""


def int64(value: int) -> int:
    """A constant for kernels whose value is no part of its type."""
    constant: Any = np.int64(value)  # the type checker does not take it for an int
    return constant


def truth(value: bool) -> bool:
    """A truth value for kernels whose value is no part of its type."""
    constant: Any = np.bool_(value)
    return constant
