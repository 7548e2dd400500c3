"""Speed against accuracy, measured and published: `python benchmarks/trades.py` writes docs/trades.md and its pictures.

Tracking and its work, on the clips in data_samples: every setting of `diethrow trade`, tracked and fitted. χ is
compared with the truth that is kept in tests/data. The model, on the throws of `benchmarks/peers.py`: by events at several
tolerances, in fixed steps in double and single precision, and, where they are installed (`pip install mujoco==4.0.0
dartpy==6.20.0`), MuJoCo and DART at two steps; faces are compared with those of exact events.

Speeds are ratios of processor time to a setting that runs just before and just after, so that what else a machine does weighs
on both: median and range over the rounds. What is compiled or read from a disk is no part of a speed: the model's ways all run
once before the first round, and of a clip's settings the default does, which needs every kernel.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib import pyplot as plt
from measuring import timed
from numpy.typing import NDArray
from peers import DIE, ENGINES, PeerEngine, installed, landed_faces, our_faces, releases

from diethrow.commands.clip.trade import (
    LADDER,
    STEPS_S,
    TOLERANCES_M,
    WORK,
    Run,
    named,
    setting_of,
    track_and_fit,
    with_front,
)
from diethrow.executors import one_thread
from diethrow.files.scene import Scene, read_scene
from diethrow.model.ensembles.landings import ThrowSetup
from diethrow.model.ensembles.stepping import stepped_landings
from diethrow.model.laws import SmoothImpact
from diethrow.model.throw.simulate import Precision
from diethrow.replay.pages.trade import Setting, speed_against_error
from diethrow.runs import RunError
from diethrow.tracking.footage.decimation import WHOLE_CLIP, Decimation
from diethrow.tracking.quality import QUALITIES, Quality

Faces = NDArray[np.int64]

ROOT = Path(__file__).parents[1]
CLIPS = ("cube_wood", "icosahedron_cork", "cube_mirror", "tetrahedron_wood")
ROUNDS = 3
THROWS = 200
CHI = 0.1
"""Where faces are still decided by the release and not by rounding: at 0.5 every step gives what chance gives."""
BETWEEN = 3
"""Settings between two runs of the default."""
PEER_STEPS_S = (1e-3, 2.5e-4)
DEFAULT = ("standard", 1, 1)
FINEST = LADDER[-1]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--clips", nargs="*", choices=CLIPS, default=list(CLIPS[:2]), help="(%(default)s); none is allowed"
    )
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="in each of which everything runs (%(default)s)")
    parser.add_argument("--throws", type=int, default=THROWS, help="of each engine in a round (%(default)s)")
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of the page (%(default)s)")
    chosen = parser.parse_args(arguments)
    chosen.out.mkdir(parents=True, exist_ok=True)
    options = {
        name: vars(chosen)[name]
        for name in ("clips", "rounds", "throws")
        if vars(chosen)[name] != parser.get_default(name)
    }
    command = " ".join(
        ["python benchmarks/trades.py", *(f"--{name} {as_words(value)}" for name, value in options.items())]
    )
    matplotlib.use("Agg")
    with one_thread():
        model = measured_model(chosen.rounds, chosen.throws)
        clips = {name: measured_clip(name, chosen.rounds) for name in chosen.clips}
    for name, rows in clips.items():
        draw(chosen.out / f"trades_{name}.svg", [r for r in rows if not r.is_work], "uncertainty of χ")
    draw(chosen.out / "trades_model.svg", model, "share on another face")
    (chosen.out / "trades.md").write_text(page(command, chosen.rounds, chosen.throws, clips, model), encoding="utf-8")
    return 0


def as_words(value: object) -> str:
    """The setting as command-line options."""
    return " ".join(value) if isinstance(value, list) else str(value)


@dataclass(frozen=True)
class Row:
    """A setting, over all rounds."""

    setting: Setting
    """Its rate is the median of `speeds`."""
    speeds: tuple[float, ...]
    """Of the default's, in each round."""
    is_work: bool = False


def by_turns(default: Callable[[], float], others: Sequence[Callable[[], float]]) -> list[float]:
    """Speeds of some runs, in those of the default, from processor times [s]: it runs before, between and after them."""
    speeds: list[float] = []
    before = default()
    for k in range(0, len(others), BETWEEN):
        seconds = [run() for run in others[k : k + BETWEEN]]
        after = default()
        speeds += [0.5 * (before + after) / one for one in seconds]
        before = after
    return speeds


def over_rounds(settings: Sequence[Setting], speeds: NDArray[np.float64]) -> list[Row]:
    """Rows from the speeds (rounds, settings); NaN for a setting without a result."""
    middle = np.median(speeds, axis=0)
    return [
        Row(replace(s, rate=float(m) if np.isfinite(m) else 0.0), tuple(speeds[:, k]), s.kind == "work")
        for k, (s, m) in enumerate(zip(settings, middle, strict=True))
    ]


# --- clips ------------------------------------------------------------------------------------------------------------


def measured_clip(name: str, rounds: int) -> list[Row]:
    """Every setting on one clip, by turns."""
    scene = read_scene(ROOT / "data_samples" / name / "scene.toml")
    truth = tomllib.loads((ROOT / "tests" / "data" / name / "truth.toml").read_text(encoding="utf-8"))
    chi = float(truth["truth"]["chi"])
    tries: list[tuple[str, tuple[str, ...], Quality, Decimation, str]] = [
        (*named(choice), QUALITIES[choice[0]], Decimation(*choice[1:]), "tracking") for choice in LADDER
    ]
    tries += [(what, (), quality, WHOLE_CLIP, "work") for what, quality in WORK]
    found: list[Run | str] = [""] * len(tries)

    def seconds(j: int) -> float:
        what, _, quality, decimation, _ = tries[j]
        print(f"{name}: {what}", file=sys.stderr, flush=True)
        found[j] = run = run_or_reason(scene, quality, decimation)
        return run.seconds if isinstance(run, Run) else np.nan

    default = partial(seconds, LADDER.index(DEFAULT))
    default()
    speeds = np.array([by_turns(default, [partial(seconds, j) for j in range(len(tries))]) for _ in range(rounds)])
    finest = found[LADDER.index(FINEST)]
    settings = [
        setting_of(what, options, run, finest if isinstance(finest, Run) else None, chi, kind=kind)
        for (what, options, _, _, kind), run in zip(tries, found, strict=True)
    ]
    rows = over_rounds(settings, speeds)
    return [*marked([r for r in rows if not r.is_work]), *marked([r for r in rows if r.is_work])]


def run_or_reason(scene: Scene, quality: Quality, decimation: Decimation) -> Run | str:
    """A run, or the reason why there is none."""
    try:
        return track_and_fit(scene, quality, decimation)
    except RunError as error:
        return str(error).removeprefix(f"{scene.path}: ")


def marked(rows: Sequence[Row], badness: Callable[[Setting], float | None] = lambda s: s.chi_uncertainty) -> list[Row]:
    """The rows with those on the front marked."""
    return [replace(r, setting=s) for r, s in zip(rows, with_front([r.setting for r in rows], badness), strict=True)]


# --- the model --------------------------------------------------------------------------------------------------------


def measured_model(rounds: int, throws: int) -> list[Row]:
    """The same throws by every method in turn; the first is the default."""
    starts = releases(throws, 1)
    law = SmoothImpact(CHI)
    ways: list[tuple[str, int, Callable[[], Faces]]] = []
    for tolerance in TOLERANCES_M:
        stage = ThrowSetup(DIE, law, precision=Precision(contact_tolerance_m=tolerance))
        # About as long as the others take.
        many = np.tile(starts, (50, 1))
        ways.append((f"diethrow, events, roots to {tolerance:.0e} m", 50, partial(by_events, stage, many)))
    for step_s in STEPS_S:
        for single in (False, True):
            name = f"diethrow, steps of {1e6 * step_s:g} µs, {'single' if single else 'double'} precision"
            ways.append((name, 1, partial(stepped_landings, DIE, CHI, starts, step_s, single=single)))
    for name, make in installed(list(ENGINES)).items():
        for step_s in PEER_STEPS_S:
            ways.append((f"{name}, steps of {1e6 * step_s:g} µs", 1, partial(by_engine, make(CHI, step_s), starts)))
    exact = our_faces(starts, CHI) + 1
    faces = [way() for _, _, way in ways]

    def seconds(j: int) -> float:
        name, times, way = ways[j]
        print(name, file=sys.stderr, flush=True)
        return max(timed(way)[1], 1e-9) / times

    runs = [partial(seconds, j) for j in range(len(ways))]
    speeds = np.array([by_turns(runs[0], runs) for _ in range(rounds)])
    settings = [
        Setting("model", name, 0.0, 0.0, float((found[:throws] != exact).mean()))
        for (name, _, _), found in zip(ways, faces, strict=True)
    ]
    return marked(over_rounds(settings, speeds), lambda s: s.error)


def by_events(stage: ThrowSetup, starts: NDArray[np.float64]) -> Faces:
    """Numbers of the faces."""
    return np.asarray(stage.throw(starts).face)


def by_engine(engine: PeerEngine, starts: NDArray[np.float64]) -> Faces:
    """The same of another engine; 0 for none."""
    return np.asarray(landed_faces(engine, starts)) + 1


# --- the page ---------------------------------------------------------------------------------------------------------


def draw(path: Path, rows: Sequence[Row], y: str) -> None:
    """The front as a small SVG."""
    badness: Callable[[Setting], float | None] = (
        (lambda s: s.error) if path.stem == "trades_model" else (lambda s: s.chi_uncertainty)
    )
    with plt.rc_context({"svg.fonttype": "none", "svg.hashsalt": path.stem, "font.size": 9.0}):
        figure, ax = plt.subplots(figsize=(7.2, 3.2), layout="constrained")
        speed_against_error(ax, [r.setting for r in rows], badness, "times the speed of the default", y)
        figure.savefig(path, metadata={"Date": None})
        plt.close(figure)


def page(command: str, rounds: int, throws: int, clips: dict[str, list[Row]], model: list[Row]) -> str:
    """The page as Markdown."""
    parts = [
        f"""# Speed against accuracy

The cost and gain of choices between faster and finer, measured on the clips in `data_samples` and against other engines.
`diethrow trade SCENE` does the same on any scene and recommends a setting. This page was written by

```sh
{command}
```

Speed is the ratio of processor times to the default, which runs just before and just after: the median of {rounds}
rounds in which all settings take turns, with the range in brackets. Bold settings are on the front: none is both faster and
more accurate; the pictures use the numbers of the tables.

## Tracking and fit

The default is `--quality standard` on the whole clip. χ is the result of the whole analysis; *±* is the half width of
its 95 % interval, *error* its distance from the truth of the rendered clip. Corners are compared with those of
the finest run. In a clip's second table the standard quality has one of its numbers changed: pixel lines walked along the
edges, pixels that score a pose, initial poses and hypotheses.
"""
    ]
    for name, rows in clips.items():
        ladder, work = [r for r in rows if not r.is_work], [r for r in rows if r.is_work]
        parts.append(f"### {name}\n\n![Speed against the interval width of χ](trades_{name}.svg)\n")
        parts.append(table(["", "setting", "speed", "χ", "±", "error", "corners [mm]"], clip_cells(ladder)))
        parts.append(table(["", "standard, but", "speed", "χ", "±", "error", "corners [mm]"], clip_cells(work)))
        reasons = [f"- {r.setting.name}: {r.setting.why_not}" for r in rows if r.setting.why_not is not None]
        if reasons:
            parts.append("χ stays open:\n\n" + "\n".join(reasons) + "\n")
    parts.append(
        f"""## The model against other engines

{throws} throws of a cube of 2 cm from 0.3 m at 40 rad/s, χ = {CHI:g}, no friction, until the face is decided. The engines are
set up as in `benchmarks/peers.py`, each as near to a rigid impact as it allows; that script prints how their states agree
impact by impact. The default is events with roots to {TOLERANCES_M[0]:.0e} m; by chance five throws in six land on
another face.

![Speed against the share of throws on another face](trades_model.svg)
"""
    )
    cells = [[str(k), r.setting.name, ratio(r), f"{r.setting.error or 0.0:.1%}"] for k, r in enumerate(model, start=1)]
    parts.append(
        table(["", "method", "speed", "on another face"], [bold(c, r) for c, r in zip(cells, model, strict=True)])
    )
    return "\n".join(parts)


def clip_cells(rows: Sequence[Row]) -> list[list[str]]:
    """The rows of a clip, with the numbers of the picture."""
    cells, number = [], 0
    for row in rows:
        s = row.setting
        number += s.why_not is None
        if s.why_not is not None or s.chi is None:
            cells.append(["", s.name, ratio(row), "open", "", "", "" if s.error is None else f"{s.error:.2g}"])
            continue
        values = [f"{s.chi:.4f}", f"{s.half_width or 0.0:.1g}", f"{s.chi_error or 0.0:.1g}"]
        cells.append(bold([str(number), s.name, ratio(row), *values, "" if s.error is None else f"{s.error:.2g}"], row))
    return cells


def ratio(row: Row) -> str:
    """Median and range."""
    if not row.setting.rate:
        return ""
    return f"{row.setting.rate:.2g} ({min(row.speeds):.2g} to {max(row.speeds):.2g})"


def bold(cells: Sequence[str], row: Row) -> list[str]:
    """The cells, in bold where the row is on the front."""
    return [f"**{cell}**" if row.setting.on_front and cell else cell for cell in cells]


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rows)) + "\n"


if __name__ == "__main__":
    sys.exit(main())
