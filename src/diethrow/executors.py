"""Executors: local processes, each of which may die alone, and Dask clusters; and limits on threads.

This module imports no numerical library, because a worker must set its limits before the libraries read them.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

THREAD_LIMITS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Environment variables that the libraries below numpy, scipy and numba read when they are loaded."""
ANSWER_S = 10.0
"""Time [s] for a scheduler to answer."""
SECONDS_TO_STOP = 5.0
"""Time [s] for a worker to clean up before it is killed."""


class WorkerLostError(RuntimeError):
    """The process that executed a call died, by a signal or for lack of memory."""


def _refused(text: str) -> ValueError:
    """The error of an impossible value; its module loads the numerical libraries."""
    from .model.errors import InputError

    return InputError(text)


class Processes(Executor):
    """Single processes of this machine, one core each.

    Unlike in a `ProcessPoolExecutor`, the death of a worker affects only its current call: that call raises WorkerLostError,
    and a new process replaces the worker. Workers end with their parent, however it ends, and ignore Ctrl-C, which their
    parent handles.
    """

    def __init__(self, workers: int) -> None:
        """`workers` processes, started when first needed. Raises ValueError below 1."""
        if workers < 1:
            raise _refused(f"{workers} workers: wanted 1 or more")
        self.workers = workers
        self._own = threading.local()
        self._all: set[_Worker] = set()
        self._stopped = False
        # One thread waits for each process; submitted calls queue before the threads.
        self._threads = ThreadPoolExecutor(workers)

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """As `Executor.submit`; function, arguments and result are pickled between processes of this machine."""
        return self._threads.submit(self._ask, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As `Executor.shutdown`."""
        self._threads.shutdown(wait=wait, cancel_futures=cancel_futures)
        if wait:
            for worker in self._all:
                worker.end()
            self._all.clear()

    def stop(self) -> None:
        """End the workers, also those at work: their calls raise WorkerLostError, and later ones are refused."""
        self._stopped = True
        self._threads.shutdown(wait=False, cancel_futures=True)
        workers = list(self._all)
        for worker in workers:
            worker.process.terminate()
        slow = threading.Timer(SECONDS_TO_STOP, _kill, [workers])
        slow.start()
        self._threads.shutdown(wait=True)
        slow.cancel()

    def __exit__(self, *failure: object) -> None:
        if any(failure):
            self.stop()
        self.shutdown(wait=True)

    def _ask(self, fn: Callable[..., T], args: Any, kwargs: Any) -> T:
        """Run one call in the process of this thread, and replace the process if it died."""
        worker: _Worker | None = getattr(self._own, "worker", None)
        if worker is None or not worker.process.is_alive():
            if self._stopped:
                raise WorkerLostError("the workers were stopped")
            worker = _Worker()
            self._own.worker = worker
            self._all.add(worker)
        try:
            done, value = worker.ask((fn, args, kwargs))
        except (EOFError, OSError) as error:
            self._all.discard(worker)
            self._own.worker = None
            raise WorkerLostError(f"the worker process died ({worker.end()})") from error
        if not done:
            raise value
        result: T = value
        return result


class _Worker:
    """A process and the pipe to it."""

    def __init__(self) -> None:
        # Spawned, not forked: the threads of the libraries in this process do not survive a fork.
        context = get_context("spawn")
        self._pipe, far_end = context.Pipe()
        self.process: BaseProcess = context.Process(target=_serve, args=(far_end,), daemon=True)
        with _limits_in_environment():
            self.process.start()
        far_end.close()

    def ask(self, call: tuple[Any, ...]) -> tuple[bool, Any]:
        """Whether the call returned, and its result or exception. Raises EOFError or OSError if the process died."""
        self._pipe.send(call)
        done, value = self._pipe.recv()
        return bool(done), value

    def end(self) -> str:
        """Close the pipe, wait for the process, and return how it ended."""
        self._pipe.close()
        self.process.join(SECONDS_TO_STOP)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        code = self.process.exitcode or 0
        if code >= 0:
            return f"exit status {code}"
        hint = ", perhaps for lack of memory" if -code == 9 else ""
        return f"{signal.Signals(-code).name}{hint}"


def _kill(workers: Iterable[_Worker]) -> None:
    for worker in workers:
        worker.process.kill()


def _serve(pipe: Connection) -> None:
    """The loop of a worker: receive a call, execute it, return the result, until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, daemon=True).start()
    while True:
        try:
            fn, args, kwargs = pipe.recv()
        except EOFError:
            return
        try:
            answer: tuple[bool, Any] = True, fn(*args, **kwargs)
        except KeyboardInterrupt:  # what SIGTERM is turned into while an output is written
            return
        except Exception as error:  # raised again in the parent
            answer = False, error
        pipe.send(answer)


def _die_with_parent() -> None:
    """End with the parent, which cannot stop its workers when it is killed; at once, so that no lock remains."""
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


_ENVIRONMENT = threading.Lock()
"""Held while the environment has the limits of workers."""


@contextmanager
def _limits_in_environment() -> Iterator[None]:
    """One thread per library in the processes started within the block. Blocks wait for each other: one that ends within another
    would lift its limits."""
    with _ENVIRONMENT:
        before = {name: os.environ.get(name) for name in THREAD_LIMITS}
        os.environ.update(dict.fromkeys(THREAD_LIMITS, "1"))
        try:
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value


class _OneThread:
    """The number of active `one_thread` blocks, and how to restore the limits before the first."""

    lock = threading.Lock()
    blocks = 0
    undo: Callable[[], None]


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra and OpenCV on one thread within the block.

    Sums over several threads are rounded in another order, and results must not depend on the number of cores.
    """
    with _OneThread.lock:
        if _OneThread.blocks == 0:
            _OneThread.undo = _limit_to_one_thread()
        _OneThread.blocks += 1
    try:
        yield
    finally:
        with _OneThread.lock:
            _OneThread.blocks -= 1
            if _OneThread.blocks == 0:
                _OneThread.undo()


def _limit_to_one_thread() -> Callable[[], None]:
    """Set the limits of this process and return the function that restores them."""
    import cv2
    from threadpoolctl import threadpool_limits

    before = cv2.getNumThreads()
    limits = threadpool_limits(limits=1, user_api="blas")
    cv2.setNumThreads(1)

    def undo() -> None:
        limits.restore_original_limits()
        cv2.setNumThreads(before)

    return undo


@contextmanager
def loaded_ahead(*modules: str) -> Iterator[None]:
    """Load modules in a thread while the block runs, which waits for the thread at its end. A module that cannot be loaded raises
    its error where it is used."""

    def load() -> None:
        for name in modules:
            with suppress(ImportError):
                import_module(name)

    thread = threading.Thread(target=load, name="loading")
    thread.start()
    try:
        yield
    finally:
        thread.join()


@contextmanager
def cluster_at(address: str) -> Iterator[Executor]:
    """An executor on the Dask cluster whose scheduler is at `address` (tcp://host:port).

    Every worker must see the same files under the same paths, and have this version installed. Raises ValueError if Dask is not
    installed or the versions differ, ConnectionError if no scheduler answers.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError as error:
        raise _refused("--scheduler needs Dask; try pip install 'diethrow[distributed]'") from error
    try:
        client = Client(address, timeout=ANSWER_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = " ".join(str(error).split())
        raise ConnectionError(
            f"no Dask scheduler answers at {address} ({reason}); start one there with dask scheduler"
        ) from error
    try:
        _demand_same_version(client, address)
        yield client.get_executor(pure=False)
    except KilledWorker as error:
        raise ConnectionError(
            f"workers of the cluster at {address} died during their work ({error}); see their logs"
        ) from error
    finally:
        client.close()


def _demand_same_version(client: Any, address: str) -> None:
    """Raises ValueError for a cluster without workers, or with workers of another version."""
    from . import __version__

    versions = client.run(_version)
    if not versions:
        raise _refused(f"the cluster at {address} has no workers; start some with dask worker {address}")
    for worker, version in versions.items():
        if version != __version__:
            raise _refused(f"{worker} has diethrow {version}, and this is {__version__}; install the same everywhere")


def _version() -> str:
    from . import __version__

    return __version__


def width(executor: Executor) -> int:
    """Number of calls that an executor runs at the same time; this machine's cores if it does not state one."""
    client = getattr(executor, "_client", None)
    if client is not None and hasattr(client, "nthreads"):
        return max(1, sum(client.nthreads().values()))
    for name in ("workers", "_max_workers"):
        count = getattr(executor, name, None)
        if isinstance(count, int):
            return max(1, count)
    return cores()


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
