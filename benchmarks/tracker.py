"""The tracker's accuracy and speed, clip by clip: `PYTHONPATH=tests/helpers python benchmarks/tracker.py CLIP_FOLDER...`

A clip folder holds `scene.toml`, what it names, and its truth (see `benchmarks/accuracy.py`; `diethrow film` and
`benchmarks/make_clips.py` write such folders). Every clip is tracked in a separate process: once from its file, and once
from decoded frames to measure the speed. The poses are those of `track.csv`: per frame, and smoothed within a flight.

  tracked    share of the frames with a pose, among those that show the whole die
  wrong      frames off by more than 5 degrees or 1 mm across the line of sight
  rotation   geodesic angle [deg], median and 95th percentile
  lateral    error of the centre across the line of sight [mm], the same; px: in pixels; depth: along it [mm]
  NEES       normalised estimation error squared, median (5.35 for correct covariances); and the share of frames
             within the 95 % ellipsoid
  bounces    found, of those in view with no other within two frames; + spurious bounces
  vertex     found bounces with the correct corner; late: error of their time [frames], median
  decoded    frames a second from decoded frames, by the clock and by processor time. Initialisation, segmentation and the
             marks take a constant time per clip: `benchmarks/long_clip.py` measures the rates of long clips
  MB         peak memory of the process, of which code and libraries take 300 MB

The second table holds the medians over the clips at each quality.

The last table compares the tracker with the Cramér-Rao bound, on pictures that meet its assumptions: faces of one unknown
grey, Gaussian edges, white noise. J is the derivative of the noiseless picture by the pose and by the grey of every face.
The bound B is the pose's block of (JᵀJ/σ²)⁻¹, from all pixels. C is the covariance of the tracker's errors over many draws
of the noise. The table has sqrt(tr(B⁻¹C)/6), which is 1 for an efficient estimator, and the standard deviations.

`--picture FILE` draws accuracy against speed if there are several qualities. `--keep FILE` writes every result to a file at
once, and skips results that the file already holds, so that many clips can be measured in parts.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import footage_of_throws
import numpy as np
from accuracy import (
    MATCHED_FRAMES,
    WRONG_DEG,
    WRONG_M,
    Truth,
    body_turn,
    findable,
    read_truth,
    rows_of,
    truth_corners,
    truth_folder,
    turn_errors,
)
from footage_of_throws import DICE, Studio, greys, photograph, studio
from measuring import peak_MB
from numpy.typing import NDArray
from replay_records import ArrayClip

from diethrow.commands.clip.footage import open_footage
from diethrow.commands.clip.track import track_scene
from diethrow.files.scene import Scene, read_scene
from diethrow.model.die.die import Die
from diethrow.model.rotations import (
    matrix_from_quat,
    quat_from_matrix,
    quat_from_rotvec,
    quat_multiply,
    rotation_between,
)
from diethrow.model.throw.motion import Impact, State
from diethrow.runs import Tracking
from diethrow.tracking.footage.clip import Clip
from diethrow.tracking.picture import PixelNoise
from diethrow.tracking.picture.view import make_view
from diethrow.tracking.pose.refine import pose_state, refine_pose
from diethrow.tracking.quality import QUALITIES, STANDARD, Quality

Array = NDArray[np.float64]

CHI2_95 = 12.592
"""95 % of chi-square with six degrees of freedom."""
ROWS = (
    *("tracked", "wrong", "rotation", "lateral", "px", "depth", "NEES", "bounces", "vertex", "late"),
    *("decoded", "MB"),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both tables and draw the picture; the exit status is 1 where a clip failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", type=Path, metavar="CLIP_FOLDER")
    parser.add_argument("--truth", type=Path, help="the folder of the truth, if it is not the clip's own")
    parser.add_argument("--qualities", nargs="+", choices=QUALITIES, default=list(QUALITIES))
    parser.add_argument("--picture", type=Path, help="where to draw the trade between the qualities")
    parser.add_argument("--keep", type=Path, help="a file of results to begin with and to add to")
    parser.add_argument("--draws", type=int, default=200, help="of the noise, against the bound; 0 for no such table")
    parser.add_argument("--band-px", type=float, default=STANDARD.band_px, help="about the edges, against the bound")
    chosen = parser.parse_intermixed_args(arguments)
    results, failures = measured_clips(chosen)
    if results:
        print_rows(["clip", "quality", *ROWS], [[r["clip"], r["quality"], *texts(r)] for r in results])
        print()
        print_rows(["quality", "clips", *MIDDLES], [middles(q, results) for q in chosen.qualities])
    if chosen.picture and results:
        draw_trade(chosen.picture, results)
    if chosen.draws:
        print()
        print_rows(["die", "quality", "/ bound", "rotation", "lateral", "depth"], efficiency_rows(chosen))
    return 1 if failures else 0


def measured_clips(chosen: argparse.Namespace) -> tuple[list[dict[str, Any]], int]:
    """Results of every clip at every quality, including kept ones, and the number of clips that failed."""
    kept = chosen.keep.read_text().splitlines() if chosen.keep is not None and chosen.keep.exists() else []
    results: list[dict[str, Any]] = [json.loads(line) for line in kept]
    have, failures = {(r["clip"], r["quality"]) for r in results}, 0
    for folder, quality in product(chosen.clips, chosen.qualities):
        if (folder.resolve().name, quality) in have:
            continue
        try:
            results.append(in_own_process(folder, chosen.truth or truth_folder(folder), quality))
        except (ValueError, OSError) as error:
            failures += 1
            print(f"{folder}, {quality}: {error}", file=sys.stderr)
            continue
        if chosen.keep is not None:
            with chosen.keep.open("a") as file:
                file.write(json.dumps(results[-1]) + "\n")
    return results, failures


# --- one clip ---------------------------------------------------------------------------------------------------------


def in_own_process(folder: Path, truth_at: Path, quality: str) -> dict[str, Any]:
    """Measure a clip in a new process, for its peak memory. Raises what the measurement raises."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(measure, (folder, truth_at, quality))


def measure(folder: Path, truth_at: Path, quality: str) -> dict[str, Any]:
    """Track one clip and compare: numbers by name."""
    scene, truth = read_scene(folder / "scene.toml"), read_truth(truth_at)
    tracking = tracked(scene, quality, None)  # compiles, too
    # Before the clip is decoded into memory, which tracking does not do.
    most_MB = peak_MB()
    view = scene.views()[0]
    clip = open_footage(scene, view)
    decoded = ArrayClip(np.stack(list(clip.frames())), np.asarray(clip.times_s), clip.bit_depth, clip.first_frame)
    began, used = time.perf_counter(), time.process_time()
    tracked(scene, quality, decoded)
    decoded_s, used_s = time.perf_counter() - began, time.process_time() - used
    rates = {"decoded": (len(clip) / decoded_s, len(clip) / used_s), "MB": most_MB}
    name = folder.resolve().name
    return {"clip": name, "quality": quality} | errors(scene, truth, tracking) | rates


def tracked(scene: Scene, quality: str, clip: Clip | None) -> Tracking:
    """The tracking stage, from the files of the scene or from decoded frames."""
    return track_scene(scene, quality=QUALITIES[quality], clips=None if clip is None else [clip])


def errors(scene: Scene, truth: Truth, tracking: Tracking) -> dict[str, Any]:
    """Errors of the poses and bounces."""
    track = tracking.smoothed
    row = rows_of(track, truth)
    turn = body_turn(track, truth, row, scene)
    both = truth.visible[row] & track.tracked
    moved = truth.position_m[row[both]] - track.position_m[both]
    turned = turn_errors(matrix_from_quat(track.quaternion[both]) @ turn, truth.rotation[row[both]])
    camera = scene.views()[0].camera
    in_camera = moved @ camera.rotation.T
    across, along = np.linalg.norm(in_camera[:, :2], axis=1), np.abs(in_camera[:, 2])
    px_per_m = camera.matrix[0, 0] / np.linalg.norm(track.position_m[both] - camera.centre_m, axis=1)
    angle = np.degrees(np.linalg.norm(turned, axis=1))
    nees = squared_sigmas(np.concatenate([moved, turned], 1), track.covariance[both])
    return {
        "tracked": float(both.sum() / truth.visible[row].sum()),
        "wrong": int(((angle > WRONG_DEG) | (across > WRONG_M)).sum()),
        "rotation": spread_of(angle),
        "lateral": spread_of(1e3 * across),
        "px": spread_of(across * px_per_m),
        "depth": spread_of(1e3 * along),
        "NEES": (float(np.median(nees)), float((nees < CHI2_95).mean())),
    } | bounce_errors(tracking.measured.impacts, truth, truth_corners(turn, scene, truth))


def squared_sigmas(error: Array, covariance: Array) -> Array:
    """(n,) eᵀ P⁻¹ e of errors (n, 6) with covariances (n, 6, 6)."""
    return np.asarray(np.einsum("ki,ki->k", error, np.linalg.solve(covariance, error[..., None])[..., 0]))


def spread_of(values: Array) -> tuple[float, float]:
    """Median and 95th percentile."""
    return float(np.median(values)), float(np.percentile(values, 95))


def bounce_errors(impacts: Sequence[Impact], truth: Truth, true_corner: NDArray[np.int64]) -> dict[str, Any]:
    """Number and errors of the bounces found."""
    frame_s = float(np.median(np.diff(truth.time_s)))
    times = np.array([impact.time_s for impact in impacts])
    gaps = np.abs(times[:, None] - truth.bounce_s) / frame_s
    wanted = np.flatnonzero(findable(truth, frame_s))
    found = [k for k in wanted if gaps[:, k].min(initial=np.inf) < MATCHED_FRAMES]
    nearest = [int(gaps[:, k].argmin()) for k in found]
    named = [[int(true_corner[v]) for v in impacts[m].vertices] for m in nearest]
    right = sum(corners == [int(truth.bounce_vertex[k])] for corners, k in zip(named, found, strict=True))
    return {
        "bounces": (len(found), len(wanted), int((gaps.min(1, initial=np.inf) > MATCHED_FRAMES).sum())),
        "vertex": (right, len(found)),
        "late": float(np.median([gaps[m, k] for m, k in zip(nearest, found, strict=True)])) if found else np.nan,
    }


def texts(result: dict[str, Any]) -> Iterator[str]:
    """The cells of a row."""
    digits = {"rotation": 3, "lateral": 4, "px": 3, "depth": 3}
    for name in ROWS:
        value = result[name]
        if name in digits:
            yield f"{value[0]:.{digits[name]}f} / {value[1]:.{digits[name]}f}"
        elif name == "decoded":
            yield f"{value[0]:.0f}, {value[1]:.0f}"
        elif name == "tracked":
            yield f"{100 * value:.1f} %"
        elif name == "NEES":
            yield f"{value[0]:.1f}, {100 * value[1]:.0f} %"
        elif name == "bounces":
            yield f"{value[0]}/{value[1]} + {value[2]}"
        elif name == "vertex":
            yield f"{value[0]}/{value[1]}"
        else:
            yield f"{value:.3f}" if name == "late" else f"{value:.0f}"


MIDDLES = ("tracked", "rotation", "lateral", "px", "depth", "NEES", "decoded", "CPU ms")


def middles(quality: str, results: Sequence[dict[str, Any]]) -> list[str]:
    """The row of a quality: medians over the clips, and the smallest share of frames tracked."""
    mine = [r for r in results if r["quality"] == quality]
    if not mine:
        return [quality, "0", *([""] * len(MIDDLES))]
    pairs = {
        name: np.median([r[name] for r in mine], axis=0) for name in ("rotation", "lateral", "px", "depth", "NEES")
    }
    return [
        quality,
        str(len(mine)),
        f"{100 * min(r['tracked'] for r in mine):.1f} %",
        *(f"{a:.4f} / {b:.4f}" for a, b in (pairs[name] for name in ("rotation", "lateral", "px", "depth"))),
        f"{pairs['NEES'][0]:.1f}, {100 * pairs['NEES'][1]:.0f} %",
        f"{np.median([r['decoded'][0] for r in mine]):.0f}",
        f"{1e3 / np.median([r['decoded'][1] for r in mine]):.2f}",
    ]


def print_rows(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table in columns."""
    widths = [max(len(row[k]) for row in (heads, *rows)) for k in range(len(heads))]
    for row in (heads, *rows):
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def draw_trade(path: Path, results: Sequence[dict[str, Any]]) -> None:
    """Rotation error over frames a second: a line for each clip, a point for each quality."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), dpi=150, layout="constrained")
    ax = figure.add_subplot()
    markers = dict(zip(QUALITIES, "o^s", strict=False))
    for k, clip in enumerate(dict.fromkeys(r["clip"] for r in results)):
        mine = [r for r in results if r["clip"] == clip]
        x, y = [r["decoded"][0] for r in mine], [r["rotation"][0] for r in mine]
        ax.plot(x, y, color=f"C{k % 10}", linestyle=("-", "--")[k // 10 % 2], linewidth=1, label=clip)
        for r in mine:
            ax.plot(r["decoded"][0], r["rotation"][0], markers[r["quality"]], color=f"C{k % 10}", markersize=6)
    for quality, marker in markers.items():
        ax.plot([], [], marker, color="0.4", label=quality)
    ax.set(
        xscale="log", yscale="log", xlabel="frames a second, from decoded frames", ylabel="rotation error, median [deg]"
    )
    ax.grid(alpha=0.3, which="both")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    ax.tick_params(which="both", labelsize=7)
    figure.legend(fontsize=7, loc="outside right upper")
    figure.savefig(path)


# --- against the bound ------------------------------------------------------------------------------------------------

STEPS = np.array([2e-5] * 3 + [2e-3] * 3)
"""Half steps of the derivatives [m, rad]: 0.1 px, where the picture is linear and supersampling has no effect."""
NOISE_GREY = 4.0
START = np.array([5e-5] * 3 + [5e-3] * 3)
"""Standard deviation of the initial poses [m, rad]: that of a prediction from a flight."""
POSES = 4
"""Number of poses of each die."""


def efficiency_rows(chosen: argparse.Namespace) -> list[list[str]]:
    """One row for each die and quality."""
    return [
        efficiency_row(name, die, replace(QUALITIES[quality], band_px=chosen.band_px), chosen.draws)
        for name, die in DICE.items()
        for quality in chosen.qualities
    ]


def efficiency_row(name: str, die: Die, quality: Quality, draws: int) -> list[str]:
    """Errors of single frames over many draws of the noise, and the bound."""
    room = studio()
    room = Studio(room.camera, room.table, noise_grey=NOISE_GREY)
    rng = np.random.default_rng(1)
    ratios, spreads = [], []
    for pose in range(POSES):
        state = random_state(np.random.default_rng([2, pose]))  # the same for every die, quality and number of draws
        bound = bound_of(room, die, state)
        covariance = covariance_of(room, die, state, quality, draws, rng)
        ratios.append(np.trace(np.linalg.solve(bound, covariance)) / 6.0)
        spreads.append([components(room, matrix) for matrix in (covariance, bound)])
    ours, least = np.sqrt(np.mean(np.square(spreads), axis=0))
    pairs = [f"{a:.4f} ({b:.4f}) {unit}" for a, b, unit in zip(ours, least, ("deg", "mm", "mm"), strict=True)]
    return [name, quality.name, f"{np.sqrt(np.mean(ratios)):.2f}", *pairs]


def random_state(rng: np.random.Generator) -> State:
    """A random orientation at rest in the middle of the picture: without motion blur."""
    quaternion = rng.standard_normal(4)
    position = np.array([*rng.uniform(-2e-3, 2e-3, 2), 0.018])
    return State(0.0, position, quaternion / np.linalg.norm(quaternion), np.zeros(3), np.zeros(3))


def bound_of(room: Studio, die: Die, state: State) -> Array:
    """(6, 6) least covariance of the pose that an unbiased estimator can have: position [m], rotation vector [rad]."""
    paint = greys(die, state.rotation)
    columns = []
    for step in np.diag(STEPS):
        ahead, behind = (painted(room, die, shifted(state, sign * step), paint) for sign in (1.0, -1.0))
        columns.append((ahead - behind) / (2.0 * step.max()))
    # The picture is linear in the greys of the faces.
    plain = painted(room, die, state, paint)
    columns += [painted(room, die, state, paint + unit) - plain for unit in np.eye(len(paint))]
    J = np.stack([column.ravel() for column in columns if np.abs(column).max() > 0.0], 1) / NOISE_GREY
    scale = np.linalg.norm(J, axis=0)
    return np.asarray((np.linalg.inv((J / scale).T @ (J / scale)) / np.outer(scale, scale))[:6, :6])


def painted(room: Studio, die: Die, state: State, paint: Array) -> Array:
    """The noiseless picture of a die whose faces have these greys (faces,)."""
    with patch.object(footage_of_throws, "greys", lambda die, rotation: paint):
        return np.asarray(photograph(room, die, state), float)


def shifted(state: State, step: Array) -> State:
    """The state displaced by (6,): metres, and a rotation vector in world axes."""
    quaternion = quat_multiply(quat_from_rotvec(step[3:]), state.quaternion)
    return replace(state, position_m=state.position_m + step[:3], quaternion=quaternion)


def covariance_of(
    room: Studio, die: Die, state: State, quality: Quality, draws: int, rng: np.random.Generator
) -> Array:
    """(6, 6) of the tracker's errors about their mean, over draws of the noise, from slightly wrong initial poses."""
    view = make_view(room.camera, die, room.table, PixelNoise(NOISE_GREY), None, room.blur_px, quality=quality)
    plain = photograph(room, die, state)
    found = np.empty((draws, 6))
    for k in range(draws):
        picture = np.asarray(plain + rng.normal(scale=NOISE_GREY, size=plain.shape), np.float32)
        start = shifted(state, rng.standard_normal(6) * START)
        pose = refine_pose(view, picture, pose_state(start.position_m, start.rotation), coarse=1)
        turn = rotation_between(state.quaternion, quat_from_matrix(pose.rotation))
        found[k] = np.concatenate([pose.position_m - state.position_m, turn])
    return np.asarray(np.cov(found.T))


def components(room: Studio, covariance: Array) -> tuple[float, float, float]:
    """Standard deviations: rotation [deg] over all axes, lateral and depth [mm]."""
    in_camera = room.camera.rotation @ covariance[:3, :3] @ room.camera.rotation.T
    rotation = np.degrees(np.sqrt(np.trace(covariance[3:, 3:])))
    return float(rotation), 1e3 * float(np.sqrt(np.trace(in_camera[:2, :2]))), 1e3 * float(np.sqrt(in_camera[2, 2]))


if __name__ == "__main__":
    sys.exit(main())
