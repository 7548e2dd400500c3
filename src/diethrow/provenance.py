"""Where a result comes from: enough to make it again, and to see that the inputs are still the same."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
import time
from collections.abc import Iterator
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


def write_provenance(
    path: Path,
    *,
    command: tuple[str, ...],
    understood: Any,
    inputs: tuple[Path, ...],
    seconds: dict[str, float],
    seeds: dict[str, int] | None = None,
) -> None:
    """`provenance.json`: version, command line, what was understood, SHA-256 of every input, seeds, packages, timings.

    `understood` is any frozen value (a Scene, a Plan); inputs may be files, folders of files, or patterns.
    """
    write_json(
        path,
        {
            "diethrow": __version__,
            "command": list(command),
            "understood": as_tables(understood),
            "inputs": [{"path": file, "bytes": file.stat().st_size, "sha256": sha256(file)} for file in _files(inputs)],
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
