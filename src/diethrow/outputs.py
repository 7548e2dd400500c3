"""Folders and files that appear whole or not at all.

Results are written into a sibling folder and renamed onto the wanted name at the end: a run that fails, or is stopped,
leaves nothing half-written, and a folder that is replaced stays as it was until its successor is complete.
"""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType


class OutputExistsError(FileExistsError):
    """The output is there already, and nobody said that it may be replaced."""


class OutputPlaceError(OSError):
    """The output cannot be made where it was wanted."""


@contextmanager
def whole_folder(folder: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """A folder to write into; it becomes `folder` when the block ends, and vanishes when the block fails.

    Raises OutputExistsError, before anything is computed, where `folder` exists and may not be replaced (see
    `refuse_existing`), and OutputPlaceError where it cannot be made. SIGTERM within the block counts as Ctrl-C.
    """
    folder = Path(os.path.abspath(folder))
    kept = tuple(inputs)
    aside = _folder_beside(folder, force, kept)
    try:
        with _sigterm_as_interrupt():
            yield aside
            _settle(aside)
            refuse_existing(folder, force=force, inputs=kept)
            _replace(folder, aside)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def whole_file(file: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """A path to write to; it becomes `file` when the block ends, and vanishes when the block fails. Raises as
    `whole_folder`; `force` replaces a file, never a folder, a link or one of the `inputs`."""
    file = Path(os.path.abspath(file))
    if file.is_symlink() or file.is_dir():
        raise OutputExistsError(f"{file} exists and is not a file; wanted a new file, try another --out")
    if file.exists() and not force:
        raise OutputExistsError(f"{file} exists; wanted a new file, try another --out, or --force to replace it")
    if any(kept.exists() and file.exists() and kept.samefile(file) for kept in inputs):
        raise OutputExistsError(f"{file} is an input, which must stay; wanted another file, try another --out")
    aside = _folder_beside(file.with_name(f"{file.name}.parts"), False, ())
    try:
        with _sigterm_as_interrupt():
            yield aside / file.name
            _settle(aside)
            (aside / file.name).replace(file)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def refuse_existing(folder: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Raises OutputExistsError for a folder that may not be written.

    `force` allows the replacement of a folder, but never of a file or link, nor of a folder that holds one of the
    `inputs`, the working directory or the home folder: results must not erase what they were made from.
    """
    folder = Path(os.path.abspath(folder))
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise OutputExistsError(f"{folder} exists and is not a folder; wanted a new folder, try another --out")
    if folder.exists() and not force:
        raise OutputExistsError(f"{folder} exists; wanted a new folder, try another --out, or --force to replace it")
    for kept in (*inputs, Path.cwd(), Path.home()):
        if folder.exists() and kept.resolve().is_relative_to(folder.resolve()):
            raise OutputExistsError(f"{folder} holds {kept}, which must stay; wanted another folder, try another --out")


def _folder_beside(folder: Path, force: bool, inputs: tuple[Path, ...]) -> Path:
    """A new, empty folder next to `folder`, on the same disk, where `folder` may be written."""
    try:
        refuse_existing(folder, force=force, inputs=inputs)
        folder.parent.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".part", dir=folder.parent))
    except OutputExistsError:
        raise
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise OutputPlaceError(
            f"{folder} cannot be made ({reason}); wanted a place that can be written, try another --out"
        ) from error


def _settle(aside: Path) -> None:
    """Bring every file onto the disk, and give the folder the rights of an ordinary one (mkdtemp's is private)."""
    for file in aside.rglob("*"):
        if file.is_file():
            with file.open("rb") as handle:
                os.fsync(handle.fileno())
    mask = os.umask(0)
    os.umask(mask)
    aside.chmod(0o777 & ~mask)


def _replace(folder: Path, aside: Path) -> None:
    """Rename `aside` onto `folder`; a predecessor is moved away first, and back again if the renaming fails."""
    if not folder.exists():
        aside.rename(folder)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".old", dir=folder.parent)) / "old"
    folder.rename(old)
    try:
        aside.rename(folder)
    except BaseException:
        old.rename(folder)
        raise
    finally:
        shutil.rmtree(old.parent, ignore_errors=True)


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """Let SIGTERM unwind the stack, so that the clean-up runs; only the main thread may set handlers."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(signum: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
