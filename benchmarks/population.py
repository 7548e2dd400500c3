"""Rates of success over random clips: `python benchmarks/population.py [--clips 100] [--seed 1 ...]`.

Each clip is drawn from stated ranges (`population_clips/draw.py`: shape, corner radius, gloss, paint, light, view, size in
the picture, frame rate, exposure, spin, response, noise, shutter, codec), rendered by rays, tracked and fitted as `diethrow
analyze` does, and compared with its truth. Clip k of a seed is the same everywhere. Clips and results stay in `--cache`, and
a repeated call continues: clips are rendered again after a change of the renderer, and analysed again after `--again`, or
where `--label` is new (a label names a state of the program, for comparison).

The table has a row for each kind of clip, with counts and, below 100 %, intervals of 95 % (Wilson):

  clips      of this kind; refused: no die was found, or the scene is not accepted, with a reason; crashed: any other error
  begun      first pose right: the first frame with a pose within 5 degrees and 1 mm across of the truth, up to a symmetry
  tracked    frames with a pose, of those that show the whole die
  wrong      frames off by more than 5 degrees, 1 mm across or 5 standard deviations (chi square of as small a probability),
             of those with a pose; gross: the first two alone
  unnamed    wrong frames that no message names
  bounces    found, of the lone ones in view; spurious: farther than 1.5 frames from any true one, of those found
  NEES       median over clips of each clip's median (5.35 where covariances are honest)
  rotation, lateral, depth   medians over clips of each clip's median [deg, mm, mm]
  chi        share of clips whose interval of the restitution holds the truth, of those that have one; rms error in standard
             errors (the interval's half width is two)

`--calibration drawn` hands the program scenes whose cameras, edge and frame rate are off, each by a draw of its own from what a
scene that says nothing counts as known; the truth is that of the exact ones. `benchmarks/honesty.py` sums both up.

`--corners found` leaves the corner radius out of the scenes, as a scene may, and prints how often it is found.

`--markdown` prints shorter tables, as the documentation has them, of the most common kinds.

`--worst N` saves pictures of the worst clips: six frames about the first pose that is wrong, or spread over the clip.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from accuracy import (
    LONE_FRAMES,
    MATCHED_FRAMES,
    Truth,
    body_turn,
    findable,
    frames_to_next_bounce,
    read_truth,
    rotations_onto,
    rows_of,
    turn_errors,
)
from numpy.typing import NDArray
from population_clips import RENDERER_VERSION, Draw, draw_clip, write_random_clip
from scipy.stats import binomtest, chi2

from diethrow.commands.clip.fit import run_fit
from diethrow.commands.clip.track import check_scene, track_scene
from diethrow.executors import Processes, cluster_at, cores, one_thread
from diethrow.files.provenance import Stopwatch
from diethrow.files.scene import Scene, SceneError, read_scene
from diethrow.fitting.results import Fit
from diethrow.model.die import make_die
from diethrow.model.rotations import angle_between, matrix_from_quat
from diethrow.runs import RunError, Tracking, silent
from diethrow.tracking.clip_parameters import CornerRounding
from diethrow.tracking.covariance import covariance_root
from diethrow.tracking.quality import QUALITIES
from diethrow.tracking.throw import CLOCK_SHARE, EDGE_SHARE, displaced, usual_covariance

Array = NDArray[np.float64]

WRONG_DEG, WRONG_M, WRONG_SIGMAS = 5.0, 1e-3, 5.0
WRONG_SQUARED = float(chi2.isf(chi2.sf(WRONG_SIGMAS**2, 1), 6))
"""Squared Mahalanobis distance of six components as improbable as 5 standard deviations of one: 43."""
ELLIPSOID = float(chi2.ppf(0.95, 6))
"""Squared Mahalanobis distance of six components within which 95 % lie."""
DRAWN_STREAM = 26
"""Of the random numbers of a clip's calibration."""
CALLS = 6
"""Calls, from the innermost, that the record of a crash names."""
MOST_APART = 1000.0
"""Frames to the next bounce that are recorded at the most: there may be none."""
FEWEST_CLIPS = 15
"""Fewest clips of a kind that has a row in the table of the documentation."""
DEFAULT_CACHE = Path.home() / ".cache" / "diethrow" / "population"


def main(arguments: Sequence[str] | None = None) -> int:
    """Render, analyse and compare what is missing; print the tables. The exit status is 1 if a clip crashed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=100, help="number of clips (%(default)s)")
    parser.add_argument("--first", type=int, default=0, help="number of the first clip (%(default)s)")
    parser.add_argument(
        "--seed", type=int, nargs="+", default=[1], help="of the clips; of several, all are counted (1)"
    )
    parser.add_argument("--cache", type=Path, default=DEFAULT_CACHE, help="folder of clips and results (%(default)s)")
    parser.add_argument("--label", default="main", help="name of the results, for comparison (%(default)s)")
    parser.add_argument("--quality", choices=list(QUALITIES), default="standard")
    parser.add_argument("--calibration", choices=["exact", "drawn"], default="exact")
    parser.add_argument("--corners", choices=["given", "found"], default="given")
    parser.add_argument("--again", action="store_true", help="analyse clips again that have results")
    parser.add_argument("--kind", action="append", default=[], help="only clips of this kind; may be repeated")
    parser.add_argument("--list", action="store_true", help="print a line for every clip")
    parser.add_argument("--markdown", action="store_true", help="print the table of the documentation")
    parser.add_argument("--worst", type=int, default=10, help="clips to save pictures of (%(default)s)")
    parser.add_argument("--workers", type=int, default=cores(), help="processes of this machine (%(default)s)")
    parser.add_argument("--scheduler", help="address of a Dask scheduler instead, whose workers see the cache")
    chosen = parser.parse_args(arguments)
    numbers = range(chosen.first, chosen.first + chosen.clips)
    with executor_of(chosen) as executor:
        wanted = [result for seed in chosen.seed for result in results_of(executor, seed, numbers, chosen)]
    if chosen.list:
        for result in wanted:
            print(line_of(result))
    if chosen.markdown:
        print_markdown(wanted)
    else:
        print_table(wanted)
    print_bounces(wanted)
    if chosen.corners == "found":
        print_radii(wanted)
    for result in sorted(wanted, key=badness, reverse=True)[: chosen.worst]:
        clips = clips_of(chosen.cache, result["seed"])
        save_picture(clips, result, clips / "results" / f"{chosen.label}_worst")
    return 1 if any(result["outcome"] == "crashed" for result in wanted) else 0


def clips_of(cache: Path, seed: int) -> Path:
    """The folder of the clips of a seed."""
    return cache / f"seed{seed}_v{RENDERER_VERSION}"


def results_of(executor: Executor, seed: int, numbers: range, chosen: argparse.Namespace) -> list[dict[str, Any]]:
    """The results of some clips of a seed: those that are known, and the others, analysed and added to the file."""
    results = results_path(chosen.cache, seed, chosen.label, chosen.quality, chosen.calibration, chosen.corners)
    results.parent.mkdir(parents=True, exist_ok=True)
    known = {} if chosen.again else read_results(results)
    how = (chosen.quality, tuple(chosen.kind), chosen.calibration, chosen.corners)
    missing = [k for k in numbers if k not in known]
    work = [executor.submit(clip_result, clips_of(chosen.cache, seed), seed, k, *how) for k in missing]
    for result in progress(work):
        known[result["clip"]] = result
        with results.open("a") as file:
            file.write(json.dumps(result) + "\n")
    return [known[k] | {"seed": seed} for k in numbers if k in known and known[k]["outcome"] != "skipped"]


@contextmanager
def executor_of(chosen: argparse.Namespace) -> Iterator[Executor]:
    """Local processes, or a cluster."""
    if chosen.scheduler:
        with cluster_at(chosen.scheduler) as executor:
            yield executor
    else:
        with Processes(chosen.workers) as processes:
            yield processes


def results_path(
    cache: Path, seed: int, label: str, quality: str, calibration: str = "exact", corners: str = "given"
) -> Path:
    """The file of results."""
    suffix = ("" if calibration == "exact" else f"_{calibration}") + ("" if corners == "given" else "_corners")
    return clips_of(cache, seed) / "results" / f"{label}_{quality}{suffix}.jsonl"


def read_results(path: Path) -> dict[int, dict[str, Any]]:
    """Results by number of the clip; of several, the last."""
    lines = path.read_text().splitlines() if path.exists() else []
    return {result["clip"]: result for result in map(json.loads, lines) if result["outcome"] != "skipped"}


def progress(work: Sequence[Future[dict[str, Any]]]) -> Iterator[dict[str, Any]]:
    """Results as they come, counted on stderr."""
    begin = time.monotonic()
    for done, future in enumerate(as_completed(work), 1):
        yield future.result()
        left = (time.monotonic() - begin) / done * (len(work) - done)
        print(f"\r{done} of {len(work)} clips, {left / 60:.0f} min left ", end="", file=sys.stderr, flush=True)
    if work:
        print(file=sys.stderr)


# --- one clip ---------------------------------------------------------------------------------------------------------


def clip_result(
    clips: Path,
    seed: int,
    number: int,
    quality: str,
    kinds: tuple[str, ...] = (),
    calibration: str = "exact",
    corners: str = "given",
) -> dict[str, Any]:
    """Render a clip where it is not there yet, analyse it, and compare: a record for the file of results."""
    draw = draw_clip(seed, number)
    result: dict[str, Any] = {"clip": number, "kinds": draw.kinds, "outcome": "skipped"}
    if kinds and not set(kinds) & set(draw.kinds):
        return result
    folder = rendered_clip(clips, draw, number)
    began = time.perf_counter()
    try:
        exact = scene = read_scene(folder / "scene.toml").known_exactly()
        if calibration == "drawn":
            scene = with_drawn_calibration(exact, np.random.default_rng([seed, number, DRAWN_STREAM]))
        if corners == "found":
            scene = replace(scene, die=replace(scene.die, corner_radius_m=0.0), rounding=CornerRounding.TESTED)
        with one_thread():
            check_scene(scene)
            tracking = track_scene(scene, silent, Stopwatch(), QUALITIES[quality])
            fit = run_fit(tracking.unbiased, tracking.measured, tracking.die, silent, Stopwatch())
        result |= {"outcome": "analysed"} | compared(exact, read_truth(folder), tracking, fit, draw.law.chi)
        result |= {"radius": radius_of(exact, tracking)} if corners == "found" else {}
    except (RunError, SceneError) as error:
        result |= {"outcome": "refused", "reason": str(error)}
    except Exception as error:  # a crash on one clip is a result of the benchmark
        calls = [f"{Path(call.filename).name}:{call.lineno}" for call in traceback.extract_tb(error.__traceback__)]
        result |= {"outcome": "crashed", "reason": f"{type(error).__name__}: {error} ({' > '.join(calls[-CALLS:])})"}
    return result | {"seconds": round(time.perf_counter() - began, 2)}


def with_drawn_calibration(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with camera, edge and frame rate off by a draw from what a scene that says nothing counts as known, which it then
    states."""
    views = []
    for view in scene.cameras:
        usual = usual_covariance(view.camera)
        change = covariance_root(usual) @ rng.standard_normal(len(usual))
        views.append(replace(view, camera=displaced(view.camera, change), calibration=usual))
    die, larger = scene.die, 1.0 + EDGE_SHARE * float(rng.standard_normal())
    die = make_die(
        die.solid.name,
        die.solid.edge_m * larger,
        die.mass_kg,
        inertia_kg_m2=None if die.is_homogeneous else die.inertia_kg_m2,
        corner_radius_m=die.corner_radius_m * larger,
        marks=die.marks,
    )
    fps = scene.clip.fps
    clip = replace(scene.clip, fps=fps and fps * (1.0 + CLOCK_SHARE * float(rng.standard_normal())), fps_sigma=None)
    return replace(scene, cameras=tuple(views), die=die, clip=clip, edge_sigma_m=None)


def rendered_clip(clips: Path, draw: Draw, number: int) -> Path:
    """The folder of a clip, which is rendered where it is not there yet."""
    folder = clips / f"{number:04d}"
    if not folder.exists():
        clips.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=clips) as scratch:
            whole = Path(scratch) / "clip"
            whole.mkdir()
            write_random_clip(draw, whole)
            with suppress(OSError):  # where another process has rendered the same clip meanwhile
                whole.rename(folder)
    return folder


def compared(scene: Scene, truth: Truth, tracking: Tracking, fit: Fit, chi: float) -> dict[str, Any]:
    """Numbers of one analysis against its truth."""
    found = track_compared(scene, truth, tracking, [*tracking.notices, *fit.messages])
    return found | {"chi": chi_of(fit, chi)} if "nees" in found else found


def track_compared(scene: Scene, truth: Truth, tracking: Tracking, messages: Sequence[str]) -> dict[str, Any]:
    """Numbers of one track against its truth; `messages` name the frames that are known to be doubtful."""
    track = tracking.smoothed
    row = rows_of(track, truth)
    visible = truth.visible[row]
    both = visible & track.tracked
    found = {"visible": int(visible.sum()), "tracked": int(both.sum()), "messages": [*messages]}
    if not both.any():
        return found | {"begun": False, "wrong": 0, "gross": 0, "unnamed": 0} | bounces_of(tracking, truth)
    turn = body_turn(track, truth, row, scene)
    moved = truth.position_m[row] - track.position_m
    turned = np.full((len(row), 3), np.nan)
    turned[both] = turn_errors(matrix_from_quat(track.quaternion[both]) @ turn, truth.rotation[row[both]])
    in_camera = moved @ scene.views()[0].camera.rotation.T
    across, along = np.linalg.norm(in_camera[:, :2], axis=1), np.abs(in_camera[:, 2])
    angle = np.degrees(np.linalg.norm(turned, axis=1))
    nees = np.full(len(row), np.nan)
    nees[both] = squared_distances(np.concatenate([moved[both], turned[both]], 1), track.covariance[both])
    gross = both & ((angle > WRONG_DEG) | (across > WRONG_M))
    wrong = gross | (both & (nees > WRONG_SQUARED))
    first = int(np.flatnonzero(both)[0])
    return (
        found
        | {
            "begun": bool(angle_up_to_symmetry(track.quaternion[first], truth, row[first], scene) < WRONG_DEG)
            and bool(across[first] < WRONG_M),
            "wrong": int(wrong.sum()),
            "gross": int(gross.sum()),
            "unnamed": int(sum(not named(int(frame), messages) for frame in track.frame[wrong])),
            "first_wrong": int(track.frame[gross][0]) if gross.any() else None,
            "rotation": quantiles(angle[both]),
            "lateral": quantiles(1e3 * across[both]),
            "depth": quantiles(1e3 * along[both]),
            "nees": float(np.median(nees[both])),
            "nees_mean": float(np.mean(nees[both])),
            "within": float(np.mean(nees[both] < ELLIPSOID)),
        }
        | bounces_of(tracking, truth)
    )


def squared_distances(errors: Array, covariances: Array) -> Array:
    """(n,) squared Mahalanobis lengths of errors (n, 6) with covariances (n, 6, 6)."""
    return np.asarray(np.einsum("ki,ki->k", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]))


def angle_up_to_symmetry(quaternion: Array, truth: Truth, row: int, scene: Scene) -> float:
    """[deg] between a pose and the truth, with the symmetry rotation that fits best."""
    turns = rotations_onto(truth.vertices_m, scene.die.solid.vertices)
    found = matrix_from_quat(quaternion)
    return float(min(np.degrees(angle_between(found @ turn, truth.rotation[row])) for turn in turns))


def quantiles(values: Array) -> list[float]:
    """Median and 95th percentile."""
    return [float(np.median(values)), float(np.percentile(values, 95))]


def named(frame: int, messages: Sequence[str]) -> bool:
    """Whether a message names the frame, or frames around it."""
    for message in messages:
        for low, high in re.findall(r"frames? (\d+)(?: (?:to|and) (\d+))?", message):
            if int(low) <= frame <= int(high or low):
                return True
    return False


def bounces_of(tracking: Tracking, truth: Truth) -> dict[str, Any]:
    """Lone bounces in view, those found, and spurious ones; frames from each to the next bounce, and whether it was found."""
    frame_s = float(np.median(np.diff(truth.time_s)))
    times = np.array([impact.time_s for impact in tracking.measured.impacts])
    gaps = np.abs(times[:, None] - truth.bounce_s) / frame_s
    wanted = np.flatnonzero(findable(truth, frame_s))
    found = [k for k in wanted if gaps[:, k].min(initial=np.inf) < MATCHED_FRAMES]
    apart = np.minimum(frames_to_next_bounce(truth, frame_s), MOST_APART)
    return {
        "lone": len(wanted),
        "found": len(found),
        "apart": [(float(apart[k]), k in found) for k in wanted],
        "spurious": int((gaps.min(1, initial=np.inf) > MATCHED_FRAMES).sum()),
        "late": [float(gaps[:, k].min()) for k in found],
    }


def print_bounces(results: Sequence[dict[str, Any]]) -> None:
    """How many of the lone bounces are found, by the frames to the next bounce."""
    bounces = [bounce for result in results for bounce in result.get("apart", [])]
    print("\nframes to the next bounce  lone bounces  found")
    for low, high in pairwise((LONE_FRAMES, 4.0, 8.0, 16.0, np.inf)):
        found = [was_found for apart, was_found in bounces if low < apart <= high]
        name = f"{low:g} to {high:g}" if high < np.inf else f"over {low:g}"
        print(f"{name:25s}  {len(found):12d}  {share(sum(found), len(found))}".rstrip())


def radius_of(scene: Scene, tracking: Tracking) -> dict[str, float]:
    """The corner radius of the scene and the one found, with its standard error [mm], and the scale [px/mm] at the middle pose; a
    die that was taken for sharp has found 0 and the standard error 0."""
    found, camera = tracking.corners, scene.views()[0].camera
    position_m = np.nanmedian(tracking.smoothed.position_m, axis=0)
    scale = 1e-3 * camera.matrix[0, 0] / float(np.linalg.norm(position_m - camera.centre_m))
    return {
        "true": 1e3 * scene.die.corner_radius_m,
        "found": 1e3 * found.radius_m if found is not None else 0.0,
        "sigma": 1e3 * found.sigma_m if found is not None else 0.0,
        "px_per_mm": float(scale),
    }


def chi_of(fit: Fit, true: float) -> dict[str, Any]:
    """Error of the restitution, whether its interval holds the truth, and the error in standard errors."""
    chi = fit.parameters["chi"]
    if chi.value is None:
        return {"error": None, "holds": None, "sigmas": None}
    if chi.low is None or chi.high is None:
        return {"error": chi.value - true, "holds": None, "sigmas": None}
    sigma = (chi.high - chi.low) / 4.0
    error = chi.value - true
    return {
        "error": error,
        "holds": bool(chi.low <= true <= chi.high),
        "sigmas": error / sigma if sigma > 0 else None,
    }


# --- tables -----------------------------------------------------------------------------------------------------------


def print_table(results: Sequence[dict[str, Any]]) -> None:
    """A row for all clips and one for each kind."""
    kinds = sorted({kind for result in results for kind in result["kinds"]})
    heads = ["kind", "clips", "refused", "crashed", "begun", "tracked", "wrong", "gross", "unnamed", "bounces"]
    heads += ["spurious", "NEES", "rotation", "lateral", "depth", "chi holds", "chi rms"]
    rows = [row_of("all", results)]
    rows += [row_of(kind, [result for result in results if kind in result["kinds"]]) for kind in kinds]
    widths = [max(len(row[k]) for row in (heads, *rows)) for k in range(len(heads))]
    for row in (heads, *rows):
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    reasons = [
        f"  seed {r['seed']} clip {r['clip']}: {r['reason']}" for r in results if r["outcome"] in ("refused", "crashed")
    ]
    if reasons:
        print("\nrefused or crashed:", *reasons, sep="\n")


def print_markdown(results: Sequence[dict[str, Any]]) -> None:
    """The tables of the documentation: without intervals, of the kinds with FEWEST_CLIPS or more."""
    kinds = {kind: [r for r in results if kind in r["kinds"]] for result in results for kind in result["kinds"]}
    common = [("all", list(results)), *sorted(kinds.items(), key=lambda item: -len(item[1]))]
    rows = [(kind, *markdown_cells(some)) for kind, some in common if len(some) >= FEWEST_CLIPS]
    found = ("kind", "clips", "begun", "tracked", "off", "or 5 σ", "named", "bounces")
    errors = ("kind", "NEES", "rotation °", "depth mm", "χ held")
    for heads, columns in ((found, range(8)), (errors, (0, *range(8, 12)))):
        print(f"\n| {' | '.join(heads)} |\n|{' --- |' * len(heads)}")
        for row in rows:
            print(f"| {' | '.join(row[column] for column in columns)} |")


def markdown_cells(results: Sequence[dict[str, Any]]) -> tuple[str, ...]:
    """The cells of one kind, behind its name."""
    good = [result for result in results if result["outcome"] == "analysed"]
    posed = [result for result in good if "nees" in result]
    sums = {
        name: sum(int(result[name]) for result in good)
        for name in ("begun", "visible", "tracked", "gross", "wrong", "unnamed", "lone", "found", "spurious")
    }
    held = [result["chi"]["holds"] for result in posed if result["chi"]["holds"] is not None]

    def percent(count: int, total: int) -> str:
        # A space that does not break keeps a row on one line.
        return f"{100 * count / total:.1f}\u00a0%" if total else ""

    return (
        str(len(results)),
        f"{sums['begun']}/{len(good)}",
        percent(sums["tracked"], sums["visible"]),
        percent(sums["gross"], sums["tracked"]),
        percent(sums["wrong"], sums["tracked"]),
        f"{sums['wrong'] - sums['unnamed']}/{sums['wrong']}",
        f"{sums['found']}/{sums['lone']}\u00a0+{sums['spurious']}",
        f"{np.median([result['nees'] for result in posed]):.1f}",
        f"{np.median([result['rotation'][0] for result in posed]):.2f}",
        f"{np.median([result['depth'][0] for result in posed]):.2f}",
        f"{sum(held)}/{len(held)}",
    )


def print_radii(results: Sequence[dict[str, Any]]) -> None:
    """How often a corner radius that scenes leave out is found, by its size in the picture."""
    radii = [result["radius"] for result in results if "radius" in result]
    print("\nradius left out  clips  found  within 2 sigma  found/true, median (quartiles)")
    for low, high in ((0.0, 0.0), (0.0, 1.3), (1.3, 2.5), (2.5, np.inf)):
        some = [r for r in radii if low < r["true"] * r["px_per_mm"] <= high or low == high == r["true"]]
        found = [r for r in some if r["found"] > 0.0]
        held = sum(abs(r["found"] - r["true"]) < 2.0 * r["sigma"] for r in found)
        ratios = [r["found"] / r["true"] for r in found if r["true"] > 0.0]
        quartiles = "{1:.2f} ({0:.2f} to {2:.2f})".format(*np.percentile(ratios, [25, 50, 75])) if ratios else ""
        name = "none" if low == high else f"{low:g} to {high:g} px" if high < np.inf else f"over {low:g} px"
        print(f"{name:15s}  {len(some):5d}  {len(found):5d}  {held:14d}  {quartiles}".rstrip())


def row_of(kind: str, results: Sequence[dict[str, Any]]) -> list[str]:
    """The cells of one kind."""
    good = [result for result in results if result["outcome"] == "analysed"]

    def total(name: str) -> int:
        return sum(int(result[name]) for result in good)

    def middle(value: Callable[[dict[str, Any]], float | None], digits: int) -> str:
        values = [v for result in good if (v := value(result)) is not None]
        return f"{np.median(values):.{digits}f}" if values else ""

    posed = [result for result in good if "nees" in result]
    chis = [result["chi"] for result in posed if result["chi"]["holds"] is not None]
    sigmas = [chi["sigmas"] for chi in chis if chi["sigmas"] is not None]
    return [
        kind,
        str(len(results)),
        str(sum(result["outcome"] == "refused" for result in results)),
        str(sum(result["outcome"] == "crashed" for result in results)),
        share(total("begun"), len(good)),
        share(total("tracked"), total("visible")),
        share(total("wrong"), total("tracked")),
        share(total("gross"), total("tracked")),
        str(total("unnamed")),
        share(total("found"), total("lone")),
        share(total("spurious"), total("found") + total("spurious")),
        middle(lambda result: result.get("nees"), 1),
        middle(lambda result: result["rotation"][0] if "rotation" in result else None, 3),
        middle(lambda result: result["lateral"][0] if "lateral" in result else None, 4),
        middle(lambda result: result["depth"][0] if "depth" in result else None, 3),
        share(sum(bool(chi["holds"]) for chi in chis), len(chis)),
        f"{np.sqrt(np.mean(np.square(sigmas))):.1f}" if sigmas else "",
    ]


def share(count: int, total: int) -> str:
    """A percentage with its interval."""
    if total == 0:
        return ""
    low, high = binomtest(count, total).proportion_ci(0.95, "wilson")
    return f"{100 * count / total:.1f} ({100 * low:.1f} to {100 * high:.1f})"


def line_of(result: dict[str, Any]) -> str:
    """One clip on one line."""
    head = f"{result['clip']:4d} {result['outcome']:8s} {result['seconds']:6.1f} s  "
    if result["outcome"] != "analysed":
        return head + result["reason"][:120] + "  " + ", ".join(result["kinds"])
    numbers = (
        f"tracked {result['tracked']}/{result['visible']} wrong {result['wrong']} gross {result['gross']} "
        f"bounces {result['found']}/{result['lone']}+{result['spurious']}"
    )
    if "nees" in result:
        numbers += f" NEES {result['nees']:.1f} {result['rotation'][0]:.3f} deg {result['depth'][0]:.3f} mm"
    return f"{head}{'' if result['begun'] else 'BEGUN WRONG '}{numbers}  {', '.join(result['kinds'])}"


def badness(result: dict[str, Any]) -> float:
    """What puts a clip among the worst: failures first, then wrong or lost frames and bounces."""
    if result["outcome"] != "analysed":
        return {"crashed": 1e6, "refused": 1e5}[result["outcome"]]
    lost = (result["visible"] - result["tracked"]) / max(result["visible"], 1)
    wrong = result["wrong"] / max(result["tracked"], 1)
    return float(
        10.0 * (not result["begun"]) + 5.0 * wrong + 5.0 * lost + result["lone"] - result["found"] + result["spurious"]
    )


def save_picture(clips: Path, result: dict[str, Any], folder: Path) -> None:
    """Six frames of a clip side by side, at the worst of it: the frames around the first wrong pose, or spread evenly."""
    import cv2

    from diethrow.commands.clip.footage import open_footage

    folder.mkdir(parents=True, exist_ok=True)
    try:
        scene = read_scene(clips / f"{result['clip']:04d}" / "scene.toml")
    except SceneError:
        return
    clip = open_footage(scene, scene.views()[0])
    count = len(clip)
    first = result.get("first_wrong")
    shown = np.linspace(0, count - 1, 6).astype(int) if first is None else np.arange(first - 3, first + 3)
    pictures = {k: frame for k, frame in enumerate(clip.frames()) if k in set(np.clip(shown, 0, count - 1).tolist())}
    row = np.hstack([pictures[k] for k in sorted(pictures)])
    cv2.imwrite(str(folder / f"{result['clip']:04d}.png"), row)


if __name__ == "__main__":
    sys.exit(main())
