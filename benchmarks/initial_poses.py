"""The frames of a clip from which the correct initial pose is found.

    PYTHONPATH=tests/helpers python benchmarks/initial_poses.py CLIP_FOLDER...

A clip folder is as for `benchmarks/tracker.py`: its truth lies beside it or in `tests/data`. Frames are spread over
those that show the whole die. On each, an initial pose is found twice: on that frame alone, and on the clip as if it
began there. It is right if the first and the last pose of its hypothesis are within 5 degrees of the truth, 1 mm
across the line of sight and an edge along it. A larger error means a different pose with a similar picture; the refinement
corrects a smaller one.

  certain    poses on one frame that are accepted at once: right ones, and WRONG ones, of which there should be none
  uncertain  poses on one frame that are compared with those on other frames
  none       frames from which the die cannot be tracked, as just before an impact
  clip       clips that begin there: right, WRONG, and without an initial pose
  ms         processor time on one frame, and on a clip, medians
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from accuracy import WRONG_DEG, WRONG_M, Truth, read_truth, rotations_onto, truth_folder
from measuring import timed
from numpy.typing import NDArray
from tracker import print_rows

from diethrow.commands.clip.track import track_scene
from diethrow.files.scene import Scene, read_scene
from diethrow.model.rotations import angle_between
from diethrow.runs import RunError
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.picture.view import View
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.sequence.initialisation import best_hypothesis, find_initial_pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FEWEST_FRAMES_LEFT = 8
"""Frames after an initial pose without which it cannot be judged."""
OUTCOMES = (
    "certain right",
    "certain wrong",
    "uncertain right",
    "uncertain wrong",
    "none",
    "clip right",
    "clip wrong",
    "clip none",
)
"""Columns of the table, in their order."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the clips and print the table; the exit status is 1 if a clip failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path, metavar="CLIP_FOLDER")
    parser.add_argument("--frames", type=int, default=12, help="frames of each clip on which an initial pose is found")
    parser.add_argument("--all", action="store_true", help="print the outcome of every frame, not only of wrong ones")
    chosen = parser.parse_intermixed_args(arguments)
    rows, failures = [], 0
    for folder in chosen.clips:
        try:
            rows.append(measured(folder, chosen.frames, chosen.all))
        except (ValueError, OSError) as error:
            failures += 1
            print(f"{folder}: {error}", file=sys.stderr)
    heads = [
        "clip",
        "frames",
        "certain",
        "WRONG",
        "uncertain",
        "wrong",
        "none",
        "clip",
        "WRONG",
        "none",
        "ms",
        "ms clip",
    ]
    print_rows(heads, rows)
    return 1 if failures else 0


def measured(folder: Path, count: int, print_all: bool) -> list[str]:
    """The row of one clip."""
    scene, truth = read_scene(folder / "scene.toml"), read_truth(truth_folder(folder))
    view, source, unused = prepared(scene)
    judge = Judge(view, source, truth)
    outcomes: Counter[str] = Counter()
    frame_ms, clip_ms = [], []
    best_hypothesis(view, source, int(judge.frames(1)[0]), unused)  # compiles
    for k in judge.frames(count):
        hypothesis, seconds = timed(partial(best_hypothesis, view, source, k, unused))
        frame_ms.append(1e3 * seconds)
        on_frame = "none"
        if hypothesis is not None:
            on_frame = f"{'certain' if hypothesis.is_certain else 'uncertain'} {judge.verdict(hypothesis.poses, k)}"
        found, seconds = timed(partial(find_initial_pose, view, source, unused | (np.arange(len(source)) < k)))
        clip_ms.append(1e3 * seconds)
        on_clip = "clip none" if found is None else f"clip {judge.verdict(found[1], 0)}"
        outcomes.update([on_frame, on_clip])
        if print_all or "wrong" in on_frame + on_clip:
            print(f"{folder.name}, frame {source.first_frame + k}: {on_frame}, {on_clip}", flush=True)
    cells = [str(outcomes[name]) for name in OUTCOMES]
    return [
        folder.resolve().name,
        str(len(frame_ms)),
        *cells,
        f"{np.median(frame_ms):.0f}",
        f"{np.median(clip_ms):.0f}",
    ]


def prepared(scene: Scene) -> tuple[View, FrameSource, Mask]:
    """The arguments with which the tracker searches the initial pose of a scene.

    Raises ValueError if the scene gives that pose by hand.
    """
    kept: list[tuple[View, FrameSource, Mask]] = []

    def keep(view: View, source: FrameSource, unused: Mask, *_: Any) -> None:
        kept.append((view, source, unused))

    # The tracker prepares them, and stops because no initial pose is found.
    with patch("diethrow.tracking.sequence.tracking_pass.find_initial_pose", keep), suppress(RunError):
        track_scene(scene)
    if not kept:
        raise ValueError("the scene gives its first pose by hand: take [start] out")
    return kept[0]


class Judge:
    """Compares poses of one clip with the truth."""

    def __init__(self, view: View, source: FrameSource, truth: Truth) -> None:
        self.camera, self.edge_m, self.truth = view.camera, view.die.solid.edge_m, truth
        self.row = np.searchsorted(truth.frame, source.first_frame + np.arange(len(source)))
        self.symmetries = rotations_onto(truth.vertices_m, view.die.solid.vertices)

    def frames(self, count: int) -> list[int]:
        """Rows of the clip, spread evenly over those that show the whole die and have FEWEST_FRAMES_LEFT after them."""
        whole = np.flatnonzero(self.truth.visible[self.row[:-FEWEST_FRAMES_LEFT]])
        return [int(k) for k in np.unique(whole[np.linspace(0, len(whole) - 1, count).astype(int)])]

    def verdict(self, poses: ClipPoses, first: int) -> str:
        """Whether the first and the last of the known poses are right; row 0 of `poses` is row `first` of the clip."""
        known = np.flatnonzero(poses.known)
        right = all(self.is_right(poses.position_m[k], poses.rotation[k], int(first + k)) for k in known[[0, -1]])
        return "right" if right else "wrong"

    def is_right(self, position_m: Array, rotation: Array, k: int) -> bool:
        """Whether a pose is that of row k of the clip, up to the labelling of the die."""
        row = self.row[k]
        moved = self.camera.rotation @ (position_m - self.truth.position_m[row])
        turned = angle_between(rotation @ np.array(self.symmetries), self.truth.rotation[row][None])
        across, along = float(np.hypot(*moved[:2])), abs(float(moved[2]))
        return bool(np.degrees(turned.min()) < WRONG_DEG and across < WRONG_M and along < self.edge_m)


if __name__ == "__main__":
    sys.exit(main())
