"""How kernels are compiled: `@compiled` in front of a function of numbers and arrays, `@inner` where only others call it.

A kernel is compiled when it is first called, and kept in a cache beside its file. That first time is what a user waits
for, and most of it is numba's own work on types and code, in Python, for each set of argument types. What keeps it short:

- No wrapper for calls from C, of which there are none here: it holds the whole kernel once more, and costs a quarter.
- No wrapper for calls from Python where there are none. It costs 25 ms of the 60 of the smallest function. Python must not
  call such a kernel: there is no error, but the end of the process.
- A literal such as -1 is a type of its own, so that f(-1) and f(i) are two functions, and all that f calls is compiled
  twice. What is passed on, or begins a loop and is passed on in it, is one of the constants `int64` and `truth` make.
- `a[:] = b` for arrays brings in the check of shapes, whose message is put together of strings: some seconds in the first
  file that has it. A loop costs a tenth of a second.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit

from .kernel_cache import KernelCache


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`@compiled`, or `@compiled(nogil=True)` for what threads call."""
    if function is None:
        return partial(compiled, **options)
    kernel: Any = njit(function, no_cfunc_wrapper=True, **options)
    if kernel is not function:  # with NUMBA_DISABLE_JIT it is the function itself
        kernel._cache = KernelCache(function)
    return kernel


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
    """A constant for kernels that is not compiled into the type of what it is passed to."""
    constant: Any = np.int64(value)  # no int to the type checker, though it is one to all that use it
    return constant


def truth(value: bool) -> bool:
    """The same for a truth value."""
    constant: Any = np.bool_(value)
    return constant
