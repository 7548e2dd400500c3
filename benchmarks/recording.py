"""Time to write a recording, and its size, for 260 frames (a usual clip) and 600.

    PYTHONPATH=tests/helpers python benchmarks/recording.py
    PYTHONPATH=tests/helpers python benchmarks/recording.py --presets

The clip is grey noise with the contrast of a wooden board and a moving square, which AV1 compresses about as well as a real
clip. The same recording without the clip gives the time of everything else. Each time is the best of three.

With `--presets` the clips in data_samples are encoded at each preset of SVT-AV1: processor time and bytes in those of preset 8,
and the difference of the peak signal-to-noise ratio [dB], medians and ranges over the clips.
"""

from __future__ import annotations

import io
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest import mock

import av
import numpy as np
import replay_records as made
from measuring import spread, timed

from diethrow.commands.clip.footage import open_footage
from diethrow.files.scene import read_scene
from diethrow.files.throw_records import simulated_track
from diethrow.fitting.results import Fit
from diethrow.model.laws import SmoothImpact
from diethrow.model.throw.motion import State
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.replay.elements import video
from diethrow.replay.elements.record import Record
from diethrow.replay.recording.throw_recording import write_recording
from diethrow.tracking.track import Track

FPS = 1500.0
SAMPLES = Path(__file__).parents[1] / "data_samples"
PRESETS = ("8", "9", "10", "11", "12", "13")
SIDE_PX = 384
SQUARE_PX = 60


def record_of(frames: int) -> Record:
    """A cube that falls and bounces during `frames` frames, with a model and a clip."""
    die = made.die()
    release = State(
        0.0,
        np.array([0.0, 0.0, 0.05]),
        np.array([1.0, 0.0, 0.0, 0.0]),
        np.array([0.2, 0.1, -1.0]),
        np.array([30.0, 20, 5]),
    )
    throw = throw_die(die, release, SmoothImpact(0.6), until=Until(time_s=frames / FPS)).throw
    number = np.arange(frames)
    track = simulated_track(throw, number, number / FPS)
    covariance = np.tile(np.diag([1e-5**2] * 3 + [1e-3**2] * 3), (frames, 1, 1))
    seen = Track(number, track.time_s, track.position_m, track.quaternion, covariance, track.status)
    fit: Fit = made.fit(throw=throw)
    record = made.record(track=seen, measured=throw, simulated=track, fit=fit, fps=FPS)
    return replace(record, clip=film(frames), camera=record.camera)


def film(frames: int) -> made.ArrayClip:
    """Constant noise, a little varying noise, and a moving bright square."""
    rng = np.random.default_rng(1)
    board = np.kron(rng.normal(70.0, 12.0, (SIDE_PX // 4, SIDE_PX // 4)), np.ones((4, 4)))
    pictures = np.empty((frames, SIDE_PX, SIDE_PX), np.uint8)
    for k in range(frames):
        picture = board + rng.normal(0.0, 2.0, board.shape)
        left = int((SIDE_PX - SQUARE_PX) * k / frames)
        picture[160 : 160 + SQUARE_PX, left : left + SQUARE_PX] += 120.0
        pictures[k] = np.clip(picture, 0, 255)
    return made.ArrayClip(pictures, np.arange(frames) / FPS)


def seconds_for(record: Record, path: Path) -> float:
    """The best of three."""
    return min(timed(partial(write_recording, path, record), time.perf_counter)[1] for _ in range(3))


def print_presets() -> None:
    """A line for each preset."""
    clips = [
        open_footage(scene, scene.views()[0])
        for path in sorted(SAMPLES.glob("*/scene.toml"))
        for scene in [read_scene(path)]
    ]
    # In memory, so that decoding the clips takes no time here.
    films = [made.ArrayClip(np.stack(list(clip.frames())), clip.times_s, clip.bit_depth) for clip in clips]
    usual: list[tuple[float, int, float]] = []
    print("preset  time                 bytes                dB")
    for preset in PRESETS:
        with mock.patch.object(video, "AV1_PRESET", preset):
            found = [encoded(film) for film in films]
        usual = usual or found
        pairs = list(zip(found, usual, strict=True))
        times, sizes = [a[0] / b[0] for a, b in pairs], [a[1] / b[1] for a, b in pairs]
        worse = [a[2] - b[2] for a, b in pairs]
        print(f"{preset:>6}  {spread(times, 2):20} {spread(sizes, 3):20} {spread(worse, 2)}", flush=True)


def encoded(film: made.ArrayClip) -> tuple[float, int, float]:
    """Processor time [s], the best of three, bytes, and peak signal-to-noise ratio [dB] of a clip as video."""
    window = video.display_window(film)
    data, seconds = min((timed(partial(video.encode_av1, film, window)) for _ in range(3)), key=lambda each: each[1])
    squares = []
    with av.open(io.BytesIO(data)) as container:
        for picture, shown in zip(container.decode(video=0), film.array, strict=True):
            levels = picture.to_ndarray(format="gray")[: film.height_px, : film.width_px].astype(float)
            squares.append(np.mean((levels - window.apply(shown)) ** 2))
    return seconds, len(data), float(10.0 * np.log10(255.0**2 / np.mean(squares)))


def main() -> None:
    """A line for each length, or for each preset."""
    if sys.argv[1:] == ["--presets"]:
        print_presets()
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "replay.rrd"
        for frames in (260, 600):
            record = record_of(frames)
            beyond = seconds_for(replace(record, clip=None), path)
            rest = path.stat().st_size
            whole = seconds_for(record, path)
            size = path.stat().st_size
            print(
                f"{frames} frames: {whole:.2f} s, of which {beyond:.2f} s beyond the film; "
                f"{1e-6 * size:.2f} MB, of which {1e-6 * rest:.2f} MB beyond the film"
            )


if __name__ == "__main__":
    main()
