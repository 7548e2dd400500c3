"""Full disks, files that change or shrink while they are read, and unreadable files: one message each."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
import threading
from collections import namedtuple
from collections.abc import Callable
from concurrent.futures import CancelledError
from pathlib import Path

import numpy as np
import pytest
from footage_files import noisy_frames, write_cine, write_photron, write_pictures, write_tiff

import diethrow.files.provenance
from diethrow.commands.clip.track import track_only
from diethrow.commands.model.simulated_throw import throw
from diethrow.commands.results.joined_recordings import ThrowRecording, gather, join
from diethrow.files.outputs import MIN_FREE_BYTES, OutputBusyError, OutputPlaceError, locked, whole_file, whole_folder
from diethrow.files.plan import read_plan
from diethrow.files.provenance import MAX_FOREGROUND_BYTES, InputChangedError, files_read, sha256, unchanged_inputs
from diethrow.files.scene import read_scene
from diethrow.tracking.footage.clip import clip_files, open_clip
from diethrow.tracking.quality import FAST

SAMPLES = Path(__file__).parents[2] / "data_samples"
SAMPLE = SAMPLES / "cube_wood_photron"
FRAMES = noisy_frames(12, bits=12)


def fill(output: Path, number: int) -> None:
    """Write a folder on a disk that raises an error."""
    with whole_folder(output) as aside:
        (aside / "track.csv").write_text("half")
        raise OSError(number, os.strerror(number), "track.csv")


@pytest.mark.parametrize(
    ("number", "reason"),
    [(errno.ENOSPC, "the disk is full"), (errno.EDQUOT, "quota"), (errno.EFBIG, "larger than allowed")],
)
def test_a_disk_that_fills_up_gives_one_message_and_leaves_nothing(tmp_path: Path, number: int, reason: str) -> None:
    with pytest.raises(OutputPlaceError, match=f"out was not written: .*{reason}"):
        fill(tmp_path / "out", number)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_reported_before_anything_is_computed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**9, 10**9 - 10**6, 10**6))
    with (
        pytest.raises(OutputPlaceError, match=r"disk is full.* 1 MB .* 17 MB"),
        whole_folder(tmp_path / "out"),
    ):
        pytest.fail("the work was begun")
    assert list(tmp_path.iterdir()) == []


def test_a_recording_for_which_there_is_no_room_is_not_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The recorder waits for ever on a full disk."""
    usage, free = namedtuple("usage", "total used free"), MIN_FREE_BYTES + 10_000
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**9, 10**9 - free, free))
    plan = read_plan(SAMPLES / "throws" / "cube_mirror.toml")
    with pytest.raises(OutputPlaceError, match="disk is full"):
        throw(plan, tmp_path / "out")
    found = [ThrowRecording(name, _file_of(tmp_path / f"{name}.rrd", 10_000), {}) for name in "ab"]
    with pytest.raises(OutputPlaceError, match="disk is full"):
        join(found, tmp_path / "both.rrd", align="frame", models=True)
    with pytest.raises(OutputPlaceError, match="disk is full"):
        gather(found, tmp_path / "throws")
    assert {path.name for path in tmp_path.iterdir()} == {"a.rrd", "b.rrd"}


def _file_of(path: Path, size: int) -> Path:
    path.write_bytes(bytes(size))
    return path


# --- inputs ---


def test_an_input_that_changes_meanwhile_is_refused_and_a_copy_of_it_is_not(tmp_path: Path) -> None:
    clip = tmp_path / "clip.avi"
    clip.write_bytes(b"as it was")
    with unchanged_inputs([clip]) as inputs:
        shutil.copy(clip, tmp_path / "copy")
        (tmp_path / "copy").replace(clip)
    assert [file.bytes for file in inputs.files] == [9]
    with pytest.raises(InputChangedError, match=r"clip\.avi changed"), unchanged_inputs([clip]):
        clip.write_bytes(b"otherwise")
    with pytest.raises(InputChangedError, match=r"clip\.avi was removed"), unchanged_inputs([clip]):
        clip.unlink()


def test_a_large_input_is_hashed_during_the_work_and_checked_like_a_small_one(tmp_path: Path) -> None:
    clip = tmp_path / "clip.mraw"
    clip.write_bytes(bytes(MAX_FOREGROUND_BYTES + 1))
    with unchanged_inputs([clip]) as inputs:
        assert inputs.files[0].sha256 == sha256(clip)
    with pytest.raises(InputChangedError, match=r"clip\.mraw changed"), unchanged_inputs([clip]):
        clip.write_bytes(b"otherwise")


def test_a_second_large_input_that_changes_before_its_turn_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clips = [tmp_path / name for name in ("left.mraw", "right.mraw")]
    for clip in clips:
        clip.write_bytes(bytes(MAX_FOREGROUND_BYTES + 1))
    may_go_on = threading.Event()

    def waits(path: Path, stop: threading.Event | None = None) -> str:
        may_go_on.wait()
        return sha256(path, stop)

    def rewritten() -> None:
        with unchanged_inputs(clips) as inputs:
            clips[1].write_bytes(b"x" * (MAX_FOREGROUND_BYTES + 1))
            may_go_on.set()
            assert inputs.files

    monkeypatch.setattr(diethrow.files.provenance, "sha256", waits)
    with pytest.raises(InputChangedError, match=r"right\.mraw changed"):
        rewritten()


def test_a_run_that_ends_early_stops_hashing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip, scene, stop = tmp_path / "clip.mraw", tmp_path / "scene.toml", threading.Event()
    clip.write_bytes(bytes(MAX_FOREGROUND_BYTES + 1))
    scene.write_bytes(b"[clip]")
    stop.set()
    with pytest.raises(CancelledError):
        sha256(clip, stop)
    with pytest.raises(RuntimeError, match="no die"), unchanged_inputs([clip, scene]):
        raise RuntimeError("no die")

    def refuse(path: Path, stop: threading.Event | None = None) -> str:
        if path == scene:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return sha256(path, stop)

    monkeypatch.setattr(diethrow.files.provenance, "sha256", refuse)
    with pytest.raises(OSError, match=r"scene\.toml"), unchanged_inputs([clip, scene]):
        pytest.fail("the work was begun")
    assert not [thread.name for thread in threading.enumerate() if thread.name.startswith("inputs")]


def test_a_change_explains_the_error_that_it_caused(tmp_path: Path) -> None:
    clip = tmp_path / "clip.avi"
    clip.write_bytes(b"as it was")

    def fail(meanwhile: Callable[[], object]) -> None:
        with unchanged_inputs([clip]):
            meanwhile()
            raise ValueError("frame 3 cannot be decoded")

    with pytest.raises(ValueError, match="frame 3"):
        fail(lambda: None)
    with pytest.raises(InputChangedError, match="changed"):
        fail(lambda: clip.write_bytes(b"as"))


def test_an_unreadable_input_gives_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "clip.avi").write_bytes(b"mine")

    def refuse(path: Path, stop: object) -> str:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr(diethrow.files.provenance, "sha256", refuse)
    with pytest.raises(OSError, match=r"clip\.avi cannot be read \(permission denied"):
        files_read([tmp_path / "clip.avi"])


def test_a_clip_that_is_replaced_during_the_run_gives_no_result(tmp_path: Path) -> None:
    scene = shutil.copytree(SAMPLE, tmp_path / "clip") / "scene.toml"
    pixels = tmp_path / "clip" / "clip.mraw"

    def replace(stage: str, done: int, total: int) -> None:
        if stage == "Finding the bounces":
            pixels.write_bytes(pixels.read_bytes()[::-1])

    with pytest.raises(InputChangedError, match=r"clip\.mraw changed"):
        track_only(read_scene(scene), tmp_path / "out", quality=FAST, progress=replace)
    assert [path.name for path in tmp_path.iterdir()] == ["clip"]


@pytest.mark.parametrize("kind", ["Photron", "Phantom", "TIFF", "pictures"])
def test_a_film_that_shrinks_while_it_is_read_gives_one_message(kind: str, tmp_path: Path) -> None:
    path, pixels = {
        "Photron": lambda: (write_photron(tmp_path / "x.cihx", FRAMES, stored_bits=16), tmp_path / "x.mraw"),
        "Phantom": lambda: (write_cine(tmp_path / "x.cine", FRAMES, stored_bits=16), tmp_path / "x.cine"),
        "TIFF": lambda: (write_tiff(tmp_path / "x.tif", FRAMES), tmp_path / "x.tif"),
        "pictures": lambda: (write_pictures(tmp_path / "x", FRAMES), tmp_path / "x" / "frame_12.png"),
    }[kind]()
    clip = open_clip(path, fps=1500.0)
    np.testing.assert_array_equal(clip.frame(0), FRAMES[0])
    os.truncate(pixels, pixels.stat().st_size // 3)
    with pytest.raises(ValueError, match=r"^(x|frame_12)\..*(cut off|ends before|damaged)"):
        clip.frame(11)


def test_every_file_of_a_film_is_an_input(tmp_path: Path) -> None:
    """An earlier version left out the pixels of a Photron header, so that a change went unnoticed."""
    header = write_photron(tmp_path / "x.cihx", FRAMES, stored_bits=16)
    assert set(clip_files(header)) == set(clip_files(tmp_path / "x.mraw")) == {header, tmp_path / "x.mraw"}
    pictures = write_pictures(tmp_path / "x", FRAMES)
    assert len(clip_files(pictures)) == len(clip_files(pictures / "frame_*.png")) == len(FRAMES)
    assert clip_files(tmp_path / "nothing.avi") == (tmp_path / "nothing.avi",)


# --- locks ---

HOLDER = """
import os, sys
from pathlib import Path
from diethrow.files.outputs import whole_folder
with whole_folder(Path(sys.argv[1])) as aside:
    (aside / "track.csv").write_text("half")
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_killed_run_leaves_no_lock_and_the_next_one_removes_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    words = [sys.executable, "-c", HOLDER, str(out)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with monkeypatch.context() as impatient:
            impatient.setattr("diethrow.files.outputs.LOCK_TIMEOUT_S", 0.0)
            with pytest.raises(OutputBusyError, match="another run is writing"), whole_folder(out):
                pytest.fail("two runs write one folder")
        holder.kill()
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left[0].startswith(".out.")
    assert not out.exists()
    with whole_folder(out) as aside:
        (aside / "track.csv").write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_run_that_was_killed_between_two_renamings_has_lost_nothing(tmp_path: Path) -> None:
    moved = tmp_path / ".out.abcd_123.old" / "old"
    moved.mkdir(parents=True)
    (moved / "track.csv").write_text("the predecessor")
    other = tmp_path / ".out.b.abcd_123.part"  # of an output of another name
    other.mkdir()
    with whole_folder(tmp_path / "out", force=True):
        assert (tmp_path / "out" / "track.csv").read_text() == "the predecessor"
    assert sorted(path.name for path in tmp_path.iterdir()) == [".out.b.abcd_123.part", "out"]


def test_a_file_and_its_lock_exclude_each_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diethrow.files.outputs.LOCK_TIMEOUT_S", 0.0)
    with locked(tmp_path / "a.csv"), pytest.raises(OutputBusyError), whole_file(tmp_path / "a.csv"):
        pytest.fail("two runs write one file")
    assert list(tmp_path.iterdir()) == []
