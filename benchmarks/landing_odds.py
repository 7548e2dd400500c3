"""Whether odds said in advance are right: `python benchmarks/landing_odds.py [throws] [--seed N]`.

Simulated throws of three dice with χ from 0.1 to 0.9 and the noise of `tests/helpers/throws.py`, seen until the flight after the
first, second or third bounce, fitted, and their landing predicted (`Fit.face_odds`, `Fit.landed_face`). Every face of every throw
is one forecast. A row for each range of odds: how many were said, their mean, and how often such a face came, with its 95 %
interval (Wilson). Where odds mean what they say, the mean lies within. Then the same for throws whose law is not the model's: χ
that fades with speed, which a fit may or may not notice; and the Brier score of both, beside that of equal odds for all faces.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "helpers"))

from throws import DICE, FPS, random_release, roughly_measured, seen

from diethrow.fitting.throw.throw_fit import fit_throw
from diethrow.model.ensembles.odds import Share
from diethrow.model.laws import RestitutionBySpeed, SmoothImpact
from diethrow.model.throw import Throw, throw_die

Array = NDArray[np.float64]

MOST_BOUNCES = 3
AFTER_FRAMES = 40
"""Most frames of the last flight that are seen."""
ENDS = (0.0, 1e-9, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0 - 1e-9, 1.0 + 1e-9)
"""Of the ranges of odds: none, between, certain."""
SPEED_SCALE_M_S = 6.0
"""Of a χ that fades: by a tenth at 0.6 m/s."""


@dataclass(frozen=True)
class Forecast:
    """What was said of one throw, and what came."""

    odds: Array
    """(faces,) 0 where the fit says nothing; they add up to 1."""
    landed: int
    """Row of the face."""


def forecast(seed: int, fades: bool) -> Forecast | None:
    """One throw; None where it does not land, has too few bounces, or its fit says nothing of the landing."""
    rng = np.random.default_rng([seed, fades])
    die, chi, bounces = DICE[seed % len(DICE)], float(rng.uniform(0.1, 0.9)), int(rng.integers(1, MOST_BOUNCES + 1))
    law = RestitutionBySpeed(SmoothImpact(chi), SPEED_SCALE_M_S) if fades else SmoothImpact(chi)
    whole = throw_die(die, random_release(die, rng), law)
    if whole.landed_face is None or len(whole.throw.bounces) <= bounces:
        return None
    last = whole.throw.flights[bounces]
    end_s = min(last.end_s, last.start.time_s + AFTER_FRAMES / FPS)
    shown = Throw((*whole.throw.flights[:bounces], replace(last, end_s=end_s)), whole.throw.impacts[:bounces])
    fit = fit_throw(seen(shown, rng), roughly_measured(shown, rng), die)
    said = {fit.landed_face: 1.0} if fit.landed_face is not None else fit.face_odds
    if not said:
        return None
    odds = np.array([said.get(face + 1, 0.0) for face in range(len(die.solid.faces))])
    return Forecast(odds, whole.landed_face - 1) if odds.sum() > 0.0 else None


def study(name: str, fades: bool, throws: int, seed: int, pool: ProcessPoolExecutor) -> None:
    """Print the table of one kind of throws."""
    tried = pool.map(forecast, range(seed, seed + throws), [fades] * throws, chunksize=4)
    made = [each for each in tried if each is not None]
    said = np.concatenate([each.odds for each in made])
    came = np.concatenate([np.arange(len(each.odds)) == each.landed for each in made])
    print(f"\n{name}: {len(made)} of {throws} throws with a forecast")
    print("odds said                faces     mean    came   95 %")
    for low, high in pairwise(ENDS):
        inside = (said >= low) & (said < high)
        if inside.any():
            share = Share(int(came[inside].sum()), int(inside.sum()))
            least, most = share.interval
            print(
                f"{low:6.3f} to {min(high, 1.0):6.3f}{inside.sum():14d}{said[inside].mean():9.3f}{share.value:8.3f}"
                f"   {least:.3f} to {most:.3f}"
            )
    brier = float(np.mean([((each.odds - (np.arange(len(each.odds)) == each.landed)) ** 2).sum() for each in made]))
    equal = float(np.mean([1.0 - 1.0 / len(each.odds) for each in made]))
    print(f"Brier score {brier:.3f}, of equal odds {equal:.3f}", flush=True)


def main() -> None:
    """Both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("throws", type=int, nargs="?", default=300)
    parser.add_argument("--seed", type=int, default=0, help="of the first throw; the others follow (%(default)s)")
    chosen = parser.parse_args()
    with ProcessPoolExecutor(2) as pool:
        study("smooth impacts of one restitution, as the model has them", False, chosen.throws, chosen.seed, pool)
        study("a restitution that fades with speed", True, chosen.throws, chosen.seed, pool)


if __name__ == "__main__":
    main()
