"""Whether joint fits mean their intervals: `python benchmarks/joint_fits.py DATA [--splits 40] [--sets 40] [--throws 60]
[--predict]`.

DATA holds `scene.toml` and `toss_*.csv` (columns of track.csv), as `benchmarks/tosses.py` takes them.

1. Splits. Random halves a and b of 2 × `throws` tosses are fitted alone, each with its own effects. Of every parameter: how often
   |a - b| ≤ 1.96 √(σ_a² + σ_b²), with σ a quarter of the interval of 95 %; a half whose model lacks an effect counts with the
   value of none and no error. 90 to 99 % is honest.
2. Sets. Tosses are simulated from the release states of real ones, with the noise of their frames, with and without a χ that
   varies from throw to throw (a law that misses). How often the intervals contain the truth, and how often an effect is accepted
   that no throw has.

3. Predictions. Every second toss is fitted, and the others are predicted from the frames before their first bounce. Mean errors
   after the bounce with their standard errors over the tosses, and the share of the errors of one axis that lie within 1.96
   standard errors of the predicted covariance, by the time since the release state.

Each rate comes with its interval of 95 % (Wilson).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tosses import read_entries

from diethrow.files.scene import read_scene
from diethrow.fitting.dataset import Entry, JointFit, entry_of, fit_jointly
from diethrow.fitting.estimation import normal_quantile
from diethrow.fitting.predict import predict_track, simulated_throws, with_covariances
from diethrow.fitting.throw import Physics
from diethrow.model import engine
from diethrow.model.die import Die
from diethrow.model.laws import LEVEL
from diethrow.model.rotations import quat_from_rotvec, quat_multiply, rotation_between

Array = NDArray[np.float64]
Values = dict[str, tuple[float, float]]
"""Value and standard error of each parameter."""

Z95 = normal_quantile(0.95)

TRUTHS: dict[str, dict[str, float]] = {
    "friction": {"chi": 0.35, "mu": 0.2},
    "friction, rounded corners": {"chi": 0.27, "mu": 0.18, "corner_radius_m": 0.006},
    "friction, inertia": {"chi": 0.5, "mu": 0.25, "inertia_kg_m2": 0.00105},
}
"""What simulated throws have, in turn."""

EFFECT_OF = {
    "mu": "friction",
    "corner_radius_m": "rounded corners",
    "inertia_kg_m2": "inertia",
}

SCATTERS = (0.0, 0.04)
"""Standard deviation of χ from throw to throw."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--splits", type=int, default=40)
    parser.add_argument("--sets", type=int, default=40, help="simulated sets of each kind of scatter")
    parser.add_argument("--throws", type=int, default=60, help="throws of one fit")
    parser.add_argument("--predict", action="store_true", help="the third part")
    parser.add_argument("--out", type=Path, default=None, help="write all results to this JSON")
    options = parser.parse_args()
    results: dict[str, object] = {}
    with ProcessPoolExecutor(2) as pool:
        if options.splits:
            jobs = [(options.data, options.throws, seed, side) for seed in range(options.splits) for side in (0, 1)]
            results["splits"] = splits = list(_paired(pool.map(fit_of_half, jobs)))
            print_splits(splits)
        for scatter in SCATTERS if options.sets else ():
            sets = [(options.data, options.throws, seed, scatter) for seed in range(options.sets)]
            results[f"sets, scatter {scatter:g}"] = found = list(pool.map(fit_of_simulated, sets))
            print_sets(found, scatter)
    if options.predict:
        results["predictions"] = print_predictions(options.data)
    if options.out is not None:
        options.out.write_text(json.dumps(results))


@cache
def tosses(folder: Path) -> tuple[Die, list[Entry]]:
    """Die and tosses of a folder."""
    die = read_scene(folder / "scene.toml").die
    return die, read_entries(folder, die, None)


# --- two halves ---


def fit_of_half(job: tuple[Path, int, int, int]) -> Values:
    """The parameters of one half of the tosses."""
    folder, count, seed, side = job
    die, entries = tosses(folder)
    order = np.random.default_rng(seed).permutation(len(entries))
    found = fit_jointly([entries[k] for k in np.sort(order[side * count : (side + 1) * count])], die)
    return values_of(found)


def values_of(fit: JointFit) -> Values:
    """Value and standard error of each parameter of a fit."""
    found: Values = {}
    for name, parameter in fit.parameters.items():
        assert parameter.value is not None
        assert parameter.low is not None
        assert parameter.high is not None
        found[name] = (parameter.value, (parameter.high - parameter.low) / (2.0 * Z95))
    return found


def _paired(found: Iterator[Values]) -> Iterator[tuple[Values, Values]]:
    for k, first in enumerate(found):
        pair = first, next(found)
        shown = {
            name: f"{pair[0].get(name, (0, 0))[0]:.4g} {pair[1].get(name, (0, 0))[0]:.4g}" for name in names_of([pair])
        }
        print(f"   split {k}: {shown}", flush=True)
        yield pair


def names_of(pairs: Sequence[tuple[Values, Values]]) -> list[str]:
    """Parameters of any of the fits."""
    return list(dict.fromkeys(name for pair in pairs for one in pair for name in one))


def print_splits(pairs: Sequence[tuple[Values, Values]]) -> None:
    print(f"\n{len(pairs)} splits into halves. |a - b| within 1.96 standard errors, rms of |a - b| over them:")
    for name in names_of(pairs):
        both = [(a[name], b[name]) for a, b in pairs if name in a and name in b]
        one = sum((name in a) != (name in b) for a, b in pairs)
        ratios = np.array([abs(a[0] - b[0]) / np.hypot(a[1], b[1]) for a, b in both])
        rms = float(np.sqrt(np.mean(ratios**2))) if len(both) else np.nan
        print(f"{name:<22} {rate(int((ratios <= Z95).sum()), len(both))}  rms {rms:.2f}; in one half only: {one}")


# --- simulated sets ---


def fit_of_simulated(job: tuple[Path, int, int, float]) -> dict[str, object]:
    """Which intervals contain the truth, and the false effects of one simulated set."""
    folder, count, seed, scatter = job
    die, entries = tosses(folder)
    rng = np.random.default_rng([seed, int(1000 * scatter)])
    kind = list(TRUTHS)[seed % len(TRUTHS)]
    truth = TRUTHS[kind]
    order = rng.permutation(len(entries))[:count]
    throws = [simulated(entries[k], die, truth, scatter, rng) for k in np.sort(order)]
    fit = fit_jointly([entry for entry in throws if entry is not None], die)
    inside = {}
    for name, parameter in fit.parameters.items():
        true = truth.get(name, Physics(die, LEVEL, truth).neutral(name) if name != "chi" else 0.0)
        assert parameter.low is not None
        assert parameter.high is not None
        inside[name] = parameter.low <= true <= parameter.high
    wanted = {EFFECT_OF[name] for name in truth if name in EFFECT_OF}
    chosen = {effect.name for effect in fit.chosen}
    return {"kind": kind, "inside": inside, "false": sorted(chosen - wanted), "missed": sorted(wanted - chosen)}


def simulated(
    entry: Entry, die: Die, truth: dict[str, float], scatter: float, rng: np.random.Generator
) -> Entry | None:
    """A toss with the release state and the times of a real one, as the truth has it; None if it cannot be fitted."""
    physics = Physics(die, LEVEL, {**truth, "chi": truth["chi"] + scatter * rng.standard_normal()})
    release, track = entry.release, entry.track
    used = np.concatenate([release.rows, entry.rows])
    before = release.poses(track.time_s[release.rows])
    start = release.state
    later = entry.rows[entry.times_s >= start.time_s]
    after = simulated_throws(physics, [start], [track.time_s[later]], precision=engine.FINE)
    position = np.concatenate([before[0], after[0]])
    quaternion = np.concatenate([before[1], after[1]])
    turns = release.sigma_rad * rng.standard_normal(position.shape)
    made = replace(
        track,
        frame=track.frame[used],
        time_s=track.time_s[used],
        position_m=position + release.sigma_m * rng.standard_normal(position.shape),
        quaternion=quat_multiply(quat_from_rotvec(turns), quaternion),
        covariance=track.covariance[used],
        status=track.status[used],
    )
    try:
        return entry_of(entry.name, made, die)
    except ValueError:
        return None


def print_sets(found: Sequence[dict[str, object]], scatter: float) -> None:
    print(
        f"\n{len(found)} simulated sets, chi varies by {scatter:g} from throw to throw. Intervals that contain the truth:"
    )
    inside: dict[str, list[bool]] = {}
    for one in found:
        for name, held in one["inside"].items():  # type: ignore[attr-defined]
            inside.setdefault(name, []).append(held)
    for name, held in inside.items():
        print(f"{name:<22} {rate(sum(held), len(held))}")
    false = [one["false"] for one in found if one["false"]]
    print(f"sets with a false effect: {rate(len(false), len(found))} {false}")
    print(f"sets that miss an effect: {rate(sum(bool(one['missed']) for one in found), len(found))}", flush=True)


# --- predictions ---


def print_predictions(folder: Path) -> dict[str, object]:
    """The third part; returns its figures."""
    die, entries = tosses(folder)
    begin = time.perf_counter()
    fit = fit_jointly(entries[0::2], die, threads=2)
    seconds = time.perf_counter() - begin
    values = ", ".join(f"{name} {value:.4g}" for name, value in fit.physics.values.items())
    print(f"\n{len(entries[0::2])} tosses fitted in {seconds:.0f} s: {values}")
    rows = [errors_of_prediction(entry, fit) for entry in entries[1::2]]
    means = np.array([[row[:, 1].mean(), row[:, 2].mean()] for row in rows])
    edge, turn = 100.0 / die.solid.edge_m, 180.0 / np.pi
    error = means.std(0, ddof=1) / np.sqrt(len(means))
    print(
        f"the other {len(means)}: {edge * means[:, 0].mean():.1f} ± {edge * error[0]:.1f} % of the edge, "
        f"{turn * means[:, 1].mean():.1f} ± {turn * error[1]:.1f} degrees; medians {edge * np.median(means[:, 0]):.1f} %, "
        f"{turn * np.median(means[:, 1]):.1f} degrees"
    )
    every = np.concatenate(rows)
    cuts = np.quantile(every[:, 0], np.linspace(0.0, 1.0, 6))
    print("time since the release state [s]   within 1.96 sigma: position, rotation")
    for low, high in pairwise(cuts):
        some = every[(every[:, 0] >= low) & (every[:, 0] <= high)]
        print(f"{low:>10.3f} to {high:<18.3f} {100 * some[:, 3].mean():>12.0f} % {100 * some[:, 4].mean():>9.0f} %")
    share = np.array([[row[:, 3].mean(), row[:, 4].mean()] for row in rows])
    spread = share.std(0, ddof=1) / np.sqrt(len(share))
    print(
        f"all, each toss counted once: position {100 * share[:, 0].mean():.1f} ± {100 * spread[0]:.1f} %, "
        f"rotation {100 * share[:, 1].mean():.1f} ± {100 * spread[1]:.1f} %"
    )
    return {"seconds": seconds, "errors": means.tolist(), "inside": share.tolist()}


def errors_of_prediction(entry: Entry, fit: JointFit) -> Array:
    """(n, 5) of each frame after the first bounce: time since the release state [s], distance [m], rotation [rad], and the shares
    of the three axes whose errors of position, and of rotation, lie within 1.96 standard errors."""
    release = entry.release.of_die(fit.physics.body)
    predicted = with_covariances(
        predict_track(fit.physics, entry.track, release),
        fit.physics,
        release,
        fit.parameters,
        fit.covariance,
        fit.misfit,
    )
    rows = entry.rows[predicted.tracked[entry.rows]]
    off = entry.track.position_m[rows] - predicted.position_m[rows]
    turned = rotation_between(predicted.quaternion[rows], entry.track.quaternion[rows])
    sigma = np.sqrt(np.diagonal(predicted.covariance[rows], axis1=1, axis2=2))
    inside = np.abs(np.hstack([off, turned])) <= Z95 * sigma
    since = entry.track.time_s[rows] - release.state.time_s
    return np.column_stack(
        [
            since,
            np.linalg.norm(off, axis=1),
            np.linalg.norm(turned, axis=1),
            inside[:, :3].mean(1),
            inside[:, 3:].mean(1),
        ]
    )


def rate(hits: int, trials: int) -> str:
    """A rate with its interval of 95 % (Wilson, J. Am. Stat. Assoc. 22, 209, 1927)."""
    if not trials:
        return "none"
    share, z2 = hits / trials, Z95**2
    middle = (share + 0.5 * z2 / trials) / (1.0 + z2 / trials)
    half = Z95 / (1.0 + z2 / trials) * np.sqrt(share * (1.0 - share) / trials + 0.25 * z2 / trials**2)
    return f"{hits} of {trials}, {100 * share:.0f} % ({100 * (middle - half):.0f} to {100 * (middle + half):.0f})"


if __name__ == "__main__":
    main()
