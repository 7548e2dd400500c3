"""How far off the refinement of a well-rounded die may begin: `python benchmarks/reach.py [--clips 48] [--seed 1]`.

Frames of those random clips of `population.py` whose dice are compared by their whole surface (corners that are balls of 0.4
px or more) are refined from poses that lie some pixels and degrees beside the true one, in random directions: by the edges
alone, and by the surface, each after so many coarse steps. The table gives the share of frames [%] that come within NEAR_DEG
of the true pose. Frames whose refinement from the true pose itself ends farther away are left out.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from population import rendered_clip
from population_clips import draw_clip
from single_frames import over_clips, true_poses, view_of

from diethrow.model.rotations import angle_between, matrix_from_quat, quat_from_rotvec
from diethrow.tracking.pose import pose_state, refine_pose

Array = NDArray[np.float64]

FRAMES = 6
"""Frames of a clip, spread over those that show the whole die."""
STARTS = ((1.0, 1.0), (3.0, 3.0), (6.0, 3.0), (3.0, 8.0), (10.0, 8.0))
"""Distances of the starts from the true pose: [px] and [deg]."""
COARSE = (0, 2, 4)
"""Coarse steps."""
NEAR_DEG = 2.0
"""Angle within which a pose has come back."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Render, refine, and print the table."""
    found = np.concatenate(over_clips(__doc__, arguments, clip_came_back))
    print(f"{len(found)} frames; came back [%]")
    heads = [f"{way}, {coarse} coarse" for way in ("edges", "surface") for coarse in COARSE]
    print("  ".join(["start".ljust(12), *heads]))
    for k, (off_px, off_deg) in enumerate(STARTS):
        shares = 100.0 * found[:, :, k].mean(axis=0).ravel()
        cells = [f"{share:.0f}".ljust(len(head)) for share, head in zip(shares, heads, strict=True)]
        print("  ".join([f"{off_px:g} px, {off_deg:g}°".ljust(12), *cells]).rstrip())
    return 0


def clip_came_back(clips: Path, seed: int, number: int) -> Array:
    """(frames, 2, starts, coarse) whether the frames of a clip came back, by edges and by the surface; no frames if the die is
    compared by its edges."""
    draw = draw_clip(seed, number)
    folder = rendered_clip(clips, draw, number)
    view, source = view_of(folder)
    poses = true_poses(folder, view, len(source))
    known = np.flatnonzero(poses.known)
    rows = known[np.unique(np.linspace(0, len(known) - 1, FRAMES).astype(int))]
    found = []
    for k in rows[[view.shows_surface(poses.position_m[k]) for k in rows]]:
        rng, image = np.random.default_rng([seed, number, k]), np.asarray(source.frame(int(k)), np.float32)
        p, R, (velocity, omega) = poses.position_m[k], poses.rotation[k], np.split(poses.motion[k], 2)
        best = refine_pose(view, image, pose_state(p, R, velocity, omega), coarse=0)
        if np.degrees(angle_between(best.rotation, R)) > NEAR_DEG:
            continue
        m_per_px = float(np.linalg.norm(p - view.camera.centre_m)) / view.camera.matrix[0, 0]
        came_back = np.zeros((2, len(STARTS), len(COARSE)))
        for i, (off_px, off_deg) in enumerate(STARTS):
            step, axis = (way / np.linalg.norm(way) for way in rng.normal(size=(2, 3)))
            turned = matrix_from_quat(quat_from_rotvec(np.radians(off_deg) * axis)) @ R
            start = pose_state(p + off_px * m_per_px * step, turned, velocity, omega)
            for j, coarse in enumerate(COARSE):
                for way, edges_alone in enumerate((True, False)):
                    pose = refine_pose(view, image, start, coarse=coarse, roughly=True, edges_alone=edges_alone)
                    came_back[way, i, j] = np.degrees(angle_between(pose.rotation, R)) < NEAR_DEG
        found.append(came_back)
    return np.array(found).reshape(-1, 2, len(STARTS), len(COARSE))


if __name__ == "__main__":
    sys.exit(main())
