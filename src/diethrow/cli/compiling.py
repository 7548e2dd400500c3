"""The first compilation of the kernels, once per installation: announced, counted, and shared with other processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, TimeoutError
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

from ..executors import Processes, cores

SENTENCE = "compiling the kernels; this takes about a minute, once per installation"
MOST_HELPERS = 3
"""Processes that compile beside the first run. Each takes 0.5 GB, and the last kernels wait for one another."""
SECONDS_TO_START = 20.0
"""Time [s] in which a helper must have started; otherwise the run goes on alone."""


@contextmanager
def announced(say: Callable[[str], None]) -> Iterator[None]:
    """Report once, within the block, that a kernel is compiled for the cache."""
    unsaid = [SENTENCE]

    def begin(*_: Any) -> None:
        if unsaid:
            say(unsaid.pop())

    with _at_compilations(begin, lambda *_: None):
        yield


def is_compiled() -> bool:
    """Whether this installation's cache holds the kernel with which tracking begins."""
    from ..tracking.pose import refine_and_score

    cache: Any = getattr(refine_and_score, "_cache", None)
    return not hasattr(cache, "_cache_file") or bool(cache._cache_file._load_index())


@contextmanager
def shared_compilation(run: str, report: Callable[[int, int], None]) -> Iterator[None]:
    """Compile what a run needs on the other cores as well, as soon as anything is compiled within the block.

    `run` is a name in the list of kernels. The helpers begin with what the run needs last, so that they meet the run halfway.
    They do nothing that the run waits for: without them, or if they fail, it compiles by itself. They end with the block, however
    it ends. `report` is called with the number of kernels compiled so far and their total.
    """
    with ExitStack() as stack:
        schedules: list[Any] = []

        def begin(dispatcher: Any, arguments: Any) -> None:
            if not schedules:
                schedules.append(_begin_shared(run, report, stack))
            schedules[0].begin(Version.of(dispatcher, arguments))

        def end(dispatcher: Any, arguments: Any) -> None:
            if schedules:
                schedules[0].end(Version.of(dispatcher, arguments))

        from ..model.kernel_versions import Version

        stack.enter_context(_at_compilations(begin, end))
        yield


def _begin_shared(run: str, report: Callable[[int, int], None], stack: ExitStack) -> Any:
    """A schedule of what is missing, and the helpers that follow it until the stack is left."""
    from ..kernel_list import Schedule, missing
    from ..model.kernel_versions import rare_collections

    stack.enter_context(rare_collections())
    schedule = Schedule(missing(run), last_first=True, report=report)
    helpers = min(cores() - 1, MOST_HELPERS)
    if helpers >= 1 and schedule.total > 1:
        processes = Processes(helpers)
        stack.callback(processes.shutdown)
        stack.callback(processes.stop)
        # Started here and now: numba reads the environment while it compiles, which the start of a process changes for a moment.
        with suppress(RuntimeError, OSError, TimeoutError):
            for answer in [processes.submit(_started) for _ in range(helpers)]:
                answer.result(SECONDS_TO_START)
            threads = stack.enter_context(ThreadPoolExecutor(helpers))
            stack.callback(processes.stop)
            stack.callback(schedule.give_up)
            for _ in range(helpers):
                threads.submit(schedule.serve, processes)
    return schedule


def _started() -> None:
    """What a helper is asked first."""


@contextmanager
def _at_compilations(begin: Callable[..., None], end: Callable[..., None]) -> Iterator[None]:
    """Call `begin` and `end` about the compilation of each kernel of this package that the cache will keep.

    Both get numba's compiled function and the types of the arguments.
    """
    from numba.core import event
    from numba.core.caching import NullCache

    def is_ours(happening: Any) -> bool:
        # Functions of numba itself and kernels without a cache do not count.
        dispatcher = happening.data["dispatcher"]
        ours = dispatcher.py_func.__module__.startswith("diethrow.")
        return bool(ours and not isinstance(dispatcher._cache, NullCache))

    class Listener(event.Listener):
        def on_start(self, happening: Any) -> None:
            if is_ours(happening):
                begin(happening.data["dispatcher"], happening.data["args"])

        def on_end(self, happening: Any) -> None:
            if is_ours(happening):
                end(happening.data["dispatcher"], happening.data["args"])

    listener = Listener()
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)
