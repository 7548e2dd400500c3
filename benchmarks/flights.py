"""What comes after the pictures: time from poses to flights and bounces, `PYTHONPATH=tests/helpers python benchmarks/flights.py`

A throw of a cube is simulated and sampled on a number of frames, with the noise of tracking and without pictures. First one
throw of three bounces with more and more frames, then throws with more and more bounces, filmed at 1500 frames a second.

  measure     flights, impacts, error model and covariances, from the poses of single frames [s]
  calibrated  the same for the sake of the covariances of the single frames [s]
  smooth      every frame put on its flight [s]
  MB          most memory that these took beyond the track itself
  right       of the impacts, those found within half a frame and with their vertex; then those called by a wrong one

Times are processor time, the least of some runs.

Then throws that strike twice within a frame, for each kind of die: how many have both impacts with their vertices, how many are
said to have contacts that are not resolved, and how many of the first four frames behind are off by over five standard errors.
"""

from __future__ import annotations

import argparse
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice
from typing import TypeVar

import numpy as np
from flat_landings import FLAT_DICE, FPS, flat_landings, off_behind
from footage_of_throws import studio
from measuring import timed
from numpy.typing import NDArray

from diethrow.model.die.die import Die, make_die
from diethrow.model.laws import SmoothImpact
from diethrow.model.rotations import quat_from_rotvec, quat_multiply
from diethrow.model.throw.motion import State, Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.throw.measurement import measure, with_calibrated_covariance
from diethrow.tracking.throw.smoothing import smooth
from diethrow.tracking.track import TRACKED, Track

CUBE = make_die("cube", 0.016, 0.0048)
RESTITUTION, ELASTIC = 0.6, 0.85
"""Of the throw with three bounces, and of those with many."""
T = TypeVar("T")

USUAL_FPS, AFTER_S = 1500.0, 0.04
"""Frames a second of the throws with many bounces; how long the die is seen behind the last."""
ACROSS_M, ALONG_M, TURN_RAD = 2e-5, 1.5e-4, np.radians(0.1)
"""Sigmas of a frame: across the line of sight, along it, and of the turn."""
FRAMES_BEHIND = 4
"""Frames behind two impacts that are judged."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row for each length and each number of bounces."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", nargs="*", type=int, default=[260, 2000, 20000])
    parser.add_argument("--bounces", nargs="*", type=int, default=[3, 20, 60])
    parser.add_argument(
        "--flat", type=int, default=25, help="throws of each die that strike twice within a frame (%(default)s)"
    )
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--seed", type=int, default=8)
    chosen = parser.parse_args(arguments)
    print(f"{'frames':>7}{'bounces':>9}{'measure':>9}{'calibrated':>12}{'smooth':>8}{'MB':>7}   right, wrong")
    for frames in chosen.frames:
        report(*thrown(3, RESTITUTION, chosen.seed, frames), chosen.runs)
    for bounces in chosen.bounces:
        report(*thrown(bounces, ELASTIC, chosen.seed), chosen.runs)
    for name, die in FLAT_DICE.items():
        report_flat(name, die, chosen.flat)
    return 0


def thrown(bounces: int, restitution: float, seed: int, frames: int | None = None) -> tuple[Throw, Track]:
    """A throw and its track, on so many frames or at the usual rate."""
    rng = np.random.default_rng(seed)
    turn, spin = rng.normal(size=4), 17.0 * rng.normal(size=3)
    release = State(0.0, np.array([0.0, 0.0, 0.09]), turn / np.linalg.norm(turn), np.array([0.1, 0.0, -0.8]), spin)
    whole = throw_die(CUBE, release, SmoothImpact(restitution), until=Until(impacts=bounces)).throw
    end_s = min(whole.flights[-1].end_s, whole.flights[-1].start.time_s + AFTER_S)
    throw = Throw((*whole.flights[:-1], replace(whole.flights[-1], end_s=end_s)), whole.impacts)
    count = frames or int(end_s * USUAL_FPS)
    return throw, seen(throw, np.linspace(0.0, end_s, count), rng)


def seen(throw: Throw, times_s: NDArray[np.float64], rng: np.random.Generator) -> Track:
    """The throw on some frames, with noise that is as large as stated."""
    position, quaternion = throw.poses(times_s)
    sight = studio().camera.rotation[2]
    across = np.eye(3) - np.outer(sight, sight)
    covariance = np.zeros((len(times_s), 6, 6))
    covariance[:, :3, :3] = ACROSS_M**2 * across + ALONG_M**2 * np.outer(sight, sight)
    covariance[:, 3:, 3:] = TURN_RAD**2 * np.eye(3)
    errors = rng.normal(size=(len(times_s), 6)) @ np.linalg.cholesky(covariance[0]).T
    rotated = quat_multiply(quat_from_rotvec(errors[:, 3:]), quaternion)
    status = np.full(len(times_s), TRACKED)
    return Track(np.arange(len(times_s)), times_s, position + errors[:, :3], rotated, covariance, status)


def report(throw: Throw, track: Track, runs: int) -> None:
    """One row."""
    camera = studio().camera
    found, measuring = fastest(lambda: measure(track, CUBE, camera), runs)
    sure, calibrating = fastest(lambda: with_calibrated_covariance(track, CUBE, camera), runs)
    _, smoothing = fastest(lambda: smooth(sure, found.throw_without_shared_errors, found.shared_covariance), runs)
    tracemalloc.start()
    measure(track, CUBE, camera)
    smooth(sure, found.throw_without_shared_errors, found.shared_covariance)
    most_mb = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    right, wrong = score(throw, found.throw, float(np.median(np.diff(track.time_s))))
    print(
        f"{len(track):7d}{len(throw.impacts):9d}{measuring:9.3f}{calibrating:12.3f}{smoothing:8.3f}{most_mb:7.1f}"
        f"   {right} of {len(throw.impacts)}, {wrong}",
        flush=True,
    )


def report_flat(name: str, die: Die, count: int) -> None:
    """A row of throws that strike twice within a frame."""
    both, unresolved, off, behind = 0, 0, 0, 0
    for throw, rng in islice(flat_landings(die), count):
        track = seen(throw, np.arange(int(throw.flights[-1].end_s * FPS) + 1) / FPS, rng)
        found = measure(track, die)
        both += [impact.vertices for impact in found.throw.impacts] == [impact.vertices for impact in throw.impacts]
        unresolved += any(impact.contact == "unresolved" for impact in found.throw.impacts)
        poses_off = off_behind(throw, found.smoothed_frames)[:FRAMES_BEHIND]
        off, behind = off + int(poses_off.sum()), behind + len(poses_off)
    print(f"{name:12s} both {both} of {count}, unresolved {unresolved}; frames off {off} of {behind}", flush=True)


def fastest(work: Callable[[], T], runs: int) -> tuple[T, float]:
    """The result of some work, and its least processor time [s], after a first run."""
    work()
    timings = [timed(work) for _ in range(runs)]
    return timings[-1][0], min(seconds for _, seconds in timings)


def score(true: Throw, found: Throw, spacing_s: float) -> tuple[int, int]:
    """How many of the true impacts were found with their vertex, and how many found ones have a wrong vertex."""
    times_s = np.array([impact.time_s for impact in true.impacts])
    named = [impact for impact in found.impacts if impact.vertices]
    nearest = [int(np.abs(times_s - impact.time_s).argmin()) for impact in named]
    good = [
        abs(times_s[k] - impact.time_s) < 0.5 * spacing_s and true.impacts[k].vertices == impact.vertices
        for k, impact in zip(nearest, named, strict=True)
    ]
    return sum(good), len(good) - sum(good)


if __name__ == "__main__":
    raise SystemExit(main())
