"""Processor time of a fit: `python benchmarks/fit_time.py [throws]`.

Simulated tracks of a cube at χ = 0.8 through six bounces, smooth and with μ = 0.2, thinned to about 300 frames, with the
noise of `tests/helpers/throws.py`. Printed for each law: processor time of a fit with its intervals, after compilation and
with one thread of linear algebra, and the largest errors of χ and μ.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "helpers"))

from measuring import timed
from throws import thrown

from diethrow.executors import one_thread
from diethrow.fitting.throw.throw_fit import fit_throw
from diethrow.model.die.die import make_die
from diethrow.model.laws import CoulombImpact, SmoothImpact
from diethrow.model.throw.motion import Throw
from diethrow.tracking.track import Track

CUBE = make_die("cube", 0.016, 0.0048)
CHI = 0.8
MU = 0.2
BOUNCES = 6
FRAMES = 300


def thinned(law: SmoothImpact | CoulombImpact, seed: int) -> tuple[Track, Throw]:
    """A track of about `FRAMES` frames, and its measured throw."""
    track, measured = thrown(CUBE, law, seed, impacts=BOUNCES)
    columns = (track.frame, track.time_s, track.position_m, track.quaternion, track.covariance, track.status)
    step = max(1, round(len(track) / FRAMES))
    return Track(*(column[::step] for column in columns)), measured


def main() -> None:
    """Times the fits of both laws, and prints the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("throws", type=int, nargs="?", default=12)
    count = parser.parse_args().throws
    with one_thread():
        measure(count)


def measure(count: int) -> None:
    """Fits `count` throws of each law."""
    for law in (SmoothImpact(CHI), CoulombImpact(CHI, MU)):
        fit_throw(*thinned(law, count), CUBE)  # compiles
        seconds, off = [], []
        for seed in range(count):
            fit, spent = timed(partial(fit_throw, *thinned(law, seed), CUBE))
            seconds.append(spent)
            found = {name: p.value for name, p in fit.parameters.items() if p.value is not None}
            off.append([found.get("chi", np.nan) - CHI, found.get("mu", MU) - MU])
        worst = np.abs(off).max(0)
        print(
            f"{type(law).__name__}: median {np.median(seconds):.2f} s, longest {max(seconds):.2f} s; "
            f"largest errors {worst[0]:.1g} of chi, {worst[1]:.1g} of mu",
            flush=True,
        )


if __name__ == "__main__":
    main()
