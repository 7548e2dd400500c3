"""Where a result comes from: enough to make it again, and to see that the inputs are still the same."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import platform
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

from . import __version__
from .records import read_json, write_json

PACKAGES = (
    "av",
    "matplotlib",
    "numba",
    "numpy",
    "opencv-python-headless",
    "pandas",
    "pydantic",
    "rerun-sdk",
    "scikit-image",
    "scipy",
    "tifffile",
)
"""Packages whose version can change a result."""

CHUNK_BYTES = 1 << 20


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
    stamp: tuple[int, int, int]
    """Device, inode and time of the last change [ns]: while they and the size stay, so do the bytes."""


def files_read(inputs: Iterable[Path]) -> tuple[InputFile, ...]:
    """Every file that the inputs mean, with its digest; inputs may be files, folders of files, or patterns.

    Raises InputChangedError for a file that is written to meanwhile, OSError for one that cannot be read.
    """
    return tuple(_file_read(path) for path in _files(tuple(inputs)))


@contextmanager
def steady(inputs: Iterable[Path]) -> Iterator[tuple[InputFile, ...]]:
    """The files of the inputs as they are now; what the block makes of them is refused if they change meanwhile.

    Raises InputChangedError at the end of the block, also in place of an error that a changed file may have caused.
    """
    files = files_read(inputs)
    try:
        yield files
    except (ValueError, OSError) as error:
        if changed := _first_changed(files):
            raise InputChangedError(changed) from error
        raise
    if changed := _first_changed(files):
        raise InputChangedError(changed)


def _file_read(path: Path) -> InputFile:
    try:
        before, digest, after = path.stat(), sha256(path), path.stat()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise OSError(f"{path} cannot be read ({reason}); wanted a file that this user may read") from error
    if (before.st_size, _stamp(before)) != (after.st_size, _stamp(after)):
        raise InputChangedError(_changed(path))
    return InputFile(path, before.st_size, digest, _stamp(before))


def _first_changed(files: Iterable[InputFile]) -> str:
    """A sentence on the first file that is not what it was; empty where all are."""
    for file in files:
        try:
            now = file.path.stat()
            same = (now.st_size, _stamp(now)) == (file.bytes, file.stamp)
            # A copy of the same bytes, or a new time alone, changes no result.
            if not same and (now.st_size != file.bytes or sha256(file.path) != file.sha256):
                return _changed(file.path)
        except OSError:
            return f"{file.path} vanished, or cannot be read any longer, while it was worked on; run again"
    return ""


def _changed(path: Path) -> str:
    return f"{path} changed while it was read; wait until it is written, and run again"


def _stamp(status: os.stat_result) -> tuple[int, int, int]:
    return status.st_dev, status.st_ino, status.st_mtime_ns


def write_provenance(
    path: Path,
    *,
    command: tuple[str, ...],
    understood: Any,
    inputs: tuple[Path, ...] | tuple[InputFile, ...],
    seconds: dict[str, float],
    seeds: dict[str, int] | None = None,
    found: dict[str, float] | None = None,
) -> None:
    """`provenance.json`: version, command line and where it was given, what was understood, what was `found` in the place of
    what nobody gave, SHA-256 of every input, seeds, packages, timings.

    `understood` is any frozen value (a Scene, a Plan); inputs as for `files_read`, or what that gave.
    """
    known = [part for part in inputs if isinstance(part, InputFile)]
    read = (*known, *files_read(part for part in inputs if isinstance(part, Path)))
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


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file, read in pieces."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(CHUNK_BYTES):
            digest.update(piece)
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
