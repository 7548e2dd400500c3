"""Records and pages: 1 frame and 60 000 frames, complete tracks and tracks without a pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import replay_records as made

from diethrow.files.throw_records import read_track, write_track
from diethrow.replay.pages.report import write_report
from diethrow.replay.recording.throw_recording import write_recording
from diethrow.tracking.track import LOST, TRACKED, Track

Report = Callable[[str], None]


def tracked(frames: int) -> Track:
    """A track with a number of frames at equal intervals."""
    times = np.linspace(0.0, 0.04, frames)
    positions, quaternions = made.throw().poses(times)
    covariance = np.tile(1e-9 * np.eye(6), (frames, 1, 1))
    return Track(np.arange(frames), times, positions, quaternions, covariance, np.full(frames, TRACKED, dtype="<U7"))


def size_of(path: Path) -> str:
    """Name and rounded size of a file."""
    return f"{path.name} {path.stat().st_size / 1e6:.1g} MB"


@pytest.mark.parametrize(
    "frames", [1, pytest.param(60_000, marks=pytest.mark.slow)], ids=lambda n: f"{n} frame" + "s" * (n > 1)
)
def test_a_recording_and_a_page_of_any_length(frames: int, tmp_path: Path, happened: Report) -> None:
    """A throw on one frame and one on 60 000 frames have a recording and a page, and their tables are read back
    unchanged."""
    track = tracked(frames)
    record = made.record(clip=None, track=track, simulated=None, fps=1500.0)
    write_recording(tmp_path / "replay.rrd", record)
    write_report(tmp_path / "report.html", record)
    write_track(tmp_path / "track.csv", track)
    again = read_track(tmp_path / "track.csv")
    assert len(again) == frames
    np.testing.assert_allclose(again.position_m, track.position_m, rtol=1e-12)
    happened(", ".join(size_of(tmp_path / name) for name in ("replay.rrd", "report.html", "track.csv")))


def test_a_track_without_poses_has_a_page(tmp_path: Path, happened: Report) -> None:
    """The page of a track without poses and without a fit contains no NaN."""
    lost = replace(
        tracked(40), position_m=np.full((40, 3), np.nan), quaternion=np.full((40, 4), np.nan),
        covariance=np.full((40, 6, 6), np.nan), status=np.full(40, LOST, dtype="<U7"),
    )  # fmt: skip
    record = made.record(track=lost, fit=None, simulated=None, estimates=())
    write_recording(tmp_path / "replay.rrd", record)
    write_report(tmp_path / "report.html", record)
    assert "nan" not in (tmp_path / "report.html").read_text(encoding="utf-8").split("<body")[-1].split("base64")[0]
    happened(", ".join(size_of(tmp_path / name) for name in ("replay.rrd", "report.html")))
