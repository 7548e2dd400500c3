"""From which frames of a clip the right first pose is found.

    PYTHONPATH=tests/helpers python benchmarks/starts.py CLIP_FOLDER...


A clip folder is as for `benchmarks/tracker.py`: its truth lies beside it or in `tests/data`. On frames spread over those that
show the whole die, a start is made twice: on that frame and no other, and on the clip as if it began there. A start is right
where the first and the last pose of the race that it won are within 5 degrees, 1 mm across the line of sight and an edge
along it of the truth; what is further off is another pose of the die that draws much the same picture, and what is nearer is
left to the refinement.

  sure       starts on one frame that are believed at once: right ones, and WRONG ones, of which there should be none
  unsure     the same of starts that are held, and other frames asked as well
  none       frames from which the die cannot be followed, as just before a bounce
  begun      clips that begin there: right, WRONG, and without a beginning
  ms         processor time of a start on one frame, and of a beginning, medians
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from accuracy import WRONG_DEG, WRONG_M, Truth, angles_rad, read_truth, rotations_onto, truth_folder
from numpy.typing import NDArray
from tracker import print_rows

from diethrow.analysis import RunError
from diethrow.commands.clip.track import track_scene
from diethrow.files.scene import Scene, read_scene
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.picture.view import View
from diethrow.tracking.pose.frame_poses import ClipPoses
from diethrow.tracking.sequence import track_clip
from diethrow.tracking.sequence.initialisation import best_hypothesis, find_initial_pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_LEFT = 8
"""Frames after a start, without which nothing can be said of it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the clips and print the table; the exit status is 1 where a clip failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path, metavar="CLIP_FOLDER")
    parser.add_argument("--frames", type=int, default=12, help="of each clip on which a start is made")
    parser.add_argument("--all", action="store_true", help="tell of every frame, not of the wrong ones alone")
    chosen = parser.parse_intermixed_args(arguments)
    rows, failures = [], 0
    for folder in chosen.clips:
        try:
            rows.append(measured(folder, chosen.frames, chosen.all))
        except (ValueError, OSError) as error:
            failures += 1
            print(f"{folder}: {error}", file=sys.stderr)
    heads = ["clip", "frames", "sure", "WRONG", "unsure", "wrong", "none", "begun", "WRONG", "none", "ms", "ms begun"]
    print_rows(heads, rows)
    return 1 if failures else 0


def measured(folder: Path, count: int, everything: bool) -> list[str]:
    """The row of one clip."""
    scene, truth = read_scene(folder / "scene.toml"), read_truth(truth_folder(folder))
    view, source, unused = prepared(scene)
    judge = Judge(view, source, truth)
    told: Counter[str] = Counter()
    alone_ms, begun_ms = [], []
    best_hypothesis(view, source, int(judge.frames(1)[0]), unused)  # compiles
    for k in judge.frames(count):
        alone, ms = timed(best_hypothesis, view, source, k, unused)
        alone_ms.append(ms)
        verdict = "none" if alone is None else f"{'sure' if alone.sure else 'unsure'} {judge.of(alone.seen, k)}"
        cut = unused | (np.arange(len(source)) < k)
        begun, ms = timed(find_initial_pose, view, source, cut)
        begun_ms.append(ms)
        outcome = "begun none" if begun is None else f"begun {judge.of(begun[1], 0)}"
        told.update([verdict, outcome])
        if everything or "wrong" in verdict + outcome:
            print(f"{folder.name}, frame {source.first_frame + k}: {verdict}, {outcome}", flush=True)
    names = (
        "sure right",
        "sure wrong",
        "unsure right",
        "unsure wrong",
        "none",
        "begun right",
        "begun wrong",
        "begun none",
    )
    cells = [str(told[name]) for name in names]
    return [
        folder.resolve().name,
        str(len(alone_ms)),
        *cells,
        f"{np.median(alone_ms):.0f}",
        f"{np.median(begun_ms):.0f}",
    ]


def prepared(scene: Scene) -> tuple[View, FrameSource, Mask]:
    """What the beginning of a scene's throw is looked for with. Raises ValueError where a person gives it."""
    kept: list[tuple[View, FrameSource, Mask]] = []

    def keep(view: View, source: FrameSource, unused: Mask, *_: Any) -> None:
        kept.append((view, source, unused))

    # Tracking prepares it, and gives up where no beginning is found.
    with patch.object(track_clip, "find_beginning", keep), suppress(RunError):
        track_scene(scene)
    if not kept:
        raise ValueError("the scene gives its first pose by hand: take [start] out")
    return kept[0]


def timed(call: Any, *arguments: Any) -> tuple[Any, float]:
    """What a call gives, and its processor time [ms]."""
    began = time.process_time()
    result = call(*arguments)
    return result, 1e3 * (time.process_time() - began)


class Judge:
    """Compares poses of one clip with the truth."""

    def __init__(self, view: View, source: FrameSource, truth: Truth) -> None:
        self.camera, self.edge_m, self.truth = view.camera, view.die.solid.edge_m, truth
        self.row = np.searchsorted(truth.frame, source.first_frame + np.arange(len(source)))
        self.turns = rotations_onto(truth.vertices_m, view.die.solid.vertices)

    def frames(self, count: int) -> list[int]:
        """Rows of the clip, spread evenly over those that show the whole die and have some frames after them."""
        whole = np.flatnonzero(self.truth.visible[self.row[:-LEAST_LEFT]])
        return [int(k) for k in np.unique(whole[np.linspace(0, len(whole) - 1, count).astype(int)])]

    def of(self, seen: ClipPoses, first: int) -> str:
        """Whether the first and the last of the known poses are right; row 0 of `seen` is row `first` of the clip."""
        known = np.flatnonzero(seen.known)
        right = all(self.right(seen.position_m[k], seen.rotation[k], int(first + k)) for k in known[[0, -1]])
        return "right" if right else "wrong"

    def right(self, position_m: Array, rotation: Array, k: int) -> bool:
        """Whether a pose is that of row k of the clip, but for the labelling of the die."""
        row = self.row[k]
        moved = self.camera.rotation @ (position_m - self.truth.position_m[row])
        turned = angles_rad(rotation @ np.array(self.turns), self.truth.rotation[row][None])
        across, along = float(np.hypot(*moved[:2])), abs(float(moved[2]))
        return bool(np.degrees(turned.min()) < WRONG_DEG and across < WRONG_M and along < self.edge_m)


if __name__ == "__main__":
    sys.exit(main())
