"""Where a result comes from: enough to make it again, and to see that the inputs are still the same."""

from __future__ import annotations

import hashlib
import importlib.metadata
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
from .tables import read_json, write_json

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
)
"""Packages whose version can change a result."""

CHUNK_BYTES = 1 << 18
"""Pieces in which a file is read: they stay in the processor's cache."""
READ_AT_ONCE_BYTES = 1 << 24
"""Files up to this size are read through before the work begins, larger ones beside it. Of a clip of 8 GB it takes some seconds,
in which the stages that follow one frame after the other leave a core idle."""


@dataclass
class Stopwatch:
    """Seconds that each stage of a run took, in the order in which they ended."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block under `name`; a stage that is entered again adds up."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


class InputChangedError(OSError):
    """An input is not what it was when the run began."""


@dataclass(frozen=True)
class InputFile:
    """A file as it was when it was read through."""

    path: Path
    bytes: int
    sha256: str


def files_read(inputs: Iterable[Path]) -> tuple[InputFile, ...]:
    """Every file that the inputs mean, with its digest; inputs may be files, folders of files, or patterns.

    Raises InputChangedError for a file that is written to meanwhile, OSError for one that cannot be read.
    """
    return tuple(_file_read(path, _status(path)) for path in _files(tuple(inputs)))


class Inputs:
    """The files of a run as they were when it began."""

    def __init__(self, inputs: Iterable[Path]) -> None:
        """Raises OSError for a file that cannot be read. Large ones are read through in a thread, until `close`."""
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
        if status.st_size > READ_AT_ONCE_BYTES:
            self._read.append(self._reader.submit(_file_read, path, status, self._stop))
        else:
            self._read.append(_file_read(path, status))

    @property
    def files(self) -> tuple[InputFile, ...]:
        """All of them, when they are read. Raises InputChangedError for one that was written to since the run began, and
        CancelledError after `close` for what was not read by then."""
        return tuple(file.result() if isinstance(file, Future) else file for file in self._read)

    def first_changed(self) -> str:
        """A sentence on the first file that is not what it was; empty where all are."""
        for (path, before), file in zip(self._begun, self._read, strict=True):
            try:
                now = path.stat()
                if _is_as(before, now):
                    continue
                # A copy of the same bytes, or a new time alone, changes no result; of a file not yet read nobody knows.
                known = file.result() if isinstance(file, Future) and file.done() and not file.exception() else file
                if not isinstance(known, InputFile) or now.st_size != known.bytes or sha256(path) != known.sha256:
                    return _changed(path)
            except OSError:
                return f"{path} vanished, or cannot be read any longer, while it was worked on; run again"
        return ""

    def close(self) -> None:
        """Read no further."""
        self._stop.set()
        self._reader.shutdown(cancel_futures=True)


@contextmanager
def steady(inputs: Iterable[Path]) -> Iterator[Inputs]:
    """The files of the inputs as they are now; what the block makes of them is refused if they change meanwhile.

    Raises InputChangedError at the end of the block, or when it asks for the files, also in place of an error that a changed
    file may have caused.
    """
    known = Inputs(inputs)
    try:
        yield known
        changed = known.first_changed()
    except (ValueError, OSError) as error:
        if changed := known.first_changed():
            raise InputChangedError(changed) from error
        raise
    finally:
        known.close()
    if changed:
        raise InputChangedError(changed)


def _file_read(path: Path, before: os.stat_result, stop: threading.Event | None = None) -> InputFile:
    try:
        digest, after = sha256(path, stop), path.stat()
    except OSError as error:
        raise _unreadable(path, error) from error
    if not _is_as(before, after):
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
    return f"{path} changed while it was read; wait until it is written, and run again"


def _is_as(before: os.stat_result, now: os.stat_result) -> bool:
    """Whether it is the same file, with the same time of the last change: then its bytes are the same."""
    names = ("st_size", "st_dev", "st_ino", "st_mtime_ns")
    return all(getattr(before, name) == getattr(now, name) for name in names)


def write_provenance(
    path: Path,
    *,
    command: tuple[str, ...],
    understood: Any,
    inputs: tuple[Path, ...] | Inputs,
    seconds: dict[str, float],
    seeds: dict[str, int] | None = None,
    found: dict[str, float] | None = None,
) -> None:
    """`provenance.json`: version, command line and where it was given, what was understood, what was `found` in the place of
    what nobody gave, SHA-256 of every input, seeds, packages, timings.

    `understood` is any frozen value (a Scene, a Plan); inputs as for `files_read`, or as a run has held them steady.
    """
    read = inputs.files if isinstance(inputs, Inputs) else files_read(inputs)
    write_json(
        path,
        {
            "diethrow": __version__,
            "command": list(command),
            "folder": os.getcwd(),
            "understood": as_tables(understood),
            **({"found": found} if found else {}),
            "inputs": [{"path": file.path, "bytes": file.bytes, "sha256": file.sha256} for file in read],
            "seeds": seeds or {},
            "python": platform.python_version(),
            "platform": platform.platform(),
            "packages": package_versions(),
            "timings_s": _rounded(seconds),
        },
    )


def add_timings(path: Path, seconds: dict[str, float]) -> None:
    """Put the timings of a run into a provenance that was written before its last stages."""
    write_json(path, {**read_json(path), "timings_s": _rounded(seconds)})


def _rounded(seconds: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 4) for name, value in seconds.items()}


def sha256(path: Path, stop: threading.Event | None = None) -> str:
    """Hexadecimal SHA-256 of a file, read in pieces. Raises CancelledError where `stop` is set before its end."""
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


def as_tables(value: Any) -> Any:
    """A frozen value as nested tables, by the names of its fields."""
    if is_dataclass(value) and not isinstance(value, type):
        return {part.name: as_tables(getattr(value, part.name)) for part in fields(value)}
    if isinstance(value, (list, tuple)):
        return [as_tables(part) for part in value]
    return value


def _files(inputs: tuple[Path, ...]) -> list[Path]:
    """Every file that the inputs mean, once, in order."""
    found: dict[Path, None] = {}
    for path in inputs:
        if path.is_dir():
            matches = sorted(file for file in path.iterdir() if file.is_file())
        else:
            matches = [path] if path.exists() else sorted(path.parent.glob(path.name))
        found.update(dict.fromkeys(matches))
    return list(found)
