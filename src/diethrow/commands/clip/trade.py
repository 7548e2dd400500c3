"""`diethrow trade`: speed against accuracy, measured on one scene.

Four trades:

- **Tracking**: the clip is tracked at every quality, with all or every n-th frame, at full or smaller size; each track is fitted.
  Reported are frames per second, the distance of poses and χ from the finest run (or from the truth, if a `truth.toml` lies
  beside the scene), and the width of the χ interval.
- **Work**: the standard quality with one of its numbers changed: pixel lines, pixels that score a pose, initial poses,
  hypotheses, steps per frame. The same is reported.
- **Fit**: on the finest track, χ from single bounces, and from the whole throw with each kind of interval. Reported are seconds,
  width, and coverage: the share of tracks, simulated from the fit with the frames' covariances, whose interval contains the
  true χ.
- **Model**: throws from the fitted release, spread by its covariance and a small rotation, simulated by events at several
  tolerances and in fixed steps in double and single precision. Reported are throws per second and the share that lands on
  another face than with exact events.

A setting is on the front if none is both faster and more accurate. The recommended setting for a wanted ±χ is the fastest
tracking whose interval, and whose distance from the reference, are within it.
"""

from __future__ import annotations

import csv
import json
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...executors import one_thread
from ...files.outputs import whole_folder
from ...files.provenance import Stopwatch, unchanged_inputs, write_provenance
from ...files.scene import Scene
from ...fitting.estimation import flight_observations, whiteners
from ...fitting.free import common_restitution, fit_flights, measure_bounces
from ...fitting.results import Choices, Fit, IntervalMethod, Parameter
from ...fitting.throw import INTERVAL_LEVEL, fit_throw
from ...model.die import Die, die_symmetries
from ...model.ensembles import ThrowSetup, stepped_landings
from ...model.errors import InputError
from ...model.laws import SmoothImpact
from ...model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply
from ...model.throw import Precision, State, Throw
from ...replay.pages import Setting, Trade, fastest_within, trade_page, write_trade_figures
from ...runs import Progress, RunError, Tracking, silent
from ...tracking.flights import perturbed
from ...tracking.footage import WHOLE_CLIP, Decimation
from ...tracking.quality import QUALITIES, STANDARD, Quality
from ...tracking.throw import frames_in_flight
from ...tracking.track import Track
from .track import EarlierTracking, check_scene, input_paths, track_scene

Array = NDArray[np.float64]

WITHIN = 0.01
"""Wanted half-width of the interval of χ by default."""

LADDER: tuple[tuple[str, int, int], ...] = (
    ("fast", 4, 2),
    ("fast", 2, 2),
    ("fast", 4, 1),
    ("fast", 1, 2),
    ("fast", 2, 1),
    ("fast", 1, 1),
    ("standard", 4, 1),
    ("standard", 1, 4),
    ("standard", 2, 2),
    ("standard", 1, 2),
    ("standard", 2, 1),
    ("standard", 1, 1),
    ("fine", 1, 1),
)
"""Quality, every n-th frame, factor on the pixel size; the last is the finest."""

FIRST_OF_LADDER = ("standard", 1, 1)
"""Run once untimed, so that no speed includes compilation or loading of kernels."""

WORK: tuple[tuple[str, Quality], ...] = (
    ("every pixel line in the first pass, not every second", replace(STANDARD, tracking_line_stride=1)),
    ("every fourth pixel line", replace(STANDARD, tracking_line_stride=4)),
    ("edges by 8 pixels to either side, not 3.5", replace(STANDARD, band_px=8.0)),
    ("200 pixels score a pose, not 800", replace(STANDARD, region_pixels=200)),
    ("2500 pixels", replace(STANDARD, region_pixels=2500)),
    ("1 initial pose, not up to 24", replace(STANDARD, max_initial_poses=1)),
    ("6 initial poses", replace(STANDARD, max_initial_poses=6)),
    ("no further hypothesis at a break of the motion, not all", replace(STANDARD, max_hypotheses=0)),
    ("6 hypotheses", replace(STANDARD, max_hypotheses=6)),
    ("2 steps per frame, not 4", replace(STANDARD, fine_steps=2)),
    ("8 steps", replace(STANDARD, fine_steps=8, min_gain=1e-3)),
)
"""The standard quality with one number changed."""

STEPS_S = (1e-3, 1e-4, 1e-5)
"""Fixed time steps; general engines use the longest."""
TOLERANCES_M = (1e-12, 1e-9, 1e-6)
"""Tolerances of the root of the next touch."""
THROWS = 400
TURNED_RAD = 0.05
"""Spread of the releases whose faces are compared: the repeatability of a hand."""
DRAWS = 20
"""Tracks simulated per coverage rate: a 95 % interval misses one of them on average."""


def trade(
    scene: Scene,
    out: Path,
    *,
    within: float = WITHIN,
    draws: int = DRAWS,
    force: bool = False,
    progress: Progress = silent,
    command: tuple[str, ...] = (),
) -> Trade:
    """Measure every setting on a scene, and write trade.json, trade.csv, trade.png, trade.svg and trade.html to `out`.

    `within` is the wanted half-width of χ's interval, `draws` the simulated tracks per coverage rate; 0 omits coverage. Raises
    SceneError for a scene that cannot be analysed, RunError if not even the finest setting finds the die, and ValueError for a
    `within` outside (0, 1).
    """
    if not 0.0 < within < 1.0:
        raise InputError(f"within = {within}: wanted a half-width of χ between 0 and 1, such as 0.01")
    watch = Stopwatch()
    check_scene(scene)
    paths = input_paths(scene)
    with whole_folder(out, force=force, inputs=paths) as folder, unchanged_inputs(paths) as inputs:
        with one_thread(), watch.stage("trade"):
            measured = _measured(scene, within, draws, progress)
        _write(folder, scene.name, measured)
        write_provenance(folder, command=command, understood=scene, inputs=inputs, seconds=watch.seconds)
    return measured


def read_trade(path: Path) -> tuple[Setting, ...]:
    """The settings of a trade.json. Raises ValueError for any other file."""
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
        return tuple(Setting(**{**row, "options": tuple(row["options"])}) for row in data["settings"])
    except (KeyError, TypeError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: not a trade file ({error}); wanted the trade.json that diethrow trade writes"
        ) from error


def setting_from(measured: Path, within: float) -> tuple[str, Decimation]:
    """Quality and decimation by the trade.json of this or a similar scene. Raises ValueError if no setting in it is accurate
    enough."""
    best = fastest_within([s for s in read_trade(measured) if s.kind == "tracking"], within)
    if best is None:
        raise InputError(f"{measured}: no setting in it gives χ to ±{within:g}; ask for less, or use --quality fine")
    return best.choice


@dataclass(frozen=True, eq=False)
class ChosenSetting:
    """The fastest setting that is accurate enough."""

    quality: str
    decimation: Decimation
    tracked: EarlierTracking | None = None
    """What it tracked, if that was needed to choose it: the clip need not be tracked again."""


def setting_for(
    scene: Scene, within: float, measured: Path | None = None, progress: Progress = silent
) -> ChosenSetting:
    """Quality and decimation of the fastest analysis that gives χ to ± `within`.

    The setting is taken from the trade.json `measured` of this or a similar scene. Without it, the settings of LADDER are tried
    until the interval is half as wide as wanted: the interval of a coarse run does not contain its systematic error. Raises
    ValueError if no setting is accurate enough, RunError if no setting finds the die.
    """
    if measured is not None:
        return ChosenSetting(*setting_from(measured, within))
    narrowest: float | None = None
    with one_thread(), unchanged_inputs(input_paths(scene)) as inputs:
        for k, (quality, every, shrink) in enumerate(LADDER):
            progress("Choosing a setting", k, len(LADDER))
            try:
                run = track_and_fit(scene, QUALITIES[quality], Decimation(every, shrink))
            except RunError:
                if k == len(LADDER) - 1:
                    raise
                continue
            width = setting_of(*named((quality, every, shrink)), run, None, None).half_width
            if width is not None and width <= 0.5 * within:
                tracked = EarlierTracking(run.tracking, inputs.files)
                return ChosenSetting(quality, Decimation(every, shrink), tracked)
            narrowest = min(width, narrowest or np.inf) if width is not None else narrowest
    reached = "leaves χ undetermined" if narrowest is None else f"gives ±{narrowest:.2g}"
    raise InputError(
        f"{scene.path}: no setting determines χ to ±{within:g}, the best {reached}; film more bounces, or widen --chi-within"
    )


# --- the measurements -------------------------------------------------------------------------------------------------


def _measured(scene: Scene, within: float, draws: int, progress: Progress) -> Trade:
    total = len(LADDER) + len(WORK) + 1
    progress("Tracking", 0, total)
    quality, every, shrink = FIRST_OF_LADDER
    track_and_fit(scene, QUALITIES[quality], Decimation(every, shrink))
    tries = [(choice, QUALITIES[choice[0]], Decimation(*choice[1:])) for choice in reversed(LADDER)]
    runs: list[tuple[tuple[str, int, int], Run | str]] = []
    for k, (choice, of_choice, decimation) in enumerate(tries):
        progress("Tracking", k + 1, total)
        run = _run_or_reason(scene, of_choice, decimation)
        if k == 0 and isinstance(run, str):
            raise RunError(run)
        runs.append((choice, run))
    finest = runs[0][1]
    assert isinstance(finest, Run)
    work: list[tuple[str, Run | str]] = []
    for k, (name, changed) in enumerate(WORK):
        progress("Tracking", len(LADDER) + 1 + k, total)
        work.append((name, _run_or_reason(scene, changed, WHOLE_CLIP)))
    truth = _true_chi(scene)
    chi = truth if truth is not None else finest.fit.parameters["chi"].value
    reference = "the truth beside the scene" if truth is not None else "the finest run"
    tracking = [setting_of(*named(choice), run, finest, chi) for choice, run in runs]
    parts = [setting_of(name, (), run, finest, chi, kind="work") for name, run in work]
    fits = list(_fits(finest, chi, draws, progress))
    model = list(_models(finest, progress))
    settings = [
        *with_front(tracking, lambda s: s.chi_uncertainty),
        *with_front(parts, lambda s: s.chi_uncertainty),
        *with_front(fits, lambda s: s.half_width),
        *with_front(model, lambda s: s.error),
    ]
    return Trade(tuple(settings), reference, within)


@dataclass(frozen=True, eq=False)
class Run:
    """One tracking of the clip, with its fit."""

    tracking: Tracking
    fit: Fit
    frames: int
    """Frames of the clip, used or not."""
    seconds: float
    """Processor time."""

    @property
    def in_flight(self) -> Track:
        """The frames in flight, to which a model can be fitted."""
        return frames_in_flight(self.tracking.unbiased, self.tracking.measured)


def track_and_fit(scene: Scene, quality: Quality, decimation: Decimation = WHOLE_CLIP) -> Run:
    """Track the die and fit the throw, measured in processor time. Raises RunError if no die is found."""
    began = time.process_time()
    tracking = track_scene(scene, quality=quality, decimation=decimation)
    fit = fit_throw(frames_in_flight(tracking.unbiased, tracking.measured), tracking.measured, tracking.die)
    seconds = time.process_time() - began
    return Run(tracking, fit, decimation.every * len(tracking.frames), seconds)


def _run_or_reason(scene: Scene, quality: Quality, decimation: Decimation) -> Run | str:
    try:
        return track_and_fit(scene, quality, decimation)
    except RunError as error:
        return str(error)


def named(choice: tuple[str, int, int]) -> tuple[str, tuple[str, ...]]:
    """The name of a setting, and the options of `diethrow analyze` that select it."""
    quality, every, shrink = choice
    name = f"{quality}, {_ordinal(every)} frame, {'full size' if shrink == 1 else f'1/{shrink} of the size'}"
    less = [("--every", every), ("--shrink", shrink)]
    return name, ("--quality", quality, *(text for o, n in less if n > 1 for text in (o, str(n))))


def setting_of(
    name: str,
    options: tuple[str, ...],
    run: Run | str,
    finest: Run | None,
    chi: float | None,
    *,
    kind: str = "tracking",
) -> Setting:
    """A run compared with the finest run and the reference χ, or the reason why it gave no result."""
    if isinstance(run, str):
        return Setting(kind, name, 0.0, 0.0, None, options=options, why_not=run)
    found = run.fit.parameters["chi"]
    return Setting(
        kind,
        name,
        run.frames / run.seconds,
        run.seconds,
        None if finest is None else _corners_apart_mm(run, finest),
        found.value,
        found.low,
        found.high,
        None if found.value is None or chi is None else abs(found.value - chi),
        options=options,
        why_not=None if found.value is not None else " ".join(run.fit.messages),
    )


def _corners_apart_mm(run: Run, finest: Run) -> float | None:
    """Median distance [mm] of the die's vertices from those of the finest run, on common frames."""
    one, other = run.tracking.smoothed, finest.tracking.smoothed
    _, a, b = np.intersect1d(one.frame[one.tracked], other.frame[other.tracked], return_indices=True)
    if not len(a):
        return None
    rows, others = np.flatnonzero(one.tracked)[a], np.flatnonzero(other.tracked)[b]
    die = finest.tracking.die
    # Plain faces have no names: one symmetry turns all of a track's labels into those of another.
    turns = die_symmetries(die.with_marks(None))
    shifts = one.position_m[rows] - other.position_m[others]
    apart = [
        np.median(
            np.linalg.norm(_corners(die, one, rows, turn) - _corners(die, other, others) + shifts[:, None], axis=2)
        )
        for turn in turns
    ]
    return 1e3 * float(min(apart))


def _corners(die: Die, track: Track, rows: NDArray[np.int64], turn: Array | None = None) -> Array:
    """Corners (n, v, 3) [m] from the centre, in world axes."""
    vertices = die.solid.vertices if turn is None else die.solid.vertices @ turn.T
    return np.einsum("nij,vj->nvi", matrix_from_quat(track.quaternion[rows]), vertices)


def _true_chi(scene: Scene) -> float | None:
    """χ of the `truth.toml` beside a rendered scene; None without one."""
    path = scene.path.with_name("truth.toml")
    if not path.is_file():
        return None
    try:
        return float(tomllib.loads(path.read_text(encoding="utf-8"))["truth"]["chi"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: no χ in it ({error}); wanted chi under [truth], or no such file") from error


# --- fits -------------------------------------------------------------------------------------------------------------


def _fits(finest: Run, chi: float | None, draws: int, progress: Progress) -> Iterator[Setting]:
    """χ by each method on the finest track, with its coverage on tracks simulated from the fit."""
    tracks = list(_again(finest, draws)) if finest.fit.bounces_fitted else []
    made_with = finest.fit.parameters["chi"].value
    methods: list[tuple[str, tuple[str, ...], Callable[[Track, Throw, Die], Parameter | None]]] = [
        ("bounce by bounce", (), _by_bounces),
        ("whole throw, covariance", ("--intervals", "covariance"), _by_throw("covariance")),
        ("whole throw, profile", (), _by_throw("profile")),
        ("whole throw, bootstrap", ("--intervals", "bootstrap"), _by_throw("bootstrap")),
    ]
    total, done = len(methods) * (1 + len(tracks)), 0
    for name, options, method in methods:
        progress("Fitting", done, total)
        began = time.process_time()
        found = method(finest.in_flight, finest.tracking.measured, finest.tracking.die)
        seconds = time.process_time() - began
        held = []
        for track in tracks:
            done += 1
            progress("Fitting", done, total)
            again = method(track, finest.tracking.measured, finest.tracking.die)
            if again is not None and again.low is not None and again.high is not None and made_with is not None:
                held.append(again.low <= made_with <= again.high)
        done += 1
        if found is None or found.value is None:
            yield Setting("fit", name, 1.0 / seconds, seconds, None, options=options, why_not="It leaves χ open.")
            continue
        off = None if chi is None else abs(found.value - chi)
        coverage = float(np.mean(held)) if held else None
        yield Setting(
            "fit", name, 1.0 / seconds, seconds, off, found.value, found.low, found.high, off, coverage, options
        )


def _by_throw(method: IntervalMethod) -> Callable[[Track, Throw, Die], Parameter]:
    def fitted(track: Track, measured: Throw, die: Die) -> Parameter:
        return fit_throw(track, measured, die, choices=Choices(method)).parameters["chi"]

    return fitted


def _by_bounces(track: Track, measured: Throw, die: Die) -> Parameter | None:
    """χ from the normal velocities at each bounce, without an impact law."""
    free = fit_flights(flight_observations(track, measured), measured)
    common = common_restitution(measure_bounces(die, free, measured.impacts), level=INTERVAL_LEVEL)
    if common is None:
        return None
    value, low, high = common
    return Parameter(value, max(low, 0.0), min(high, 1.0), INTERVAL_LEVEL, True, False)


def _again(finest: Run, draws: int) -> Iterator[Track]:
    """A simulated track of the fitted throw, with errors sampled from the frames' covariances."""
    throw, track = finest.fit.throw, finest.in_flight
    assert throw is not None
    rows = np.flatnonzero(track.tracked & (track.time_s <= throw.flights[-1].end_s))
    weights = whiteners(track.covariance[rows])
    usable = np.isfinite(weights).all((1, 2))
    rows, weights = rows[usable], weights[usable]
    positions, quaternions = throw.poses(track.time_s[rows])
    random = np.random.default_rng(0)
    for _ in range(draws):
        errors = np.linalg.solve(weights, random.standard_normal((len(rows), 6, 1)))[:, :, 0]
        position, quaternion = track.position_m.copy(), track.quaternion.copy()
        position[rows] = positions + errors[:, :3]
        quaternion[rows] = quat_multiply(quat_from_rotvec(errors[:, 3:]), quaternions)
        yield replace(track, position_m=position, quaternion=quaternion)


# --- the model --------------------------------------------------------------------------------------------------------


def _models(finest: Run, progress: Progress) -> Iterator[Setting]:
    """Throws near the fitted one, by events and in fixed steps."""
    fit, die = finest.fit, finest.tracking.die
    chi = fit.parameters["chi"].value
    if fit.initial is None or chi is None:
        return
    plain = die.with_corner_radius(0.0)
    starts = _starts(plain, fit.initial)
    law = SmoothImpact(chi)
    exact = ThrowSetup(plain, law).throw(starts).face
    choices: list[tuple[str, Callable[[], NDArray[np.int64]]]] = []
    for tolerance in TOLERANCES_M:
        stage = ThrowSetup(plain, law, precision=Precision(contact_tolerance_m=tolerance))
        choices.append((f"events, roots to {tolerance:.0e} m", partial(_landed, stage, starts)))
    # Fixed steps follow dice with one moment of inertia.
    for step_s in STEPS_S if plain.is_spherical_top else ():
        for single in (False, True):
            name = f"steps of {1e6 * step_s:g} µs, {'single' if single else 'double'} precision"
            choices.append((name, partial(stepped_landings, plain, chi, starts, step_s, single=single)))
    for k, (name, landed) in enumerate(choices):
        progress("Simulating", k, len(choices))
        landed()  # compiled, and in the cache of the processor
        began = time.process_time()
        faces = landed()
        seconds = max(time.process_time() - began, 1e-9)
        yield Setting("model", name, THROWS / seconds, seconds, float((faces != exact).mean()))


def _landed(stage: ThrowSetup, starts: Array) -> NDArray[np.int64]:
    return stage.throw(starts).face


def _starts(die: Die, initial: State) -> Array:
    """Releases (n, 13) near the fitted one, each rotated slightly, at time 0."""
    random = np.random.default_rng(0)
    rows: list[Array] = []
    while len(rows) < THROWS:
        change = np.zeros(12)
        change[3:6] = TURNED_RAD * random.standard_normal(3)
        s = perturbed(initial, change)
        lowest = float((s.rotation @ die.solid.vertices.T)[2].min() + s.position_m[2])
        if lowest > 0.0:
            rows.append(np.concatenate([s.position_m, s.quaternion, s.velocity_m_s, s.omega_rad_s]))
    return np.array(rows)


# --- what comes out ---------------------------------------------------------------------------------------------------


def with_front(settings: Sequence[Setting], badness: Callable[[Setting], float | None]) -> list[Setting]:
    """The settings, with `on_front` set for those that no other beats in both speed and `badness`."""
    scored = [(s, badness(s)) for s in settings]

    def beaten(setting: Setting, value: float) -> bool:
        return any(
            other is not setting
            and bad is not None
            and other.rate >= setting.rate
            and bad <= value
            and (other.rate > setting.rate or bad < value)
            for other, bad in scored
        )

    return [replace(s, on_front=value is not None and not beaten(s, value)) for s, value in scored]


def _write(folder: Path, title: str, measured: Trade) -> None:
    rows = [asdict(setting) for setting in measured.settings]
    data = {"within": measured.within, "reference": measured.reference, "advice": measured.advice, "settings": rows}
    (folder / "trade.json").write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    with (folder / "trade.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(rows[0])
        writer.writerows([_cell(value) for value in row.values()] for row in rows)
    write_trade_figures(folder, measured)
    (folder / "trade.html").write_text(trade_page(title, measured), encoding="utf-8")


def _cell(value: Any) -> Any:
    return "" if value is None else " ".join(value) if isinstance(value, tuple) else value


def _ordinal(every: int) -> str:
    return {1: "every", 2: "every second", 3: "every third"}.get(every, f"every {every}th")
