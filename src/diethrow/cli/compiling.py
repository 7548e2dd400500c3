"""The first compilation of the kernels, once per installation: announced in one line, and shared with a second process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from ..executors import Processes, cores

SENTENCE = "compiling the kernels; this takes about a minute, once per installation"


@contextmanager
def announced(say: Callable[[str], None]) -> Iterator[None]:
    """Report once, within the block, that a kernel is compiled for the cache."""
    with _at_first_compilation(lambda: say(SENTENCE)):
        yield


def is_compiled() -> bool:
    """Whether this installation's cache holds the kernel with which tracking begins."""
    from ..tracking.pose import refine_and_score

    cache: Any = getattr(refine_and_score, "_cache", None)
    return not hasattr(cache, "_cache_file") or bool(cache._cache_file._load_index())


@contextmanager
def model_ahead() -> Iterator[None]:
    """Compile the model's kernels in a second process as soon as anything is compiled within the block.

    No process starts if the kernels are in the cache or if there is only one core. The process ends with the block, however
    the block ends.
    """
    with ExitStack() as stack:

        def begin() -> None:
            if cores() > 1:
                helper = stack.enter_context(Processes(1))
                stack.callback(helper.stop)
                helper.submit(compile_model)  # a failure there occurs here as well, and is reported here

        stack.enter_context(_at_first_compilation(begin))
        yield


def compile_model() -> None:
    """Simulate and differentiate one throw in every way that a fit may need."""
    import numpy as np

    from ..model import CoulombImpact, SmoothImpact, State, make_die, throw_die
    from ..model.throw import propagate

    die = make_die("cube", edge_m=0.02, mass_kg=0.016)
    release = State(
        0.0, np.array([0.0, 0.0, 0.1]), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([3.0, 4.0, 2.0])
    )
    propagate(die, release, SmoothImpact(0.5), [0.0], vertices=[0])
    throw_die(die, release, SmoothImpact(0.5))
    rough = CoulombImpact(chi=0.5, mu=0.2)
    propagate(die, release, rough, [0.0], vertices=[0], parameters=("chi", "mu"))
    propagate(die, release, SmoothImpact(0.5), [0.0], vertices=[0], parameters=("chi", "drag_per_m"))


@contextmanager
def _at_first_compilation(do: Callable[[], None]) -> Iterator[None]:
    """Call `do` once, when the compilation of a kernel of this package that the cache will keep begins."""
    from numba.core import event
    from numba.core.caching import NullCache

    class First(event.Listener):
        def __init__(self) -> None:
            self.done = False

        def on_start(self, happening: Any) -> None:
            # Functions of numba itself and kernels without a cache are not announced.
            dispatcher = happening.data["dispatcher"]
            ours = dispatcher.py_func.__module__.startswith("diethrow.")
            if ours and not self.done and not isinstance(dispatcher._cache, NullCache):
                self.done = True
                do()

        def on_end(self, happening: Any) -> None:
            pass

    listener = First()
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)
