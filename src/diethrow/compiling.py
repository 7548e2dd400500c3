"""The kernels are compiled when they are first called, once for an installation: said in one line, so that nobody waits in
the dark."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

SENTENCE = "compiling the kernels, once for this installation; it takes a minute or two, and later runs load them"


@contextmanager
def announced(say: Callable[[str], None]) -> Iterator[None]:
    """Say once when a kernel is compiled within the block that was in no cache, and will be."""
    from numba.core import event
    from numba.core.caching import NullCache

    class Announcement(event.Listener):
        def __init__(self) -> None:
            self.said = False

        def on_start(self, happening: Any) -> None:
            # Some small kernels are compiled in every run, on purpose; of numba's own functions nobody need know.
            dispatcher = happening.data["dispatcher"]
            ours = dispatcher.py_func.__module__.startswith("diethrow.")
            if ours and not self.said and not isinstance(dispatcher._cache, NullCache):
                self.said = True
                say(SENTENCE)

        def on_end(self, happening: Any) -> None:
            pass

    listener = Announcement()
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)
