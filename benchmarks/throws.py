"""Speed and exactness of simulated throws: `python benchmarks/throws.py`, some minutes; `--help` lists the parts.

Unless a table says otherwise, a throw is the sharp cube of 2 cm and 16 g, released at rest 0.3 m above the table, uniformly
turned, with 40 rad/s about a uniformly random axis, with smooth impacts, until its face is decided. The other dice have the
cube's volume and mass.

speed       throws a second by χ: on one core by CPU time, and with threads over blocks of 1024 throws by the clock. One
            thread and several take turns on the same throws, and the ratio is taken within each round. Medians and
            ranges. On a busy machine the threads do not get all cores: how many they had is printed too, and no ratio
            can be larger. Compilation is timed separately, in a process without a cache.
dice        throws a second on one core for the five dice, and impacts a throw.
root        throws whose landed face changes if a vertex touches at 1e-11 m instead of 1e-13 m; at 1e-13 m instead of
            rounding alone; and if the last bit of the release height flips, which no setting can undo.
            `benchmarks/decidability.py` checks whether those throws are found not decidable.
switch      the same for the speed below which a vertex is held instead of bouncing on [√(g R)], against the finest,
            with the throws a second. Then the differences of the last orientation, median and 99th percentile over
            the throws that end at the same event: a setting that changes no more than the last bit does costs nothing.
turn        the same for the step of the integration of held contact [rad].
energy      largest relative error of the energy after 1e5 impacts at χ = 1, over some throws of each die.
endings     how throws end, for each die and χ, over more varied releases than the others: up to 1 m above the table, up
            to 2 m/s in each direction, up to 100 rad/s. The cap on impacts must never be what ends them.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path

import numpy as np
from measuring import spread
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from diethrow.model import engine
from diethrow.model.die.die import Die, make_die
from diethrow.model.die.solid import SHAPES
from diethrow.model.ensembles.landings import ENDING_OF_INDEX, ThrowSetup
from diethrow.model.laws import SmoothImpact
from diethrow.model.throw.body import body_of
from diethrow.model.throw.simulate import EXACT, IMPACT_CAP, Ending, Precision

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

EDGE_M = 0.02
MASS_KG = 0.016
HEIGHT_M = 0.3
SPIN_RAD_S = 40.0
CHIS = (0.9, 0.7, 0.5, 0.3, 0.1, 0.0)
SETTING_CHIS = (0.7, 0.5, 0.3, 0.1, 0.0)
"""Above 0.7 nothing is held before the face is decided."""
BLOCK = 1024
SWITCHES = (1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
TURNS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
ENERGY_IMPACTS = 100_000
COMPARED_THROWS = 1000
"""Throws whose last orientations are compared."""
SAME_EVENT_S = 1e-4
"""[s] Last events nearer in time than this count as the same."""
ENDINGS = {
    "rest": Ending.RESTED,
    "spinning": Ending.SPINNING,
    "spun long": Ending.SPUN_LONG,
    "balanced": Ending.BALANCED,
    "cap": Ending.IMPACT_CAP,
}


@dataclass(frozen=True)
class Sizes:
    """Numbers of throws."""

    throws: int
    """For each figure of speed and of exactness."""
    endings: int
    """For each die and χ."""
    rounds: int
    """Of each figure of speed."""
    threads: int
    seed: int


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the requested parts; the exit status is 1 if a throw ended at the cap."""
    parts = {
        "speed": print_speed,
        "dice": print_dice,
        "root": print_root,
        "switch": print_switch,
        "turn": print_turn,
        "energy": print_energy,
        "endings": print_endings,
    }
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(parts)} (all)")
    parser.add_argument("--throws", type=int, default=10_000, help="for each figure (%(default)s)")
    parser.add_argument("--endings", type=int, default=20_000, help="throws for each die and χ (%(default)s)")
    parser.add_argument("--rounds", type=int, default=3, help="of each figure of speed (%(default)s)")
    parser.add_argument("--threads", type=int, default=2, help="(%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="(%(default)s)")
    chosen = parser.parse_args(arguments)
    unknown = [part for part in chosen.parts if part not in parts]
    if unknown:
        parser.error(f"no part {unknown[0]!r}: wanted some of {', '.join(parts)}")
    sizes = Sizes(chosen.throws, chosen.endings, chosen.rounds, chosen.threads, chosen.seed)
    land(CUBE, 0.5, releases(2, 0))  # compiles the kernels, or loads them from the cache
    capped = [parts[part](sizes) for part in chosen.parts or parts]
    return 1 if any(capped) else 0


# --- what is thrown ---------------------------------------------------------------------------------------------------


def die_of(shape: str) -> Die:
    """A die of the cube's volume and mass."""
    unit_volume = ConvexHull(make_die(shape, 1.0, 1.0).solid.vertices).volume
    return make_die(shape, EDGE_M / unit_volume ** (1 / 3), MASS_KG)


CUBE = die_of("cube")


def releases(count: int, seed: int) -> Array:
    """States (count, 13): at rest at the height, uniformly turned, spinning about uniform axes."""
    rng = np.random.default_rng(seed)
    states = np.zeros((count, 13))
    states[:, 2] = HEIGHT_M
    states[:, 3:7] = directions(rng, count, 4)
    states[:, 10:] = SPIN_RAD_S * directions(rng, count, 3)
    return states


def rough_releases(die: Die, count: int, seed: int) -> Array:
    """States (count, 13) of all heights, velocities and spins that `endings` names."""
    rng = np.random.default_rng(seed)
    states = np.zeros((count, 13))
    states[:, 2] = die.solid.circumradius + rng.uniform(0.0, 1.0, count)
    states[:, 3:7] = directions(rng, count, 4)
    states[:, 7:10] = rng.uniform(-2.0, 2.0, (count, 3))
    states[:, 10:] = rng.uniform(0.0, 100.0, (count, 1)) * directions(rng, count, 3)
    return states


def directions(rng: np.random.Generator, count: int, size: int) -> Array:
    """(count, size) uniform unit vectors."""
    drawn = rng.normal(size=(count, size))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1)[:, None])


def land(die: Die, chi: float, starts: Array, precision: Precision = EXACT) -> Counts:
    """(n, 3) number of the face or 0, impacts, and index of the ending of every throw, on this thread."""
    landings = ThrowSetup(die, SmoothImpact(chi), precision=precision).throw(starts)
    return np.stack([landings.face, landings.impacts, landings.ending], axis=1)


# The first throws without a cache, less the time of the same throws again.
COMPILE = """
import throws, time
times = []
for _ in range(2):
    began = time.process_time()
    throws.land(throws.CUBE, 0.5, throws.releases(2, 0))
    times.append(time.process_time() - began)
print(times[0] - times[1])
"""


def compile_seconds() -> float:
    """CPU time [s] of compiling in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        paths = os.pathsep.join(filter(None, [str(Path(__file__).parent), os.environ.get("PYTHONPATH")]))
        fresh = {**os.environ, "NUMBA_CACHE_DIR": folder, "PYTHONPATH": paths}
        done = subprocess.run([sys.executable, "-c", COMPILE], env=fresh, capture_output=True, text=True, check=True)
    return float(done.stdout)


# --- speed ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Timed:
    """Rates of simulated throws on a number of threads."""

    by_clock: float
    """Throws a second."""
    by_cpu: float
    """Throws a CPU second."""
    landed: Counts

    @property
    def cores(self) -> float:
        """Number of cores that the threads had, on average."""
        return self.by_clock / self.by_cpu


def timed(die: Die, chi: float, starts: Array, threads: int, precision: Precision = EXACT) -> Timed:
    """Throw all, in blocks, on a number of threads."""
    began, began_cpu = time.perf_counter(), time.process_time()
    landed = land_on_threads(die, chi, starts, precision, threads)
    clock_s, cpu_s = time.perf_counter() - began, time.process_time() - began_cpu
    return Timed(len(starts) / clock_s, len(starts) / cpu_s, landed)


def land_on_threads(die: Die, chi: float, starts: Array, precision: Precision, threads: int) -> Counts:
    """As `land`, in blocks on several threads."""
    blocks = [starts[k : k + BLOCK] for k in range(0, len(starts), BLOCK)]
    with ThreadPoolExecutor(threads) as pool:
        return np.concatenate(list(pool.map(lambda rows: land(die, chi, rows, precision), blocks)))


def print_speed(sizes: Sizes) -> bool:
    """Throws a second of the cube."""
    starts = releases(sizes.throws, sizes.seed)
    print(f"\nspeed: throws a second, cube; median (range) of {sizes.rounds} rounds of {sizes.throws} throws")
    print(
        f"{'χ':>4} {'impacts':>8} {'one core, CPU time':>24} {f'{sizes.threads} threads, by the clock':>24} "
        f"{'ratio by the clock':>20} {'the threads had':>16}"
    )
    for chi in CHIS:
        pairs = [(timed(CUBE, chi, starts, 1), timed(CUBE, chi, starts, sizes.threads)) for _ in range(sizes.rounds)]
        print(
            f"{chi:4.1f} {pairs[0][0].landed[:, 1].mean():8.1f} {spread([a.by_cpu for a, _ in pairs]):>24} "
            f"{spread([b.by_clock for _, b in pairs]):>24} {spread([b.by_clock / a.by_clock for a, b in pairs], 2):>20} "
            f"{np.median([b.cores for _, b in pairs]):>10.2f} cores",
            flush=True,
        )
    print(f"compiling, once for an installation: {compile_seconds():.1f} s of CPU time")
    return False


def print_dice(sizes: Sizes) -> bool:
    """Throws a second of the five dice."""
    starts = releases(sizes.throws, sizes.seed)
    print(f"\ndice: throws a CPU second (impacts a throw), median of {sizes.rounds} rounds of {sizes.throws} throws")
    print(f"{'':13}" + "".join(f"{f'χ {chi:g}':>16}" for chi in CHIS))
    for shape in SHAPES:
        die = die_of(shape)
        cells = []
        for chi in CHIS:
            rounds = [timed(die, chi, starts, 1) for _ in range(sizes.rounds)]
            cells.append(f"{np.median([r.by_cpu for r in rounds]):.0f} ({rounds[0].landed[:, 1].mean():.0f})")
        print(f"{shape:13}" + "".join(f"{cell:>16}" for cell in cells))
    return False


# --- exactness --------------------------------------------------------------------------------------------------------


def print_root(sizes: Sizes) -> bool:
    """Faces that depend on the contact tolerance."""
    starts = releases(sizes.throws, sizes.seed)
    print(f"\nroot: throws of {sizes.throws} whose landed face changes with the tolerance of the touch")
    print(f"{'χ':>4} {'1e-13 to 1e-11 m':>18} {'rounding to 1e-13 m':>20} {'last bit of the height':>24}")
    for chi in CHIS:
        exact = land_on_threads(CUBE, chi, starts, EXACT, sizes.threads)
        fine, coarse = (
            land_on_threads(CUBE, chi, starts, replace(EXACT, contact_tolerance_m=root), sizes.threads)
            for root in (1e-13, 1e-11)
        )
        flipped = land_on_threads(CUBE, chi, last_bit_flipped(starts), EXACT, sizes.threads)
        print(f"{chi:4.1f} {changed(fine, coarse):>18} {changed(exact, fine):>20} {changed(exact, flipped):>24}")
    return False


def print_switch(sizes: Sizes) -> bool:
    """Faces that depend on the speed at which vertices are held, and its cost."""
    print_settings("switch", [(f"{switch:g}", replace(EXACT, slowest_bounce=switch)) for switch in SWITCHES], sizes)
    return False


def print_turn(sizes: Sizes) -> bool:
    """Faces that depend on the step of held contact, and its cost."""
    print_settings("turn", [(f"{turn:g}", replace(EXACT, step_turn_rad=turn)) for turn in TURNS], sizes)
    return False


def print_settings(name: str, settings: Sequence[tuple[str, Precision]], sizes: Sizes) -> None:
    """Both tables of a setting; the first value is the finest."""
    starts = releases(sizes.throws, sizes.seed)
    heads = [head for head, _ in settings]
    print(f"\n{name}: throws of {len(starts)} whose landed face changes from that at {heads[0]}; throws a CPU second")
    print(f"{'χ':>4} {'last bit':>9}" + "".join(f"{head:>15}" for head in heads))
    for chi in SETTING_CHIS:
        # The settings take turns, so that a busy machine slows all of them.
        rounds = [[timed(CUBE, chi, starts, 1, setting) for _, setting in settings] for _ in range(sizes.rounds)]
        flipped = land(CUBE, chi, last_bit_flipped(starts), settings[0][1])
        finest = rounds[0][0].landed
        cells = [
            f"{changed(finest, runs[0].landed)}; {np.median([run.by_cpu for run in runs]):.0f}"
            for runs in zip(*rounds, strict=True)
        ]
        print(f"{chi:4.1f} {changed(finest, flipped):>9}" + "".join(f"{cell:>15}" for cell in cells), flush=True)
    print(f"\n{name}: angle [rad] between the last orientation and that at {heads[0]}; median, 99 %")
    print(f"{'χ':>4} {'last bit':>17}" + "".join(f"{head:>17}" for head in heads[1:]))
    compared = starts[:COMPARED_THROWS]
    for chi in SETTING_CHIS:
        finest = ends(chi, compared, settings[0][1])
        others = [
            ends(chi, last_bit_flipped(compared), settings[0][1]),
            *(ends(chi, compared, s) for _, s in settings[1:]),
        ]
        print(f"{chi:4.1f}" + "".join(f"{apart(finest, other):>17}" for other in others), flush=True)


def last_bit_flipped(starts: Array) -> Array:
    """The same releases, higher by one unit in the last place."""
    moved = starts.copy()
    moved[:, 2] = np.nextafter(moved[:, 2], np.inf)
    return moved


def changed(one: Counts, other: Counts) -> str:
    """Share of throws that land on another face, or on a face in one case only."""
    return f"{np.mean(one[:, 0] != other[:, 0]):.3%}"


def ends(chi: float, starts: Array, precision: Precision) -> list[tuple[float, Array]]:
    """Time [s] and state (13,) of the last event of each throw of the cube."""
    law = engine.law_of(engine.SMOOTH, np.array([chi]))
    setup = engine.Setup(body_of(CUBE), law, engine.LEVEL, precision.packed)
    limits = engine.Limits(inf, engine.NO_LIMIT, IMPACT_CAP, True)
    results = []
    for start in starts:
        _, _, _, time_s, state, _, _ = engine.run_throw(setup, start, 0.0, limits, False)
        results.append((time_s, state))
    return results


def apart(ones: Sequence[tuple[float, Array]], others: Sequence[tuple[float, Array]]) -> str:
    """Angles between last orientations of throws whose last event comes at the same time: median, 99th percentile."""
    angles = [
        2.0 * min(np.linalg.norm(one[3:7] - other[3:7]), np.linalg.norm(one[3:7] + other[3:7]))
        for (one_s, one), (other_s, other) in zip(ones, others, strict=True)
        if abs(one_s - other_s) < SAME_EVENT_S
    ]
    return f"{np.median(angles):.1e}, {np.percentile(angles, 99):.1e}"


# --- energy and endings -----------------------------------------------------------------------------------------------


def print_energy(sizes: Sizes) -> bool:
    """The error of the energy from rounding, with elastic impacts."""
    starts = releases(5, sizes.seed)
    print(f"\nenergy: largest relative error after {ENERGY_IMPACTS} impacts at χ = 1, {len(starts)} throws of each die")
    for shape in SHAPES:
        print(f"{shape:13} {max(energy_error(die_of(shape), start) for start in starts):.1e}", flush=True)
    return False


def energy_error(die: Die, start: Array) -> float:
    """Relative change of kinetic and potential energy, zero at the height of the table."""
    law = engine.law_of(engine.SMOOTH, np.array([1.0]))
    setup = engine.Setup(body_of(die), law, engine.LEVEL, engine.FINE)
    limits = engine.Limits(inf, ENERGY_IMPACTS, IMPACT_CAP, False)
    _, impacts, _, _, state, _, _ = engine.run_throw(setup, start, 0.0, limits, False)
    assert impacts == ENERGY_IMPACTS
    before, after = energy_J(die, start), energy_J(die, state)
    return abs(after - before) / before


def energy_J(die: Die, state: Array) -> float:
    """Kinetic and potential."""
    kinetic = 0.5 * die.mass_kg * state[7:10] @ state[7:10] + 0.5 * die.inertia_kg_m2 * state[10:] @ state[10:]
    return float(kinetic + die.mass_kg * engine.LEVEL.g * state[2])


def print_endings(sizes: Sizes) -> bool:
    """How throws of all dice end; True if any ended at the cap."""
    print(
        f"\nendings: of {sizes.endings} rough throws of each die and χ [%]; the most impacts of one; throws a CPU second"
    )
    print(f"{'':13} {'χ':>4}" + "".join(f"{name:>10}" for name in ENDINGS) + f"{'impacts':>10}{'throws/s':>10}")
    capped = False
    for shape in SHAPES:
        die = die_of(shape)
        starts = rough_releases(die, sizes.endings, sizes.seed)
        for chi in CHIS:
            run = timed(die, chi, starts, sizes.threads)
            count = {name: int((run.landed[:, 2] == ENDING_OF_INDEX.index(e)).sum()) for name, e in ENDINGS.items()}
            assert sum(count.values()) == sizes.endings
            capped |= count["cap"] > 0
            shares = "".join(f"{100 * number / sizes.endings:10.3f}" for number in count.values())
            most, rate = run.landed[:, 1].max(), run.by_cpu
            print(f"{shape:13} {chi:4.1f}{shares}{most:10d}{rate:10.0f}", flush=True)
    return capped


if __name__ == "__main__":
    sys.exit(main())
