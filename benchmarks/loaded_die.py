"""Detection of a loaded die from one throw: `python benchmarks/loaded_die.py [throws]`.

A cube of 16 mm whose centre of mass lies 0.2 mm off its centroid, in a random direction of the body, through three
bounces with the noise of `tests/helpers/throws.py`; and as many fair cubes. Printed: how many of the loaded ones are
detected, the errors of their centre of mass, the coverage of its intervals, and how many fair ones are taken for loaded.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "helpers"))

from throws import random_release, roughly_measured, seen, true_throw

from diethrow.fitting.free.loaded_die import CENTRE_OF_MASS
from diethrow.fitting.throw.throw_fit import fit_throw
from diethrow.model.die.die import make_die

CUBE = make_die("cube", 0.016, 0.0048)
OFF_M = 2e-4


def one(seed: int, loaded: bool) -> tuple[bool, bool, float, list[bool]]:
    """Whether any bounce was fitted, whether the die was found loaded, the error [m] of its centre of mass, and which of the
    three intervals contain it."""
    rng = np.random.default_rng(seed)
    direction = rng.standard_normal(3)
    centre = OFF_M * direction / np.linalg.norm(direction)
    die = replace(CUBE, centre_of_mass_m=centre) if loaded else CUBE
    throw = true_throw(die, random_release(CUBE, rng), rng.uniform(0.3, 0.8), impacts=3)
    fit = fit_throw(seen(throw, rng), roughly_measured(throw, rng), CUBE)
    fitted = fit.bounces_fitted > 0
    if "loaded die" not in fit.chosen:
        return fitted, False, np.nan, []
    found = [fit.parameters[name] for name in CENTRE_OF_MASS]
    holds = [
        p.low is not None and p.high is not None and p.low <= c <= p.high for p, c in zip(found, centre, strict=True)
    ]
    off = np.array([np.nan if p.value is None else p.value for p in found]) - centre
    return fitted, True, float(np.linalg.norm(off)), holds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("throws", type=int, nargs="?", default=100)
    count = parser.parse_args().throws
    with ProcessPoolExecutor() as pool:
        loaded = list(pool.map(partial(one, loaded=True), range(count)))
        fair = list(pool.map(partial(one, loaded=False), range(count)))
    bounced = [result for result in loaded if result[0]]
    detected = [result for result in bounced if result[1]]
    errors_mm = 1e3 * np.array([error for _, _, error, _ in detected])
    holds = np.array([h for _, _, _, hold in detected for h in hold])
    print(f"loaded, a bounce fitted: {len(bounced)} of {count}; found loaded: {len(detected)}")
    print(
        f"error of the centre of mass: median {np.median(errors_mm):.4f} mm, 95 % {np.quantile(errors_mm, 0.95):.4f} mm,"
    )
    print(f"    within 0.02 mm in {np.mean(errors_mm <= 0.02):.0%}; intervals that contain it: {holds.mean():.1%}")
    print(f"fair, found loaded: {sum(result[1] for result in fair)} of {count}")


if __name__ == "__main__":
    main()
