"""Errors of an analysis against the truth: `python benchmarks/accuracy.py [CLIP_FOLDER...] [--truth FOLDER]`.

A clip folder holds `scene.toml` and what it names. Its truth lies in the same folder, in `--truth`, or in `tests/data/`
under the clip's name: `truth.csv` (the true pose on every frame), `bounces.csv`, `vertices.csv` (the true body frame)
and `truth.toml` (χ). Without an argument: the sample `data_samples/cube_wood`. Each clip is analysed from the film to
the report; the first one of a fresh installation includes compilation. The exit status is 1 if a clip failed.

A die without marks has no preferred labelling of its corners, so one symmetry rotation, the same for all frames of a
clip, is chosen to bring the tracked body frame onto the true one; a labelling that changes within the clip is an error.

The rows of the table:
  tracked       share of the frames with a pose, among those that show the whole die
  rotation      geodesic angle [deg], median and 95th percentile
  lateral       error of the centre across the line of sight [mm], median and 95th percentile
  depth         along it
  wrong         frames off by more than 5 degrees or 1 mm across
  claimed       frames with a pose although no part of the die is in the picture
  NEES          normalised estimation error squared, median; 5.35 for consistent 6 × 6 covariances
  bounces       found, of those that can be found: in view, and with no other bounce within two frames
  spurious      bounces farther than 1.5 frames from any true one
  bounce time   error [frames], median and largest
  vertex        bounces found that name the right corner
  chi           fitted minus true, its interval, and whether the truth lies in it
  seconds       the whole analysis; of it, following the die
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diethrow.commands.clip.analyze import analyze
from diethrow.files.analysis_folder import AnalysedThrow
from diethrow.files.scene import Scene, read_scene
from diethrow.model.rotations import angle_between, matrix_from_quat, quat_from_matrix, rotvec_from_quat
from diethrow.model.throw.motion import Impact
from diethrow.tracking.track import Track

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "data_samples" / "cube_wood"
WRONG_DEG, WRONG_M = 5.0, 1e-3
OTHER_LABEL_DEG = 10.0
"""Angle from which a pose counts as one of another labelling: tracked poses are within a degree."""
MATCHED_FRAMES = 1.5
"""A bounce belongs to a true one that is no farther away than this."""
SEVERAL = -1.0
"""In the place of several corners that touch at one instant: no single corner is the right one."""
LONE_FRAMES, MARGIN_FRAMES = 2.0, 3
"""Bounces nearer than the first count as one contact, which nobody can take apart; nearer to an end of the film than the
second, one of their flights is too short to be seen."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What really happened."""

    frame: NDArray[np.int64]
    time_s: Array
    position_m: Array
    rotation: Array
    """(n, 3, 3) body to world."""
    visible: Flags
    """(n,) the whole die is in the picture."""
    in_view: Flags
    """(n,) some of it is."""
    bounce_s: Array
    bounce_vertex: NDArray[np.int64]
    """Indices of `vertices_m`."""
    vertices_m: Array
    chi: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Analyse the clips, print the table, and return the exit status."""
    parser = argparse.ArgumentParser(description="Analyse clips whose truth is known, and print how near it they come.")
    parser.add_argument("clips", nargs="*", type=Path, default=[SAMPLE], metavar="CLIP_FOLDER")
    parser.add_argument("--truth", type=Path, help="the folder of the truth, if it is not the clip's own")
    chosen = parser.parse_args(arguments)
    columns: dict[str, dict[str, str]] = {}
    failures = 0
    for folder in chosen.clips:
        try:
            columns[folder.resolve().name] = measured_column(folder, chosen.truth or truth_folder(folder))
        except (ValueError, OSError) as error:
            failures += 1
            print(f"{folder}: {error}", file=sys.stderr)
    print_table(columns)
    return 1 if failures else 0


def truth_folder(clip: Path) -> Path:
    """Where the truth of a clip lies. Raises FileNotFoundError where it has none."""
    beside = (clip, ROOT / "tests" / "data" / clip.resolve().name)
    found = next((folder for folder in beside if (folder / "truth.csv").exists()), None)
    if found is None:
        raise FileNotFoundError("no truth.csv in the clip's folder; name its folder with --truth")
    return found


def measured_column(clip: Path, truth_at: Path) -> dict[str, str]:
    """Analyse one clip and compare: a name and a text for each row of the table."""
    scene, truth = read_scene(clip / "scene.toml"), read_truth(truth_at)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        result = analyze(scene, Path(scratch) / "out")
    seconds = time.perf_counter() - began
    true_row = rows_of(result.track, truth)
    turn = body_turn(result.track, truth, true_row, scene)
    return {
        **pose_rows(result.track, truth, true_row, turn, scene),
        **bounce_rows(result.throw.impacts, truth, truth_corners(turn, scene, truth)),
        "chi": chi_text(result, truth.chi),
        "seconds": f"{seconds:.1f}, of it {result.seconds['track']:.1f}",
    }


# --- the truth --------------------------------------------------------------------------------------------------------


def read_truth(folder: Path) -> Truth:
    """The truth of a clip. Raises FileNotFoundError, and ValueError for a column that is not there."""
    poses, bounces, corners = (read_columns(folder / f"{name}.csv") for name in ("truth", "bounces", "vertices"))
    with (folder / "truth.toml").open("rb") as file:
        chi = float(tomllib.load(file)["truth"]["chi"])
    try:
        return Truth(
            frame=poses["frame"].astype(np.int64),
            time_s=poses["t"],
            position_m=np.stack([poses[name] for name in "xyz"], 1),
            rotation=matrix_from_quat(np.stack([poses[name] for name in ("qw", "qx", "qy", "qz")], 1)),
            visible=poses["fully_visible"] == 1,
            in_view=poses["in_view"] == 1,
            bounce_s=bounces.get("t", np.zeros(0)),
            bounce_vertex=bounces.get("vertex", np.zeros(0)).astype(np.int64),
            vertices_m=np.stack([corners[name] for name in "xyz"], 1),
            chi=chi,
        )
    except KeyError as error:
        raise ValueError(f"{folder}: the truth has no column {error}") from error


def read_columns(path: Path) -> dict[str, Array]:
    """The columns of a CSV file of numbers; none where it has no rows. Several numbers in a cell, as of corners that touch at one
    instant, are SEVERAL."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {
        name: np.array([SEVERAL if " " in row[name] else float(row[name]) for row in rows])
        for name in (rows[0] if rows else ())
    }


# --- the poses --------------------------------------------------------------------------------------------------------


def rows_of(track: Track, truth: Truth) -> NDArray[np.int64]:
    """(n,) row of the truth of every frame of a track. Raises ValueError for a frame that it does not hold."""
    row = np.minimum(np.searchsorted(truth.frame, track.frame), len(truth.frame) - 1)
    if (truth.frame[row] != track.frame).any():
        raise ValueError(f"the truth has frames {truth.frame[0]} to {truth.frame[-1]}, and the track others besides")
    return row


def body_turn(track: Track, truth: Truth, true_row: NDArray[np.int64], scene: Scene) -> Array:
    """(3, 3) from the true body frame to the tracked one: of all that map the corners onto each other, the one that
    leaves the smallest mean angle, each counted up to OTHER_LABEL_DEG: where a clip shows several labellings, that of most
    frames, and of a few frames the one that fits them best."""
    both = track.tracked & truth.visible[true_row]
    if not both.any():
        raise ValueError("no frame that shows the whole die has a pose")
    found, true = matrix_from_quat(track.quaternion[both]), truth.rotation[true_row[both]]
    turns = rotations_onto(truth.vertices_m, scene.die.solid.vertices)
    limit = np.radians(OTHER_LABEL_DEG)
    return min(turns, key=lambda turn: float(np.minimum(angle_between(found @ turn, true), limit).mean()))


def rotations_onto(corners: Array, others: Array) -> list[Array]:
    """All rotations (3, 3) that carry one set of corners (n, 3) onto another."""
    size = float(np.linalg.norm(corners, axis=1).max())
    second = int(np.argmax(np.linalg.norm(np.cross(corners[0], corners), axis=1)))
    own = pair_axes(corners[0], corners[second])
    turns = []
    for p in others:
        for q in others:
            if abs(p @ q - corners[0] @ corners[second]) > 1e-3 * size**2:
                continue
            turn = pair_axes(p, q) @ own.T
            if np.linalg.norm((corners @ turn.T)[:, None] - others, axis=2).min(1).max() < 1e-3 * size:
                turns.append(turn)
    if not turns:
        raise ValueError("the true corners are not those of the scene's die: compare vertices.csv with [die]")
    return turns


def pair_axes(u: Array, v: Array) -> Array:
    """Right-handed axes (3, 3), in columns: along u, and across it in the plane of u and v."""
    x, z = u / np.linalg.norm(u), np.cross(u, v)
    z = z / np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])


def turn_errors(found: Array, true: Array) -> Array:
    """(n, 3) rotation vectors [rad] in world axes from the found to the true rotations."""
    return np.asarray(rotvec_from_quat(quat_from_matrix(true @ np.swapaxes(found, 1, 2))))


def pose_rows(track: Track, truth: Truth, true_row: NDArray[np.int64], turn: Array, scene: Scene) -> dict[str, str]:
    """The rows that compare frame by frame."""
    visible = truth.visible[true_row]
    both = visible & track.tracked
    rows = true_row[both]
    moved = truth.position_m[rows] - track.position_m[both]
    turned = turn_errors(matrix_from_quat(track.quaternion[both]) @ turn, truth.rotation[rows])
    in_camera = moved @ scene.views()[0].camera.rotation.T
    across, along = np.linalg.norm(in_camera[:, :2], axis=1), np.abs(in_camera[:, 2])
    angle_deg = np.degrees(np.linalg.norm(turned, axis=1))
    errors = np.concatenate([moved, turned], 1)
    nees = np.einsum("ki,ki->k", errors, np.linalg.solve(track.covariance[both], errors[..., None])[..., 0])
    return {
        "tracked": f"{100 * both.sum() / visible.sum():.1f} % of {visible.sum()}",
        "rotation": f"{spread(angle_deg, 3)} deg",
        "lateral": f"{spread(1e3 * across, 4)} mm",
        "depth": f"{spread(1e3 * along, 3)} mm",
        "wrong": str(int(((angle_deg > WRONG_DEG) | (across > WRONG_M)).sum())),
        "claimed": str(int((track.tracked & ~truth.in_view[true_row]).sum())),
        "NEES": f"{np.median(nees):.2f}",
    }


def spread(values: Array, digits: int) -> str:
    """Median and 95th percentile."""
    return f"{np.median(values):.{digits}f} / {np.percentile(values, 95):.{digits}f}"


# --- the bounces and the model ----------------------------------------------------------------------------------------


def truth_corners(turn: Array, scene: Scene, truth: Truth) -> NDArray[np.int64]:
    """(n,) index, in the true body frame, of every corner of the tracked one."""
    ours = scene.die.solid.vertices @ turn
    return np.asarray(np.linalg.norm(ours[:, None] - truth.vertices_m, axis=2).argmin(1))


def bounce_rows(impacts: Sequence[Impact], truth: Truth, true_corner: NDArray[np.int64]) -> dict[str, str]:
    """The rows that compare bounce by bounce."""
    frame_s = float(np.median(np.diff(truth.time_s)))
    gaps = np.array([[abs(impact.time_s - t) / frame_s for t in truth.bounce_s] for impact in impacts])
    gaps = gaps.reshape(len(impacts), len(truth.bounce_s))
    wanted = np.flatnonzero(findable(truth, frame_s))
    late, right = [], 0
    for k in wanted:
        nearest = int(gaps[:, k].argmin()) if len(impacts) else -1
        if nearest < 0 or gaps[nearest, k] > MATCHED_FRAMES:
            continue
        late.append(gaps[nearest, k])
        right += [int(true_corner[v]) for v in impacts[nearest].vertices] == [int(truth.bounce_vertex[k])]
    spurious = int((gaps.min(1, initial=np.inf) > MATCHED_FRAMES).sum())
    return {
        "bounces": f"{len(late)} of {len(wanted)}",
        "spurious": str(spurious),
        "bounce time": f"{np.median(late):.3f} / {max(late):.3f} frames" if late else "none",
        "vertex": f"{right} of {len(late)}",
    }


def findable(truth: Truth, frame_s: float) -> Flags:
    """(bounces,) in view, without another bounce nearby, and with a visible flight before and after."""
    flags = np.zeros(len(truth.bounce_s), bool)
    for k, t in enumerate(truth.bounce_s):
        row = int(np.abs(truth.time_s - t).argmin())
        inside = MARGIN_FRAMES <= row < len(truth.frame) - MARGIN_FRAMES
        flags[k] = inside and truth.visible[row]
    return flags & (frames_to_next_bounce(truth, frame_s) > LONE_FRAMES)


def frames_to_next_bounce(truth: Truth, frame_s: float) -> Array:
    """(bounces,) frames from each bounce to the nearest other one, before or after it; infinite for an only one."""
    others = [np.delete(truth.bounce_s, k) for k in range(len(truth.bounce_s))]
    return np.array([np.abs(o - t).min(initial=np.inf) for o, t in zip(others, truth.bounce_s, strict=True)]) / frame_s


def chi_text(result: AnalysedThrow, true: float) -> str:
    """The error of the restitution, its interval, and whether that holds the truth."""
    chi = result.result.parameters["chi"]
    if chi.value is None:
        return "not determined"
    if chi.low is None or chi.high is None:
        return f"{chi.value - true:+.5f}, no interval"
    holds = "holds" if chi.low <= true <= chi.high else "misses"
    return f"{chi.value - true:+.5f}, {chi.low:.5f}..{chi.high:.5f} {holds}"


def print_table(columns: dict[str, dict[str, str]]) -> None:
    """One row a quantity, one column a clip."""
    if not columns:
        return
    rows = [["", *columns], *([name, *(c[name] for c in columns.values())] for name in next(iter(columns.values())))]
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


if __name__ == "__main__":
    sys.exit(main())
