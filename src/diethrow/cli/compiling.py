"""The kernels are compiled when they are first called, once for an installation: said in one line, so that nobody waits in
the dark, and shared with a second process where there is a core for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from ..executors import Processes, cores

SENTENCE = "compiling the kernels, once for this installation; it takes a minute or so, and later runs load them"


@contextmanager
def announced(say: Callable[[str], None]) -> Iterator[None]:
    """Say once when a kernel is compiled within the block that was in no cache, and will be."""
    with _at_first_compilation(lambda: say(SENTENCE)):
        yield


def is_compiled() -> bool:
    """Whether the cache of this installation holds the kernel that tracking begins with."""
    from ..tracking.pose import look

    cache: Any = getattr(look, "_cache", None)
    return not hasattr(cache, "_cache_file") or bool(cache._cache_file._load_index())


@contextmanager
def model_ahead() -> Iterator[None]:
    """Where anything is compiled within the block, let another process compile what a fit needs of the model meanwhile.

    Nothing is started where the kernels are in the cache, or where there is but one core. The process is gone when the
    block ends, however it ends.
    """
    with ExitStack() as stack:

        def begin() -> None:
            if cores() > 1:
                helper = stack.enter_context(Processes(1))
                stack.callback(helper.stop)
                helper.submit(compile_model)  # what fails there fails here as well, and is told here

        stack.enter_context(_at_first_compilation(begin))
        yield


def compile_model() -> None:
    """A throw of no interest, simulated and differentiated in each of the ways that a fit may ask for."""
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
    """Do it once, when a kernel of ours begins to be compiled within the block that was in no cache, and will be."""
    from numba.core import event
    from numba.core.caching import NullCache

    class First(event.Listener):
        def __init__(self) -> None:
            self.done = False

        def on_start(self, happening: Any) -> None:
            # Some small kernels are compiled in every run, on purpose; of numba's own functions nobody need know.
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
