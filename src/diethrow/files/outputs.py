"""Folders and files that appear whole or not at all.

Results are written into a sibling folder, brought onto the disk, and renamed onto the wanted name at the end: a run that
fails, is stopped or is killed leaves nothing that looks finished, and a folder that is replaced stays as it was until its
successor is complete. Whoever writes holds a lock on the name, which the system lets go of when a run is killed; the next
run on that name sweeps away what the killed one left.
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

try:
    import fcntl
except ImportError:  # Windows has no such locks: there, two runs on one folder are not kept apart
    fcntl = None  # type: ignore[assignment]

PATIENCE_S = 2.0
"""Wait for a lock: a worker whose parent was killed needs a moment to notice."""
DISK_ERRORS = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file is larger than allowed here",
    errno.EROFS: "the disk can only be read",
}
ROOM_BYTES = 2**24
"""A disk with less room than this is full: small results fit, and nothing is half-written."""
LOCKLESS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)
"""What file systems say that know no locks; there, runs are not kept apart."""


class OutputExistsError(FileExistsError):
    """The output is there already, and nobody said that it may be replaced."""


class OutputPlaceError(OSError):
    """The output cannot be made where it was wanted."""


class OutputBusyError(OutputPlaceError):
    """Another run is writing this output."""


@contextmanager
def whole_folder(folder: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """A folder to write into; it becomes `folder` when the block ends, and vanishes when the block fails.

    Raises OutputExistsError, before anything is computed, where `folder` exists and may not be replaced (see
    `refuse_existing`), OutputBusyError where another run is writing it, and OutputPlaceError where it cannot be made, or
    the disk fills up. SIGTERM within the block counts as Ctrl-C.
    """
    folder = Path(os.path.abspath(folder))
    kept = tuple(inputs)
    with _place_errors_told(folder):
        refuse_existing(folder, force=force, inputs=kept)
    with _sigterm_as_interrupt(), locked(folder), _disk_errors_told(folder):
        _sweep(folder)
        refuse_existing(folder, force=force, inputs=kept)
        aside = _folder_beside(folder)
        try:
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
    with _sigterm_as_interrupt(), locked(file), _disk_errors_told(file):
        _sweep(file)
        aside = _folder_beside(file)
        try:
            yield aside / file.name
            _settle(aside)
            (aside / file.name).replace(file)
            _sync_folder(file.parent)
        finally:
            shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def locked(output: Path) -> Iterator[None]:
    """Keep other runs off an output while the block lasts, by a lock on a hidden file beside it.

    The lock goes with the process, however that ends. Raises OutputBusyError where somebody else holds it, and
    OutputPlaceError where there is no place for it.
    """
    output = Path(os.path.abspath(output))
    beside = output.with_name(f".{output.name}.lock")
    with _place_errors_told(output):
        output.parent.mkdir(parents=True, exist_ok=True)
        handle = _lock(beside, output)
    try:
        yield
    finally:
        if handle is not None:
            # Unlinked while it is held: nobody can have locked this file, and who waits for it finds it gone.
            beside.unlink(missing_ok=True)
            os.close(handle)


def _lock(beside: Path, output: Path) -> int | None:
    """A file descriptor that holds the lock; None where there are no locks."""
    if fcntl is None:
        return None
    deadline = time.monotonic() + PATIENCE_S
    while True:
        handle = os.open(beside, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            if time.monotonic() > deadline:
                raise OutputBusyError(
                    f"another run is writing {output}; wait for its end, or try another --out"
                ) from None
            time.sleep(0.02)
            continue
        except OSError as error:
            os.close(handle)
            if error.errno in LOCKLESS:
                beside.unlink(missing_ok=True)
                return None
            raise
        if _is_still(beside, handle):
            return handle
        os.close(handle)


def _is_still(path: Path, handle: int) -> bool:
    """Whether an open file is the one of that name: its last holder may have removed it meanwhile."""
    try:
        return os.path.samestat(path.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False


def _sweep(output: Path) -> None:
    """Remove what killed runs on this name left, and put back a predecessor that was moved away; needs the lock."""
    left = re.compile(rf"\.{re.escape(output.name)}\.[a-z0-9_]{{8}}\.(part|old)")
    for path in [path for path in output.parent.iterdir() if left.fullmatch(path.name)]:
        if (path / "old").exists() and not output.exists():
            (path / "old").rename(output)
        shutil.rmtree(path, ignore_errors=True)


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


def demand_room(output: Path, room_bytes: int) -> None:
    """Raises OutputPlaceError where the disk of `output`, which is being made, has less room than that.

    Asked before much is written: not every library says that the disk is full, the one that writes recordings waits.
    """
    free = shutil.disk_usage(output.parent).free
    if free < room_bytes:
        raise OutputPlaceError(
            f"{output} was not written: the disk is full, {1e-6 * free:.0f} MB are free and {1e-6 * room_bytes:.0f} MB are "
            "wanted; make room, or try another --out"
        )


def _folder_beside(output: Path) -> Path:
    """A new, empty folder next to an output, on the same disk."""
    demand_room(output, ROOM_BYTES)
    with _place_errors_told(output):
        return Path(tempfile.mkdtemp(prefix=f".{output.name}.", suffix=".part", dir=output.parent))


@contextmanager
def _place_errors_told(output: Path) -> Iterator[None]:
    """What the system refuses while room for an output is made, in a sentence."""
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
def _disk_errors_told(output: Path) -> Iterator[None]:
    """A disk that fails or fills up while an output is written, in a sentence."""
    try:
        yield
    except OutputPlaceError:
        raise
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        raise OutputPlaceError(
            f"{output} was not written: {DISK_ERRORS[error.errno]}; make room, or try another --out"
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
    _sync_folder(aside)


def _replace(folder: Path, aside: Path) -> None:
    """Rename `aside` onto `folder`; a predecessor is moved away first, and back again if the renaming fails."""
    if not folder.exists():
        aside.rename(folder)
        _sync_folder(folder.parent)
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
    _sync_folder(folder.parent)


def _sync_folder(folder: Path) -> None:
    """Bring the names in a folder onto the disk; a rename alone may come to nothing in a power cut."""
    if os.name == "nt":
        return  # folders cannot be opened there
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


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
