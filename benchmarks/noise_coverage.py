"""Coverage of the fit's intervals where noise is not white: `python benchmarks/noise_coverage.py [throws] [--page FILE.md]`.

Simulated tracks of cubes, tetrahedra and icosahedra in turn, χ from 0.1 to 0.95, one to four bounces, at the noise of
`tests/helpers/throws.py`, with errors of eight kinds: white; correlated from frame to frame (AR(1)) over 2, 5 and 20 frames;
positions alone correlated; heavy tails (Student's t with three degrees of freedom); 3 % of the frames ten times off; and a law
that misses a little: χ of each impact differs from that of the throw by a hundredth (one standard deviation).

For each kind the share of 95 % intervals that contain the truth, with Wilson's interval of that share, by profile likelihood, by
covariance and by bootstrap (fewer throws: it repeats each fit 200 times), for χ and for the initial conditions; and the share of
throws in which an effect was accepted although no throw has any.

`--page` writes the table as a page of the documents.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from measuring import write_table
from numpy.typing import NDArray
from scipy.stats import binomtest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "helpers"))

from random_throws import state_difference
from throws import DICE, FPS, random_release, roughly_measured, seen, true_throw

from diethrow.executors import one_thread
from diethrow.fitting.results import Choices, Fit, IntervalMethod
from diethrow.fitting.throw import fit_throw
from diethrow.model.die import Die
from diethrow.model.laws import SmoothImpact
from diethrow.model.rotations import quat_from_rotvec, quat_multiply
from diethrow.model.throw import Throw, Until, throw_die
from diethrow.tracking.track import Track

Array = NDArray[np.float64]

Z95 = 1.959964
KINDS = {
    "white": "white",
    "ar2": "correlated over 2 frames",
    "ar5": "correlated over 5 frames",
    "ar20": "correlated over 20 frames",
    "positions": "positions correlated over 5 frames, rotations white",
    "tails": "heavy tails: Student's t, 3 degrees of freedom",
    "outliers": "3 % of the frames ten times off",
    "law": "χ of each impact off by 0.01 (one standard deviation)",
}
CORRELATED_FRAMES = {"ar2": 2.0, "ar5": 5.0, "ar20": 20.0}
METHODS: tuple[IntervalMethod, ...] = ("profile", "covariance", "bootstrap")
BOOTSTRAP_SHARE = 0.2
"""Of the throws, whose intervals are bootstrapped as well."""
CHI_SCATTER = 0.01
STATE = ("position", "rotation", "velocity", "angular velocity")
FRAMES_AFTER = 60


def unit_errors(kind: str, n: int, rng: np.random.Generator) -> Array:
    """Errors (n, 6) of unit variance before they get the size that the covariances state."""
    white = rng.standard_normal((n, 6))
    if kind == "tails":
        return np.asarray(rng.standard_t(3.0, (n, 6)) / np.sqrt(3.0))
    if kind == "outliers":
        return np.where(rng.random((n, 1)) < 0.03, 10.0, 1.0) * white
    if kind in CORRELATED_FRAMES:
        return correlated(white, CORRELATED_FRAMES[kind])
    if kind == "positions":
        white[:, :3] = correlated(white[:, :3], 5.0)
    return white


def correlated(white: Array, frames: float) -> Array:
    """AR(1) with the same variance, whose correlation falls to 1/e over so many frames."""
    keep, errors = np.exp(-1.0 / frames), white.copy()
    for k in range(1, len(errors)):
        errors[k] = keep * errors[k - 1] + np.sqrt(1.0 - keep**2) * white[k]
    return errors


def scattered_throw(die: Die, chi: float, impacts: int, rng: np.random.Generator) -> Throw:
    """A throw whose impacts have each a χ of its own, around the one stated."""
    state, flights, struck = random_release(die, rng), [], []
    for _ in range(impacts):
        own = float(np.clip(chi + CHI_SCATTER * rng.standard_normal(), 0.01, 0.99))
        part = throw_die(die, state, SmoothImpact(own), until=Until(impacts=1)).throw
        flights.append(part.flights[0])
        struck.append(part.impacts[0])
        state = part.flights[1].start
    whole = throw_die(die, state, SmoothImpact(chi), until=Until(impacts=1)).throw
    last = whole.flights[0]
    flights.append(replace(last, end_s=min(last.end_s, last.start.time_s + FRAMES_AFTER / FPS)))
    return Throw(tuple(flights), tuple(struck))


def observed(throw: Throw, kind: str, rng: np.random.Generator) -> Track:
    """The throw on every frame, with errors of this kind; the covariances state their size, not their correlation."""
    track = seen(throw, rng)
    positions, quaternions = throw.poses(track.time_s)
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(track.covariance), unit_errors(kind, len(track), rng))
    turned = quat_multiply(quat_from_rotvec(errors[:, 3:]), quaternions)
    return replace(track, position_m=positions + errors[:, :3], quaternion=turned)


def one(seed: int, kind: str, methods: Sequence[IntervalMethod]) -> dict[str, Any] | None:
    """One throw: which intervals contain the truth; None where χ is not determined."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind), 27])
    die, chi, impacts = DICE[seed % 3], rng.uniform(0.1, 0.95), int(rng.integers(1, 5))
    if kind == "law":
        throw = scattered_throw(die, chi, impacts, rng)
    else:
        throw = true_throw(die, random_release(die, rng), chi, impacts=impacts, frames_after=FRAMES_AFTER)
    track, measured = observed(throw, kind, rng), roughly_measured(throw, rng)
    with one_thread():
        fits = {method: fit_throw(track, measured, die, choices=Choices(method)) for method in methods}
    first = fits[methods[0]]
    if first.parameters["chi"].value is None or first.initial is None or not first.bounces_fitted:
        return None
    errors = state_difference(first.initial, throw.flights[0].at(first.initial.time_s))
    assert first.initial_covariance is not None
    own = np.sqrt(np.diag(first.initial_covariance))
    return {
        "chi": {method: holds(fit, chi) for method, fit in fits.items()},
        "state": (np.abs(errors) <= Z95 * own).tolist(),
        "effect": bool([name for name in first.chosen if name != "smooth impact"]),
    }


def holds(fit: Fit, chi: float) -> bool | None:
    """Whether the interval of χ contains it; None without an interval."""
    found = fit.parameters["chi"]
    return None if found.low is None or found.high is None else bool(found.low <= chi <= found.high)


def share(hits: Sequence[bool]) -> str:
    """`95.2 % (92.9 to 96.8), n = 412`."""
    if not hits:
        return "–"
    low, high = binomtest(sum(hits), len(hits)).proportion_ci(method="wilson")
    return f"{100 * np.mean(hits):.1f} % ({100 * low:.1f} to {100 * high:.1f}), n = {len(hits)}"


def row(kind: str, results: Sequence[dict[str, Any]]) -> list[str]:
    """The cells of one kind of noise."""
    chi = {m: [r["chi"][m] for r in results if r["chi"].get(m) is not None] for m in METHODS}
    state = np.array([r["state"] for r in results])
    parts = [f"{100 * state[:, 3 * k : 3 * k + 3].mean():.1f}" for k in range(4)]
    effects = [bool(r["effect"]) for r in results]
    return [KINDS[kind], *(share(chi[method]) for method in METHODS), " / ".join(parts), share(effects)]


HEADS = [
    "errors",
    "χ, profile",
    "χ, covariance",
    "χ, bootstrap",
    f"{', '.join(STATE)} [%]",
    "effects accepted, of none",
]


def main() -> None:
    """The whole table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("throws", type=int, nargs="?", default=400)
    parser.add_argument("--kind", choices=list(KINDS), action="append", help="only these kinds of errors")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--page", type=Path, help="write the table into this page, between its marks")
    options = parser.parse_args()
    rows, bootstrapped = [], int(BOOTSTRAP_SHARE * options.throws)
    with ProcessPoolExecutor(options.workers) as pool:
        for kind in options.kind or KINDS:
            methods = [METHODS if seed < bootstrapped else METHODS[:2] for seed in range(options.throws)]
            work = pool.map(one, range(options.throws), [kind] * options.throws, methods, chunksize=2)
            rows.append(row(kind, [result for result in work if result is not None]))
            print(" | ".join(rows[-1]), flush=True)
    if options.page:
        write_table(options.page, Path(__file__).name, HEADS, rows)


if __name__ == "__main__":
    main()
