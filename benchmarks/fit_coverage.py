"""How often the fit's intervals hold, over many simulated throws: `python benchmarks/fit_coverage.py [throws]`.

Cubes, tetrahedra and icosahedra with χ from 0.2 to 0.9 and one to five bounces, seen with white noise of the stated
covariance and again with noise that stays alike over a few frames. Prints, for each: how many bounces were explained,
coverage of χ's 95 % interval, median error of χ and half width, mean NEES of the twelve initial conditions (ideal 12),
and seconds a fit.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from throws import blurred_in_time, initial_errors, random_release, roughly_measured, seen, true_throw

from diethrow.fitting.whole_throw import fit_throw
from diethrow.model.solids import make_die

DICE = (
    make_die("cube", 0.016, 0.0048),
    make_die("tetrahedron", 0.022, 0.0015),
    make_die("icosahedron", 0.0105, 0.003),
)


def study(throws: int, frames_alike: float) -> None:
    """One line of results."""
    held, errors, widths, nees, explained, possible, seconds = [], [], [], [], 0, 0, []
    for seed in range(throws):
        rng = np.random.default_rng(seed)
        die, chi, bounces = DICE[seed % 3], rng.uniform(0.2, 0.9), int(rng.integers(1, 6))
        throw = true_throw(die, random_release(die, rng), chi, impacts=bounces)
        track = seen(throw, rng)
        if frames_alike > 0.0:
            track = blurred_in_time(track, throw, rng, frames_alike)
        began = time.perf_counter()
        fit = fit_throw(track, roughly_measured(throw, rng), die)
        seconds.append(time.perf_counter() - began)
        found = fit.parameters["chi"]
        explained, possible = explained + fit.bounces_fitted, possible + len(throw.impacts)
        if found.value is None or fit.initial is None:
            print(f"  throw {seed}: chi {chi:.3f} not determined: {fit.messages}")
            continue
        held.append(found.low <= chi <= found.high)
        errors.append(abs(found.value - chi))
        widths.append((found.high - found.low) / 2.0)
        error = initial_errors(fit.initial, throw.flights[0].at(fit.initial.time_s))
        nees.append(float(error @ np.linalg.solve(fit.initial_covariance, error)))
        if not held[-1] or fit.bounces_fitted < len(throw.impacts):
            print(
                f"  throw {seed}: chi {chi:.4f}, {found.low:.4f} to {found.high:.4f}; {fit.bounces_fitted} of {bounces}"
            )
    print(
        f"frames alike {frames_alike:g}: bounces {explained}/{possible}, coverage {np.mean(held):.3f} of {len(held)}, "
        f"|error| {np.median(errors):.2g}, half width {np.median(widths):.2g}, "
        f"NEES mean {np.mean(nees):.1f} median {np.median(nees):.1f}, "
        f"{np.median(seconds):.2f} s (worst {max(seconds):.2f})"
    )


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    study(count, 0.0)
    study(count, 4.0)
