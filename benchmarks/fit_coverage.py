"""Coverage of the fit's intervals: `python benchmarks/fit_coverage.py [throws] [--worst] [--out FILE.json]`.

Simulated tracks with χ from 0.1 to 0.95 and one to four bounces, of cubes, tetrahedra and icosahedra in turn, at three
levels of noise: a quarter of, equal to and four times that of `tests/helpers/throws.py` (0.02 mm across and 0.15 mm along
the line of sight, 0.1 degrees). One row a level, for χ and for each kind of initial condition: the share of 95 % intervals
that contain the truth, and their mean width over that of the Cramér-Rao bound at the truth, with the stated covariances and
the true vertices. Then the effects accepted although no throw has any, bounces explained of all, tracks that determine
nothing, and processor time a fit.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "helpers"))

from random_throws import state_difference
from throws import DICE, random_release, roughly_measured, seen, true_throw

from diethrow.fitting.estimation.observations import flight_observations, pose_errors, whitened_jacobian
from diethrow.fitting.throw.physics import Physics, model_poses
from diethrow.fitting.throw.throw_fit import fit_throw
from diethrow.model.die.die import Die
from diethrow.model.laws import LEVEL
from diethrow.model.throw.motion import Throw
from diethrow.tracking.track import Track

Array = NDArray[np.float64]

NOISES = (0.25, 1.0, 4.0)
KINDS = ("position", "rotation", "velocity", "angular velocity")
Z95 = 1.959964


def bound(track: Track, throw: Throw, die: Die, chi: float, explained: int, time_s: float) -> Array:
    """Cramér-Rao sigmas (13,) of the state at `time_s` and χ from the frames up to the end of flight `explained`."""
    observations = flight_observations(track, throw)
    observations = observations.where(observations.flight <= explained)
    physics = Physics(die, LEVEL, {"chi": chi})
    vertices = tuple(impact.vertices[0] for impact in throw.impacts[:explained])
    modelled = model_poses(physics, throw.flights[0].at(time_s), observations.time_s, vertices)
    errors = pose_errors(observations, modelled.positions_m, modelled.quaternions)
    jacobian = whitened_jacobian(observations, errors, modelled.jacobian).reshape(-1, 13)
    scale = np.linalg.norm(jacobian, axis=0)
    return np.linalg.norm(np.linalg.inv(np.linalg.qr(jacobian / scale, mode="r")), axis=1) / scale


def one(seed: int, noise: float) -> dict[str, object] | None:
    """One throw: which intervals contain the truth, and their widths over the bound; None if χ is not determined."""
    rng = np.random.default_rng([seed, int(100 * noise)])  # another throw at each level
    die, chi = DICE[seed % 3], rng.uniform(0.1, 0.95)
    throw = true_throw(die, random_release(die, rng), chi, impacts=int(rng.integers(1, 5)))
    track, measured = seen(throw, rng, noise=noise, stated=noise), roughly_measured(throw, rng)
    began = time.process_time()
    fit = fit_throw(track, measured, die)
    seconds = time.process_time() - began
    found = fit.parameters["chi"]
    if found.value is None or fit.initial is None or fit.initial_covariance is None or not fit.bounces_fitted:
        return None
    sigma = bound(track, throw, die, chi, fit.bounces_fitted, fit.initial.time_s)
    errors = state_difference(fit.initial, throw.flights[0].at(fit.initial.time_s))
    own = np.sqrt(np.diag(fit.initial_covariance))
    return {
        "seed": seed,
        "chi": bool(found.low <= chi <= found.high),
        "chi_width": float((found.high - found.low) / (2.0 * Z95 * sigma[12])),
        "state": (np.abs(errors) <= Z95 * own).tolist(),
        "state_width": (own / sigma[:12]).tolist(),
        "effects": [name for name in fit.chosen if name != "smooth impact"],
        "explained": fit.bounces_fitted,
        "bounces": len(throw.impacts),
        "seconds": seconds,
        "error_sigmas": float((found.value - chi) / sigma[12]),
    }


def study(throws: int, noise: float, pool: ProcessPoolExecutor, worst: bool) -> dict[str, object]:
    """All throws of one level of noise: prints the summary and returns the results."""
    results = [r for r in pool.map(one, range(throws), [noise] * throws, chunksize=5) if r is not None]
    chi = np.array([r["chi"] for r in results])
    widths = np.array([r["chi_width"] for r in results])
    state, state_width = np.array([r["state"] for r in results]), np.array([r["state_width"] for r in results])
    print(f"noise {noise:g}: {len(results)} of {throws} tracks determine chi")
    print(
        f"  chi               covers {100 * chi.mean():5.1f} %   width {widths.mean():.3f} (median {np.median(widths):.3f})"
    )
    for k, kind in enumerate(KINDS):
        part = slice(3 * k, 3 * k + 3)
        print(f"  {kind:17} covers {100 * state[:, part].mean():5.1f} %   width {state_width[:, part].mean():.3f}")
    effects = Counter(name for r in results for name in r["effects"])
    seconds = np.array([r["seconds"] for r in results])
    explained, possible = sum(r["explained"] for r in results), sum(r["bounces"] for r in results)
    print(f"  effects chosen: {dict(effects) or 'none'}; bounces explained {explained} of {possible}")
    print(f"  processor time a fit: median {np.median(seconds):.2f} s, longest {seconds.max():.2f} s", flush=True)
    if worst:
        for r in sorted(results, key=lambda r: -abs(r["error_sigmas"]))[:8]:
            print(f"    {r}")
    return {"noise": noise, "results": results}


def main() -> None:
    """The whole table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("throws", type=int, nargs="?", default=500)
    parser.add_argument("--worst", action="store_true", help="print the throws with the largest errors of chi")
    parser.add_argument("--out", type=Path, help="all results as JSON")
    options = parser.parse_args()
    with ProcessPoolExecutor(2) as pool:
        studies = [study(options.throws, noise, pool, options.worst) for noise in NOISES]
    if options.out:
        options.out.write_text(json.dumps(studies))


if __name__ == "__main__":
    main()
