"""Output folders and files that appear complete or not at all.

Results are written into a hidden folder next to the output, flushed to the disk, and renamed at the end. A run that fails, is
stopped or is killed leaves nothing that looks finished, and a folder that is replaced stays as it was until its successor is
complete. A run holds a lock on the name of its output. The system releases the lock of a killed run, and the next run on that
name removes what the killed one left.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from ..model.errors import DiethrowError

try:
    import fcntl
except ImportError:  # Windows has no such locks: there, two runs on one output are not kept apart
    fcntl = None  # type: ignore[assignment]

LOCK_TIMEOUT_S = 2.0
"""Wait for a lock: a worker process needs a moment to notice that its parent was killed."""
LOCK_POLL_S = 0.02
"""Between two tries to take a lock."""
DISK_ERRORS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file is larger than allowed here",
    errno.EROFS: "the disk is read-only",
}
MIN_FREE_BYTES = 2**24
"""A disk with less free space counts as full. Small results fit into this, so none is left half-written."""
NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)
"""Errors of file systems without locks; there, two runs on one output are not kept apart."""


class OutputExistsError(DiethrowError, FileExistsError):
    """The output exists already and may not be replaced."""


class OutputPlaceError(DiethrowError, OSError):
    """The output cannot be written at its place."""


class OutputBusyError(OutputPlaceError):
    """Another run is writing this output."""


@contextmanager
def whole_folder(folder: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """A folder to write into. It becomes `folder` when the block ends, and is removed if the block fails.

    Raises OutputExistsError, before anything is computed, where `folder` exists and may not be replaced (see
    `refuse_existing`), OutputBusyError where another run is writing it, and OutputPlaceError where it cannot be made, or
    the disk fills up. SIGTERM within the block counts as Ctrl-C.
    """
    folder = Path(os.path.abspath(folder))
    kept = tuple(inputs)
    with _place_errors_named(folder):
        refuse_existing(folder, force=force, inputs=kept)
    with _sigterm_as_interrupt(), locked(folder), _disk_errors_named(folder):
        _remove_leftovers(folder)
        refuse_existing(folder, force=force, inputs=kept)
        temporary = _folder_next_to(folder)
        try:
            yield temporary
            _flush(temporary)
            refuse_existing(folder, force=force, inputs=kept)
            _replace(folder, temporary)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def whole_file(file: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """A path to write to. It becomes `file` when the block ends, and is removed if the block fails. Raises as `whole_folder`.

    `force` replaces a file, never a folder, a link or one of the `inputs`.
    """
    file = Path(os.path.abspath(file))
    if file.is_symlink() or file.is_dir():
        raise OutputExistsError(f"{file} exists and is not a file; wanted a new file, try another --out")
    if file.exists() and not force:
        raise OutputExistsError(f"{file} exists; wanted a new file, try another --out, or --force to replace it")
    if any(kept.exists() and file.exists() and kept.samefile(file) for kept in inputs):
        raise OutputExistsError(f"{file} is an input, which must stay; wanted another file, try another --out")
    with _sigterm_as_interrupt(), locked(file), _disk_errors_named(file):
        _remove_leftovers(file)
        temporary = _folder_next_to(file)
        try:
            yield temporary / file.name
            _flush(temporary)
            (temporary / file.name).replace(file)
            _sync_folder(file.parent)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def locked(output: Path) -> Iterator[None]:
    """Keep other runs off an output during the block, by a lock on a hidden file next to it.

    The lock ends with the process. Raises OutputBusyError where another process holds it, and OutputPlaceError where the file
    cannot be made.
    """
    output = Path(os.path.abspath(output))
    lock_path = output.with_name(f".{output.name}.lock")
    with _place_errors_named(output):
        output.parent.mkdir(parents=True, exist_ok=True)
        handle = _lock(lock_path, output)
    try:
        yield
    finally:
        if handle is not None:
            # Unlinked while it is locked: no other process can hold it, and one that waits finds another file of that name.
            lock_path.unlink(missing_ok=True)
            os.close(handle)


def _lock(lock_path: Path, output: Path) -> int | None:
    """The descriptor of the locked file; None where there are no locks."""
    if fcntl is None:
        return None
    deadline = time.monotonic() + LOCK_TIMEOUT_S
    while True:
        handle = os.open(lock_path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            if time.monotonic() > deadline:
                raise OutputBusyError(
                    f"another run is writing {output}; wait for its end, or try another --out"
                ) from None
            time.sleep(LOCK_POLL_S)
            continue
        except OSError as error:
            os.close(handle)
            if error.errno in NO_LOCKS:
                lock_path.unlink(missing_ok=True)
                return None
            raise
        if _is_same_file(lock_path, handle):
            return handle
        os.close(handle)


def _is_same_file(path: Path, handle: int) -> bool:
    """Whether an open file still has that name: its last holder may have removed it."""
    try:
        return os.path.samestat(path.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False


def _remove_leftovers(output: Path) -> None:
    """Remove what killed runs on this name left, and put back a folder that one of them moved away; needs the lock."""
    left = re.compile(rf"\.{re.escape(output.name)}\.[a-z0-9_]{{8}}\.(part|old)")
    for path in [path for path in output.parent.iterdir() if left.fullmatch(path.name)]:
        if (path / "old").exists() and not output.exists():
            (path / "old").rename(output)
        shutil.rmtree(path, ignore_errors=True)


def refuse_existing(folder: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Raises OutputExistsError for a folder that may not be written.

    `force` allows the replacement of a folder, but never of a file or link, nor of a folder that holds one of the
    `inputs`, the working directory or the home folder: results must not erase their inputs.
    """
    folder = Path(os.path.abspath(folder))
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise OutputExistsError(f"{folder} exists and is not a folder; wanted a new folder, try another --out")
    if folder.exists() and not force:
        raise OutputExistsError(f"{folder} exists; wanted a new folder, try another --out, or --force to replace it")
    for kept in (*inputs, Path.cwd(), Path.home()):
        if folder.exists() and kept.resolve().is_relative_to(folder.resolve()):
            raise OutputExistsError(f"{folder} holds {kept}, which must stay; wanted another folder, try another --out")


def check_free_space(output: Path, needed_bytes: int) -> None:
    """Raises OutputPlaceError where the disk of `output` has less free space than `needed_bytes`.

    Called before much is written: not every library reports a full disk, and the one that writes recordings waits for ever.
    """
    free = shutil.disk_usage(output.parent).free
    if free < needed_bytes:
        raise OutputPlaceError(
            f"{output} was not written: the disk is full, {1e-6 * free:.0f} MB are free; wanted "
            f"{1e-6 * needed_bytes:.0f} MB; free some space, or try another --out"
        )


def _folder_next_to(output: Path) -> Path:
    """A new, empty folder next to an output, on the same disk."""
    check_free_space(output, MIN_FREE_BYTES)
    with _place_errors_named(output):
        return Path(tempfile.mkdtemp(prefix=f".{output.name}.", suffix=".part", dir=output.parent))


@contextmanager
def _place_errors_named(output: Path) -> Iterator[None]:
    """Turns errors of the system while an output is created into an OutputPlaceError."""
    try:
        yield
    except (OutputPlaceError, OutputExistsError):
        raise
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise OutputPlaceError(
            f"{output} cannot be made ({reason}); wanted a place that can be written, try another --out"
        ) from error


@contextmanager
def _disk_errors_named(output: Path) -> Iterator[None]:
    """Turns errors of the disk while an output is written into an OutputPlaceError."""
    try:
        yield
    except OutputPlaceError:
        raise
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        raise OutputPlaceError(
            f"{output} was not written: {DISK_ERRORS[error.errno]}; free some space, or try another --out"
        ) from error


def _flush(temporary: Path) -> None:
    """Flush every file to the disk, and give the folder the permissions of an ordinary one (mkdtemp makes it private)."""
    for file in temporary.rglob("*"):
        if file.is_file():
            with file.open("rb") as handle:
                os.fsync(handle.fileno())
    mask = os.umask(0)
    os.umask(mask)
    temporary.chmod(0o777 & ~mask)
    _sync_folder(temporary)


def _replace(folder: Path, temporary: Path) -> None:
    """Rename `temporary` to `folder`. An existing folder is moved away first, and back again if the renaming fails."""
    if not folder.exists():
        temporary.rename(folder)
        _sync_folder(folder.parent)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".old", dir=folder.parent)) / "old"
    folder.rename(old)
    try:
        temporary.rename(folder)
    except BaseException:
        old.rename(folder)
        raise
    finally:
        shutil.rmtree(old.parent, ignore_errors=True)
    _sync_folder(folder.parent)


def _sync_folder(folder: Path) -> None:
    """Flush the names in a folder to the disk: a power cut may undo a rename alone."""
    if os.name == "nt":
        return  # folders cannot be opened there
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGTERM, so that the clean-up runs; only the main thread may set handlers."""
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
