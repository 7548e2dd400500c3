"""The tracker on every preset of `film`: `python benchmarks/presets.py [--preset NAME[+NAME...]] [--variant llvm_ad_mono]`.

One throw is filmed with each preset (`film --list-presets`), and once without any; `+` joins presets into one film. Each film is
checked as `diethrow check` does, tracked as `diethrow track` does, and compared with its truth. Films and results stay in
`--cache`, and a repeated call continues: films are rendered again after a change of PLAN, FILM_VERSION or the samples, and
tracked again after `--again`, or where `--label` is new (a label names a state of the program, for comparison).

  size       edge of the die in the picture [px], at the first impact
  tracked    frames with a pose, of those that show the whole die
  wrong      of those with a pose, frames off by more than 5 degrees, 1 mm across or 5 standard deviations (chi square of as
             small a probability); gross: the first two alone
  unnamed    wrong frames that no message names
  bounces    found, of the lone ones in view; + spurious ones, farther than 1.5 frames from any true one
  NEES       median over frames (5.35 where covariances are honest)
  rotation, lateral, depth   medians over frames [deg, mm, mm]
  check      its worst verdict, and the findings that are not good
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from accuracy import Truth, read_truth
from population import progress, track_compared

from diethrow.commands.clip.check import check_clip
from diethrow.commands.clip.track import check_scene, track_scene
from diethrow.commands.model.film_presets import PRESETS
from diethrow.commands.model.film_settings import film_settings
from diethrow.commands.model.filmed_throw import film
from diethrow.executors import Processes, cores, one_thread
from diethrow.files.plan import read_plan
from diethrow.files.provenance import Stopwatch
from diethrow.files.scene import Scene, SceneError, read_scene
from diethrow.runs import RunError, silent
from diethrow.tracking.check import Verdict
from diethrow.tracking.quality import QUALITIES

FILM_VERSION = 1
"""Part of the name of a cached film; counts the changes of its pictures."""
DEFAULT_CACHE = Path.home() / ".cache" / "diethrow" / "presets"
PLAIN = "plain"
FPS = 500.0
FILMED_S = 0.132
"""Length of the films: 67 frames at FPS, 33 at the rate of a phone; three bounces, the last one 8 frames before the end."""
SIZE_PX = 384
PLAN = f"""\
[table]
surface = "wood"
[die]
shape = "cube"
edge_m = 0.016
mass_kg = 0.0048
marks = "pips"
[law]
chi = 0.55
mu = 0.2
[initial]
position_m = [0.0, 0.0, 0.045]
euler_rad = [0.08, -0.86, -0.31]
velocity_m_s = [0.1, 0.05, -0.5]
omega_rad_s = [3.0, 24.0, 14.0]
[until]
time_s = {FILMED_S + 0.02}
[output]
fps = {FPS}
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Film, track and compare what is missing; print the table. The exit status is 1 if a clip crashed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", action="append", help="only these; may be repeated, `a+b` combines (all)")
    parser.add_argument("--cache", type=Path, default=DEFAULT_CACHE, help="folder of films and results (%(default)s)")
    parser.add_argument("--label", default="main", help="name of the results, for comparison (%(default)s)")
    parser.add_argument("--quality", choices=list(QUALITIES), default="standard")
    parser.add_argument("--again", action="store_true", help="track films again that have results")
    parser.add_argument("--samples", type=int, default=32, help="light paths per pixel (%(default)s)")
    parser.add_argument("--variant", default="scalar_rgb", help="variant of Mitsuba (%(default)s)")
    parser.add_argument("--workers", type=int, default=cores(), help="processes (%(default)s)")
    parser.add_argument("--show", type=Path, metavar="PNG", help="also save six frames of every film")
    chosen = parser.parse_args(arguments)
    names = chosen.preset or [PLAIN, *(preset.name for preset in PRESETS)]
    films = chosen.cache / f"v{FILM_VERSION}_{chosen.samples}"
    results = films / "results" / f"{chosen.label}_{chosen.quality}.jsonl"
    results.parent.mkdir(parents=True, exist_ok=True)
    known = {} if chosen.again else read_results(results)
    with Processes(chosen.workers) as processes:
        missing = [name for name in names if name not in known]
        work = [
            processes.submit(clip_result, films, name, chosen.samples, chosen.variant, chosen.quality)
            for name in missing
        ]
        for result in progress(work):
            known[result["preset"]] = result
            with results.open("a") as file:
                file.write(json.dumps(result) + "\n")
    wanted = [known[name] for name in names]
    print_table(wanted)
    if chosen.show:
        save_pictures(films, names, chosen.show)
    return 1 if any(result["outcome"] == "crashed" for result in wanted) else 0


def read_results(path: Path) -> dict[str, dict[str, Any]]:
    """Results by preset; of several, the last."""
    lines = path.read_text().splitlines() if path.exists() else []
    return {result["preset"]: result for result in map(json.loads, lines)}


def clip_result(films: Path, name: str, samples: int, variant: str, quality: str) -> dict[str, Any]:
    """Film a throw where it is not there yet, check it, track it, and compare: a record for the file of results."""
    folder = filmed(films, name, samples, variant)
    result: dict[str, Any] = {"preset": name, "outcome": "tracked"}
    began = time.perf_counter()
    try:
        scene = read_scene(folder / "scene.toml")
        truth = read_truth(folder)
        result["size_px"] = size_px(scene, truth)
        with one_thread():
            findings = check_clip(scene).findings
            result["check"] = max((finding.verdict for finding in findings), key=list(Verdict).index).value
            result["findings"] = [each.name for each in findings if each.verdict is not Verdict.GOOD]
            check_scene(scene)
            tracking = track_scene(scene, silent, Stopwatch(), QUALITIES[quality])
        result |= track_compared(scene, in_file_time(truth, scene), tracking, tracking.notices)
    except (RunError, SceneError) as error:
        result |= {"outcome": "refused", "reason": str(error)}
    except Exception as error:  # a crash on one film is a result of the benchmark
        result |= {"outcome": "crashed", "reason": f"{type(error).__name__}: {error}"}
    return result | {"seconds": round(time.perf_counter() - began, 2)}


def filmed(films: Path, name: str, samples: int, variant: str) -> Path:
    """The folder of a film, which is rendered if it is not there."""
    folder = films / name
    if not folder.exists():
        films.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=films) as scratch:
            plan = Path(scratch) / "throw.toml"
            plan.write_text(PLAN)
            presets = [] if name == PLAIN else name.split("+")
            frames = round(FILMED_S * (film_settings(presets).fps or FPS)) + 1
            settings = film_settings(presets, frames=frames, size_px=SIZE_PX, samples=samples, variant=variant)
            film(read_plan(plan), Path(scratch) / "film", settings=settings)
            with suppress(OSError):  # where another process has rendered the same film meanwhile
                (Path(scratch) / "film").rename(folder)
    return folder


def size_px(scene: Scene, truth: Truth) -> float:
    """Length of an edge across the line of sight at the first impact."""
    camera = scene.cameras[0].camera
    first = truth.bounce_s[0] if len(truth.bounce_s) else truth.time_s[0]
    depth = (truth.position_m @ camera.rotation[2] + camera.translation_m[2])[
        int(np.abs(truth.time_s - first).argmin())
    ]
    return float(camera.matrix[0, 0] * scene.die.solid.edge_m / depth)


def in_file_time(truth: Truth, scene: Scene) -> Truth:
    """The truth with times as a file without time stamps counts them: frame / fps, bounces between their frames."""
    assert scene.clip.fps is not None
    file_s = truth.frame / scene.clip.fps
    seen_s, first = np.unique(truth.time_s, return_index=True)
    return replace(truth, time_s=file_s, bounce_s=np.interp(truth.bounce_s, seen_s, file_s[first]))


def print_table(results: Sequence[dict[str, Any]]) -> None:
    """A row for every preset."""
    heads = [
        "preset",
        "size",
        "tracked",
        "wrong",
        "gross",
        "unnamed",
        "bounces",
        "NEES",
        "rotation",
        "lateral",
        "depth",
        "check",
    ]
    rows = [heads, *map(row_of, results)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(heads))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def row_of(result: dict[str, Any]) -> list[str]:
    """The cells of one preset."""
    check = result.get("check", "")
    if result.get("findings"):
        check += f" ({', '.join(result['findings'])})"
    head = [result["preset"], f"{result['size_px']:.0f}" if "size_px" in result else ""]
    if result["outcome"] != "tracked":
        return [*head, f"{result['outcome']}: {result['reason'][:60]}", *[""] * 8, check]
    cells = [
        f"{result['tracked']}/{result['visible']}",
        str(result["wrong"]),
        str(result["gross"]),
        str(result["unnamed"]),
        f"{result['found']}/{result['lone']} +{result['spurious']}",
    ]
    numbers = [""] * 4
    if "nees" in result:
        numbers = [f"{result['nees']:.1f}", *(f"{result[name][0]:.3f}" for name in ("rotation", "lateral", "depth"))]
    return [*head, *cells, *numbers, check]


def save_pictures(films: Path, names: Sequence[str], path: Path) -> None:
    """Six frames of every film, a row each."""
    import cv2

    from diethrow.commands.clip.footage import open_footage

    rows = []
    for name in names:
        scene = read_scene(films / name / "scene.toml")
        clip = open_footage(scene, scene.views()[0])
        shown = set(np.linspace(0, len(clip) - 1, 6).astype(int).tolist())
        row = np.hstack([frame for k, frame in enumerate(clip.frames()) if k in shown])
        rows.append(cv2.putText(row.copy(), name, (6, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 1, cv2.LINE_AA))
    cv2.imwrite(str(path), np.vstack(rows))


if __name__ == "__main__":
    sys.exit(main())
