"""Keeps the finished part of a long run next to its output folder, so that a stopped run can continue.

The file is replaced in one step, so it is complete whenever a run is stopped. It holds a digest of the settings and of the
version: a run never continues from results of other settings.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..model.errors import InputError
from .csv_and_json import plain
from .outputs import OutputPlaceError
from .provenance import as_tables

Kept = dict[str, NDArray[Any]]

WRITE_INTERVAL_S = 5.0
"""Least time between two writings: what a killed run loses."""
WRITE_INTERVAL_RATIO = 20.0
"""Least time between two writings, in durations of one: writing takes at most a twentieth of a run."""


class WorkFile:
    """The work file of an output folder and of the settings of a run: a frozen value with plain fields."""

    def __init__(self, folder: Path, settings: Any) -> None:
        folder = Path(os.path.abspath(folder))
        self.folder = folder
        self.path = folder.with_name(f".{folder.name}.work.npz")
        text = json.dumps([__version__, type(settings).__name__, plain(as_tables(settings))], sort_keys=True)
        self.digest = hashlib.sha256(text.encode()).hexdigest()

    def read(self) -> Kept | None:
        """The arrays that were kept; None if there is no file. Raises ValueError for a work file of other settings."""
        if not self.path.exists():
            return None
        try:
            # Opened here: numpy leaves a file open that is no archive.
            with self.path.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
                kept = {name: file[name] for name in file.files}
        except (ValueError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(f"{self.path}: not a work file ({error}); delete it, or leave --resume out") from error
        if str(kept.pop("digest", "")) != self.digest:
            raise InputError(
                f"{self.path} belongs to a run with other settings or of another version; "
                "give the settings of that run, or leave --resume out to start again"
            )
        return kept

    def write(self, kept: Mapping[str, Any]) -> None:
        """Replace the file in one step."""
        aside = self.path.with_name(f"{self.path.name}.{os.getpid()}.part")
        try:
            with aside.open("wb") as file:
                np.savez(file, allow_pickle=False, digest=np.array(self.digest), **kept)
                file.flush()
                os.fsync(file.fileno())
            aside.replace(self.path)
        except OSError as error:
            raise OutputPlaceError(f"{self.path} cannot be written ({error.strerror}); try another --out") from error
        finally:
            aside.unlink(missing_ok=True)

    def remove(self) -> None:
        """Delete the file: the run is complete."""
        self.path.unlink(missing_ok=True)

    @contextmanager
    def keeping(self) -> Iterator[Callable[[Mapping[str, Any]], None]]:
        """A function that takes what is finished so far. It is written from time to time, and when the block stops or fails."""
        last: Mapping[str, Any] | None = None
        due = time.monotonic() + WRITE_INTERVAL_S

        def keep(kept: Mapping[str, Any]) -> None:
            nonlocal last, due
            last = kept
            if (begin := time.monotonic()) >= due:
                self.write(kept)
                took = time.monotonic() - begin
                due = time.monotonic() + max(WRITE_INTERVAL_S, WRITE_INTERVAL_RATIO * took)

        try:
            yield keep
        except BaseException:
            if last is not None:
                self.write(last)
            raise
