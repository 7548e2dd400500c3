"""What one picture says of a pose: `python benchmarks/single_frames.py [--clips 48] [--seed 1]`.

Frames of the random clips of `population.py` are refined from their true poses, once by the edges of the die alone, with
the light of the clip (`with_light`), and once as frames are tracked: well-rounded dice by their whole surface. What a
refinement loses from the truth, no search or tracking recovers on that frame; a track has smaller errors, since many frames
share its flights. NEES is the squared error in the stated covariance, 5.35 where that is honest. The errors of pixels beside
edges count as correlated as the frames of the clip show them (`independent_share`).

A row for each kind of clip: frames; frames without a pose; then, by edges and as tracked, the median and the 90th
percentile of the rotation error [deg], the medians of the errors across and along the line of sight [mm], and the median
NEES. Clips are rendered where they are missing in `--cache`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from accuracy import read_columns, read_truth, rotations_onto
from numpy.typing import NDArray
from population import DEFAULT_CACHE, progress, rendered_clip, squared_distances
from population_clips import RENDERER_VERSION, draw_clip

from diethrow.commands.clip.footage import open_background, open_footage
from diethrow.executors import Processes, cores
from diethrow.files.scene import read_scene
from diethrow.model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, rotvec_from_quat
from diethrow.tracking.clip_parameters import BLUR_FRAMES, estimate_lens, with_light
from diethrow.tracking.footage import FrameSource, clip_in_light, estimate_background, level_grey
from diethrow.tracking.picture import LINES, PixelNoise, View, independent_share, make_view, pixel_noise, with_lens
from diethrow.tracking.pose import ClipPoses, Pose, pose_state, refine_pose

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
T = TypeVar("T")

FRAMES = 16
"""Frames of a clip, spread over those that show the whole die."""
INITIAL_BLUR_PX = 0.7
"""Lens blur until it is estimated."""
HEADS = (
    "kind",
    "frames",
    "none",
    "edges: rotation",
    "lateral",
    "depth",
    "NEES",
    "tracked: rotation",
    "lateral",
    "depth",
    "NEES",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Render, refine, and print the table."""
    found = over_clips(__doc__, arguments, clip_errors)
    kinds = sorted({kind for kinds, _ in found for kind in kinds})
    rows = [HEADS, row_of("all", [errors for _, errors in found])]
    rows += [row_of(kind, [errors for kinds, errors in found if kind in kinds]) for kind in kinds]
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEADS))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    return 0


def over_clips(doc: str | None, arguments: Sequence[str] | None, of_clip: Callable[[Path, int, int], T]) -> list[T]:
    """What a function of the folder of clips, the seed and the number of a clip returns for the clips that the command line asks
    for, in any order."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=48, help="number of clips (%(default)s)")
    parser.add_argument("--first", type=int, default=0, help="number of the first clip (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="(%(default)s)")
    parser.add_argument("--cache", type=Path, default=DEFAULT_CACHE, help="folder of clips (%(default)s)")
    parser.add_argument("--workers", type=int, default=cores(), help="processes (%(default)s)")
    chosen = parser.parse_args(arguments)
    clips = chosen.cache / f"seed{chosen.seed}_v{RENDERER_VERSION}"
    with Processes(chosen.workers) as processes:
        numbers = range(chosen.first, chosen.first + chosen.clips)
        return [*progress([processes.submit(of_clip, clips, chosen.seed, k) for k in numbers])]


def clip_errors(clips: Path, seed: int, number: int) -> tuple[tuple[str, ...], Array]:
    """The kinds of a clip, and (2, frames, 4) errors by edges and as tracked: rotation [deg], across and along the line of
    sight [mm], squared in the stated covariance; NaN where a frame gave no pose."""
    draw = draw_clip(seed, number)
    folder = rendered_clip(clips, draw, number)
    view, source = view_of(folder)
    poses = true_poses(folder, view, len(source))
    lit = with_light(view, source.frame, poses)
    as_tracked = view if view.shows_surface(np.median(poses.position_m[poses.known], axis=0)) else lit
    lens = estimate_lens(as_tracked, poses.sample(source.frame, poses.known, BLUR_FRAMES))
    known = np.flatnonzero(poses.known)
    rows = known[np.unique(np.linspace(0, len(known) - 1, FRAMES).astype(int))]
    ways = [(with_lens(lit, lens), True), (with_lens(as_tracked, lens), False)]
    return draw.kinds, np.array([errors_of_frames(*way, source, poses, rows) for way in ways])


def view_of(folder: Path, *, states_response: bool = True) -> tuple[View, FrameSource]:
    """What the tracker knows of a clip before it begins, and its frames; without the response of the scene if that is wanted."""
    scene = read_scene(folder / "scene.toml")
    if not states_response:
        scene = replace(scene, clip=replace(scene.clip, response=None))
    first = scene.views()[0]
    filmed = open_footage(scene, first)
    clip = clip_in_light(filmed, scene.clip.response)
    background = open_background(scene, first, filmed)
    unit_grey = level_grey(filmed, scene.clip.response)
    source = FrameSource([clip])
    frames = [np.asarray(clip.frame(int(k)), np.float32) for k in np.linspace(0, len(clip) - 1, FRAMES).astype(int)]
    if background is None:
        background = estimate_background(clip)
    noise: PixelNoise = pixel_noise(frames, background, unit_grey)
    exposure_s, readout_s = scene.clip.exposure_s, scene.clip.readout_s
    view = make_view(
        first.camera, scene.die, background, noise, exposure_s, INITIAL_BLUR_PX, readout_s=readout_s
    )  # fmt: skip
    return view, source


def true_poses(folder: Path, view: View, count: int) -> ClipPoses:
    """The true poses and motions of the frames that show the whole die, when the row of its centre is exposed."""
    truth, columns = read_truth(folder), read_columns(folder / "truth.csv")
    velocity, omega = (
        np.stack([columns[name] for name in names], 1) for names in (("vx", "vy", "vz"), ("wx", "wy", "wz"))
    )
    turn = rotations_onto(truth.vertices_m, view.die.solid.vertices)[0]
    late_s = view.exposure_delay_s(truth.position_m)[:, None]
    poses = ClipPoses.empty(count)
    poses.position_m[:] = truth.position_m + late_s * velocity
    poses.rotation[:] = matrix_from_quat(quat_from_rotvec(late_s * omega)) @ truth.rotation @ turn.T
    poses.motion[:] = np.concatenate([velocity, omega], 1)
    poses.known[:] = truth.visible
    return poses


def errors_of_frames(view: View, edges_alone: bool, source: FrameSource, poses: ClipPoses, rows: Rows) -> Array:
    """(n, 4) errors of the poses of some frames."""
    found = []
    for k in rows.tolist():
        motion = poses.motion[k]
        start = pose_state(poses.position_m[k], poses.rotation[k], motion[:3], motion[3:])
        image = np.asarray(source.frame(k), np.float32)
        found.append(refine_pose(view, image, start, coarse=0, edges_alone=edges_alone))
    statistics = np.array([pose.statistics for pose in found])
    by_edges = statistics[:, LINES] > 0.0
    shares = np.where(by_edges, independent_share(statistics[by_edges]), 1.0)
    return np.array([frame_errors(view, poses, *each) for each in zip(rows.tolist(), found, shares, strict=True)])


def frame_errors(view: View, poses: ClipPoses, k: int, pose: Pose, share: float) -> Array:
    """(4,) errors of the pose of one frame, whose information is multiplied by `share`."""
    if pose.covariance is None:
        return np.full(4, np.nan)
    p, R, covariance = poses.position_m[k], poses.rotation[k], pose.covariance / share
    turned = rotvec_from_quat(quat_from_matrix(R @ pose.rotation.T))
    error = np.concatenate([p - pose.position_m, turned])
    seen_mm = 1e3 * view.camera.rotation @ error[:3]
    nees = squared_distances(error[None], covariance[None])[0]
    return np.array([np.degrees(np.linalg.norm(turned)), np.hypot(*seen_mm[:2]), abs(seen_mm[2]), nees])


def row_of(kind: str, errors: Sequence[Array]) -> tuple[str, ...]:
    """The cells of one kind."""
    both = np.concatenate(errors, axis=1)
    cells = [kind, str(both.shape[1]), str(int(np.isnan(both[0, :, 0]).sum()))]
    for one in both:
        known = one[np.isfinite(one).all(1)]
        rotation, lateral, depth, nees = np.median(known, axis=0)
        cells += [
            f"{rotation:.2f} / {np.percentile(known[:, 0], 90):.2f}",
            f"{lateral:.3f}",
            f"{depth:.2f}",
            f"{nees:.0f}",
        ]
    return tuple(cells)


if __name__ == "__main__":
    sys.exit(main())
