"""The origin of a result: enough to make it again, and to check that its inputs are unchanged."""

from __future__ import annotations

import hashlib
import importlib.metadata
import logging
import os
import platform
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

from .. import __version__
from ..model.die import Die
from ..model.errors import DiethrowError
from .csv_and_json import read_json, write_json

PACKAGES = (
    "av",
    "matplotlib",
    "numba",
    "numpy",
    "opencv-python-headless",
    "pydantic",
    "rerun-sdk",
    "scipy",
    "tifffile",
    "trimesh",
)
"""Packages whose version can change a result."""

CHUNK_BYTES = 1 << 18
"""Size of the pieces in which a file is read: they fit into the processor's cache."""
MAX_FOREGROUND_BYTES = 1 << 24
"""Files up to this size are hashed before the work begins, larger ones in a thread beside it. A clip of 8 GB takes some seconds,
and the stages that follow frame by frame leave a core idle."""


LOGGER = logging.getLogger("diethrow")


@dataclass(frozen=True)
class TimedStage:
    """One stage of a run, on the clock of the run."""

    stage: str
    thread: str
    """`main`, or the name of a thread that worked beside it."""
    start_s: float
    """Since the run began."""
    wall_s: float
    processor_s: float
    """Of this thread alone: threads that it started and waited for are not in it."""


@dataclass
class Stopwatch:
    """Times of the stages of a run."""

    seconds: dict[str, float] = field(default_factory=dict)
    """Duration of each stage of the main thread [s], in the order in which they ended."""
    line: list[TimedStage] = field(default_factory=list)
    """Every stage of every thread, in the order in which they ended."""
    _began_s: float = field(default_factory=time.perf_counter)
    _thread: threading.Thread = field(default_factory=threading.current_thread)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block under `name`; the times of a stage that is entered again add up."""
        start, start_processor = time.perf_counter(), time.thread_time()
        try:
            yield
        finally:
            passed, processor = time.perf_counter() - start, time.thread_time() - start_processor
            own = threading.current_thread() is self._thread
            thread = "main" if own else threading.current_thread().name
            self.line.append(TimedStage(name, thread, start - self._began_s, passed, processor))
            if own:
                self.seconds[name] = self.seconds.get(name, 0.0) + passed
            LOGGER.info("%s: %.3f s (thread %s, processor time %.3f s)", name, passed, thread, processor)

    @property
    def time_line(self) -> list[dict[str, Any]]:
        """The stages of all threads by their start, for `provenance.json`."""
        ordered = sorted(self.line, key=lambda one: one.start_s)
        return [{name: round(v, 4) if isinstance(v, float) else v for name, v in vars(one).items()} for one in ordered]


class InputChangedError(DiethrowError, OSError):
    """An input changed after the run began."""


@dataclass(frozen=True)
class InputFile:
    """A file as it was when it was hashed."""

    path: Path
    bytes: int
    sha256: str


def files_read(inputs: Iterable[Path]) -> tuple[InputFile, ...]:
    """Every file of the inputs with its digest; inputs may be files, folders of files, or patterns.

    Raises InputChangedError for a file that changes meanwhile, OSError for one that cannot be read.
    """
    return tuple(_file_read(path, _status(path)) for path in _files(tuple(inputs)))


class Inputs:
    """The files of a run as they were when it began."""

    def __init__(self, inputs: Iterable[Path]) -> None:
        """Raises OSError for a file that cannot be read. Large files are hashed in a thread, until `close`."""
        self._stop = threading.Event()
        self._reader = ThreadPoolExecutor(1, "inputs")
        self._begun: list[tuple[Path, os.stat_result]] = []
        self._read: list[InputFile | Future[InputFile]] = []
        try:
            for path in _files(tuple(inputs)):
                self._begin(path, _status(path))
        except BaseException:
            self.close()
            raise

    def _begin(self, path: Path, status: os.stat_result) -> None:
        self._begun.append((path, status))
        if status.st_size > MAX_FOREGROUND_BYTES:
            self._read.append(self._reader.submit(_file_read, path, status, self._stop))
        else:
            self._read.append(_file_read(path, status))

    @property
    def files(self) -> tuple[InputFile, ...]:
        """All files, after waiting for their digests. Raises InputChangedError for one that changed since the run began, and
        CancelledError for one that was not yet hashed at `close`."""
        return tuple(file.result() if isinstance(file, Future) else file for file in self._read)

    def first_changed(self) -> str:
        """The error message for the first file that changed; empty where none did."""
        for (path, before), file in zip(self._begun, self._read, strict=True):
            try:
                now = path.stat()
                if _is_same(before, now):
                    continue
                # The same bytes under a new time change no result; a file that is not yet hashed counts as changed.
                known = file.result() if isinstance(file, Future) and file.done() and not file.exception() else file
                if not isinstance(known, InputFile) or now.st_size != known.bytes or sha256(path) != known.sha256:
                    return _changed(path)
            except OSError:
                return f"{path} was removed, or can no longer be read, during the run; put it back and run again"
        return ""

    def close(self) -> None:
        """Stop hashing."""
        self._stop.set()
        self._reader.shutdown(cancel_futures=True)


@contextmanager
def unchanged_inputs(inputs: Iterable[Path]) -> Iterator[Inputs]:
    """The files of the inputs as they are now, which must not change during the block.

    Raises InputChangedError at the end of the block, or when it asks for the files; also instead of an error that a changed
    file may have caused.
    """
    held = Inputs(inputs)
    try:
        yield held
        changed = held.first_changed()
    except (ValueError, OSError) as error:
        if changed := held.first_changed():
            raise InputChangedError(changed) from error
        raise
    finally:
        held.close()
    if changed:
        raise InputChangedError(changed)


def demand_same(before: Iterable[InputFile], now: Iterable[InputFile]) -> None:
    """Raises InputChangedError for the first file that is not as it was."""
    for old, new in zip(before, now, strict=True):
        if old != new:
            raise InputChangedError(_changed(new.path))


def _file_read(path: Path, before: os.stat_result, stop: threading.Event | None = None) -> InputFile:
    try:
        digest, after = sha256(path, stop), path.stat()
    except OSError as error:
        raise _unreadable(path, error) from error
    if not _is_same(before, after):
        raise InputChangedError(_changed(path))
    return InputFile(path, before.st_size, digest)


def _status(path: Path) -> os.stat_result:
    try:
        return path.stat()
    except OSError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: OSError) -> OSError:
    reason = (error.strerror or str(error)).lower()
    return OSError(f"{path} cannot be read ({reason}); wanted a file that this user may read")


def _changed(path: Path) -> str:
    return f"{path} changed during the run; wait until it is complete, and run again"


def _is_same(before: os.stat_result, now: os.stat_result) -> bool:
    """Whether it is the same file with the same time of its last change, and so with the same bytes."""
    names = ("st_size", "st_dev", "st_ino", "st_mtime_ns")
    return all(getattr(before, name) == getattr(now, name) for name in names)


def write_provenance(
    folder: Path,
    *,
    command: tuple[str, ...],
    understood: Any,
    seconds: dict[str, float],
    inputs: tuple[Path, ...] | Inputs = (),
    seeds: dict[str, int] | None = None,
    found: dict[str, object] | None = None,
) -> None:
    """Write `provenance.json`: version, command line, working folder, settings, SHA-256 of every input, seeds, packages, timings.

    `understood` is the frozen value that the command read (a Scene, a Plan); `found` holds what was estimated because
    the file does not give them; inputs as for `files_read`, or the `Inputs` of the run.
    """
    table = provenance_table(
        command=command, understood=understood, seconds=seconds, inputs=inputs, seeds=seeds, found=found
    )
    write_json(folder / "provenance.json", table)


def provenance_table(
    *,
    command: tuple[str, ...],
    understood: Any,
    seconds: dict[str, float],
    inputs: tuple[Path, ...] | Inputs = (),
    seeds: dict[str, int] | None = None,
    found: dict[str, object] | None = None,
) -> dict[str, Any]:
    """The contents of `provenance.json`, for results that have no folder of their own."""
    read = inputs.files if isinstance(inputs, Inputs) else files_read(inputs)
    return {
        "diethrow": __version__,
        "command": list(command),
        "folder": os.getcwd(),
        "understood": as_tables(understood),
        **({"found": found} if found else {}),
        "inputs": [{"path": file.path, "bytes": file.bytes, "sha256": file.sha256} for file in read],
        "seeds": seeds or {},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "made_on": this_place(),
        "packages": package_versions(),
        "timings_s": _rounded(seconds),
    }


def this_place() -> str:
    """A fingerprint of this machine and user: whether a folder of results is one's own."""
    return hashlib.sha256(f"{platform.node()} {os.path.expanduser('~')}".encode()).hexdigest()[:16]


def add_timings(path: Path, watch: Stopwatch) -> None:
    """Replace the timings of a provenance that was written before the last stages of its run, and add the time line of the run's
    stages and threads."""
    write_json(path, {**read_json(path), "timings_s": _rounded(watch.seconds), "time_line": watch.time_line})


def _rounded(seconds: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 4) for name, value in seconds.items()}


def sha256(path: Path, stop: threading.Event | None = None) -> str:
    """Hexadecimal SHA-256 of a file, read in pieces. Raises CancelledError if `stop` is set before the end."""
    digest, piece = hashlib.sha256(), memoryview(bytearray(CHUNK_BYTES))
    with path.open("rb", buffering=0) as file:
        while count := file.readinto(piece):
            if stop is not None and stop.is_set():
                raise CancelledError
            digest.update(piece[:count])
    return digest.hexdigest()


def package_versions() -> dict[str, str]:
    """Installed versions of the packages that can change a result."""
    return {name: importlib.metadata.version(name) for name in PACKAGES}


def die_record(die: Die) -> dict[str, Any]:
    """What a result says of the die that was thrown, in the keys of a `[die]` table."""
    record: dict[str, Any] = {"shape": die.solid.name, **die.solid.dimensions, "mass_kg": die.mass_kg}
    if die.is_spherical_top and not die.is_homogeneous:
        record["inertia_kg_m2"] = die.inertia_kg_m2
    return {**record, "corner_radius_m": die.corner_radius_m} if die.corner_radius_m else record


def as_tables(value: Any) -> Any:
    """A frozen value as nested tables, by the names of its fields."""
    if is_dataclass(value) and not isinstance(value, type):
        # A die with several moments of inertia has its tensor only.
        there = [part.name for part in fields(value) if part.name in vars(value)]
        return {name: as_tables(getattr(value, name)) for name in there}
    if isinstance(value, (list, tuple)):
        return [as_tables(part) for part in value]
    return value


def _files(inputs: tuple[Path, ...]) -> list[Path]:
    """Every file of the inputs, once, in order."""
    found: dict[Path, None] = {}
    for path in inputs:
        if path.is_dir():
            matches = sorted(file for file in path.iterdir() if file.is_file())
        else:
            matches = [path] if path.exists() else sorted(path.parent.glob(path.name))
        found.update(dict.fromkeys(matches))
    return list(found)
