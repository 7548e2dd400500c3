"""Which throws are decidable in double precision: `python benchmarks/decidability.py [throws] [seed]`, 100 000 throws of each χ.

The 2 cm, 16 g cube from 0.3 m, with uniform orientations, 40 rad/s about uniform directions and no velocity. Every throw is
made with a contact tolerance of 1e-13 m and of 1e-11 m. Those that land on another face must be among the ones found not
decidable at 1e-11 m. Prints, for each χ: the share that lands on the same face; the share not decidable at 1e-11 m and at
the default tolerance (rounding); how many of the changed throws were missed (the wanted number is 0); and processor
microseconds a throw, without and with its decidability.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from throws import releases

from diethrow.model.die.die import make_die
from diethrow.model.ensembles.chaos import decidable_in_double_precision_many
from diethrow.model.ensembles.landings import ThrowSetup
from diethrow.model.laws import SmoothImpact
from diethrow.model.throw.simulate import EXACT, Precision

Array = NDArray[np.float64]
CHI = (0.1, 0.3, 0.5, 0.7)
BLOCK = 4096
THREADS = 2
CUBE = make_die("cube", 0.02, 0.016)


def in_blocks(work: Callable[[Array], Any], starts: Array) -> tuple[list[Any], float]:
    """Results of `work` on blocks of the starts, on threads, and the processor time [s]."""
    blocks = [starts[k : k + BLOCK] for k in range(0, len(starts), BLOCK)]
    began = time.process_time()
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(work, blocks)), time.process_time() - began


def faces(starts: Array, chi: float, precision: Precision) -> tuple[NDArray[np.int64], float]:
    """Numbers (n,) of the landed faces, and the processor time [s]."""

    def land(block: Array) -> NDArray[np.int64]:
        return ThrowSetup(CUBE, SmoothImpact(chi), precision=precision).throw(block).face

    parts, spent = in_blocks(land, starts)
    return np.concatenate(parts), spent


def decidability(starts: Array, chi: float, precision: Precision) -> tuple[NDArray[np.int64], NDArray[np.bool_], Array]:
    """`decidable_in_double_precision_many` for the cube."""
    return decidable_in_double_precision_many(ThrowSetup(CUBE, SmoothImpact(chi), precision=precision), starts)


def main(count: int, seed: int) -> None:
    """Print the table."""
    starts = releases(count, seed)
    fine, coarse = Precision(contact_tolerance_m=1e-13), Precision(contact_tolerance_m=1e-11)
    decidable_in_double_precision_many(ThrowSetup(CUBE, SmoothImpact(0.5)), starts[:2])
    faces(starts[:2], 0.5, EXACT)
    print(f"{count} throws each, seed {seed}")
    print(
        f"{'chi':>5} {'unchanged':>10} {'not decidable at 1e-11':>22} {'by rounding':>12} {'missed':>7} {'of':>6}     µs     µs"
    )
    for chi in CHI:
        before, plain = faces(starts, chi, fine)
        after, _ = faces(starts, chi, coarse)
        parts, spent = in_blocks(partial(decidability, chi=chi, precision=coarse), starts)
        decidable = np.concatenate([part[1] for part in parts])
        exact, _ = in_blocks(partial(decidability, chi=chi, precision=EXACT), starts)
        by_rounding = 1.0 - np.concatenate([part[1] for part in exact]).mean()
        changed = before != after
        assert (np.concatenate([part[0] for part in parts])[:, 0] + 1 == after).all()
        missed = int((changed & decidable).sum())
        print(
            f"{chi:5.2f} {1.0 - changed.mean():10.4%} {1.0 - decidable.mean():22.4%} {by_rounding:12.4%} {missed:7d} "
            f"{int(changed.sum()):6d} {plain / count * 1e6:6.1f} {spent / count * 1e6:6.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100_000, int(sys.argv[2]) if len(sys.argv) > 2 else 1)
