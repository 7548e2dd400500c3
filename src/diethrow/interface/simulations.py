"""The model alone as values: one throw, the odds of the faces, a map of basins; with tables and plots, and without files.

    >>> import diethrow as dt
    >>> cube = dt.make_die("cube", 0.016, 0.0048)
    >>> one = dt.throw(cube, dt.SmoothImpact(0.5), dt.State(0.0, [0, 0, 0.1], [1, 0.2, 0.1, 0.3], [0, 0, -1], [20, 5, 3]))
    >>> one.landed_face
    2

A quaternion need not have length 1; it is divided by its length.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..model.die import Die
from ..model.ensembles import (
    FIG_6_CONDITIONS,
    HEIGHT_EDGES,
    Axis,
    Conditions,
    Tally,
    ThrowSetup,
    UniformConditions,
    Window,
    check_releases,
    map_rows,
    tally_throws,
)
from ..model.laws import LEVEL, ImpactLaw, Table
from ..model.throw import Ending, State, Throw, Until, throw_die

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


PLAYED_HZ = 1000.0
"""Poses per second of a throw that plays in a notebook."""
LEAST_PLAYED = 10.0
"""Poses of one that lasts less than as many milliseconds."""


@dataclass(frozen=True, eq=False)
class SimulatedThrow:
    """One throw of the model."""

    die: Die
    throw: Throw
    """Flights joined by impacts."""
    ending: Ending
    """Why it ended."""
    landed_face: int | None
    """Number of the face of rest; None without one."""

    @cached_property
    def bounces(self) -> pd.DataFrame:
        """The impacts, one row each."""
        from .tables import bounces_table

        return bounces_table(self.throw.bounces)

    def poses(self, rate_hz: float = 1500.0) -> pd.DataFrame:
        """Positions and quaternions at a rate [Hz], from the release to the end."""
        from ..replay.elements import track_of
        from .tables import frames_table

        return frames_table(track_of(self.throw, rate_hz))

    def plot_heights(self, ax: Axes | None = None) -> Axes:
        """Height of every corner over time."""
        from ..replay.figures import throw_heights

        return throw_heights(_axes(ax), self.die.solid, self.throw)

    def _repr_html_(self) -> str:
        """The throw, to be played in a notebook; its summary if it lasts no time."""
        from ..replay.elements import motion_of, track_of
        from ..replay.player import player_alone

        lasts_s = self.throw.flights[-1].end_s - self.throw.flights[0].start.time_s
        if lasts_s <= 0.0:
            return escape(repr(self))
        motion = motion_of("simulated", track_of(self.throw, max(PLAYED_HZ, LEAST_PLAYED / lasts_s)), self.throw)
        return player_alone(self.die.solid, [motion], self.throw.bounces)

    def __repr__(self) -> str:
        where = "on no face" if self.landed_face is None else f"on face {self.landed_face}"
        return f"<SimulatedThrow of a {self.die.solid.name}: {len(self.throw.bounces)} bounces, {where}>"


@dataclass(frozen=True, eq=False)
class Odds:
    """Counts of many throws."""

    die: Die
    tally: Tally

    @cached_property
    def faces(self) -> pd.DataFrame:
        """One row a face: count, share of all throws, and Wilson's interval of 95 %."""
        import pandas as pd

        from ..model.ensembles import Share

        shares = [Share(int(count), self.tally.throws) for count in self.tally.landed]
        rows = [(k + 1, one.count, one.value, *one.interval) for k, one in enumerate(shares)]
        return pd.DataFrame(rows, columns=["face", "count", "share", "low", "high"]).set_index("face")

    def plot(self, ax: Axes | None = None) -> Axes:
        """The shares with their intervals."""
        from ..model.ensembles import Share
        from ..replay.figures import face_odds

        shares = [Share(int(count), self.tally.throws) for count in self.tally.landed]
        return face_odds(_axes(ax), {self.die.solid.name: shares})

    def __repr__(self) -> str:
        shares = ", ".join(f"{count / self.tally.throws:.4f}" for count in self.tally.landed)
        return f"<Odds of {self.tally.throws} throws of a {self.die.solid.name}: {shares}>"


@dataclass(frozen=True, eq=False)
class Basins:
    """The face on which the die lands, over a plane of release conditions."""

    die: Die
    x: Axis
    y: Axis
    face: NDArray[np.uint16]
    """(rows, columns) numbers of the faces, 0 for none; rows along y, columns along x, both increasing."""
    impacts: NDArray[np.int32]
    """(rows, columns) impacts until the face was decided."""
    ending: NDArray[np.int8]
    """(rows, columns) index into `model.ensembles.ENDING_OF_INDEX`; -1 for a release below the table."""

    def plot(self, ax: Axes | None = None) -> Axes:
        """The map, in the colours of the faces."""
        from ..replay.figures import basin_map

        return basin_map(_axes(ax), self.x, self.y, self.face, self.ending, len(self.die.solid.faces))


def throw(
    die: Die,
    law: ImpactLaw,
    release: State,
    *,
    table: Table = LEVEL,
    until: Until | None = None,
    drag_per_m: float = 0.0,
) -> SimulatedThrow:
    """Throw a die once, against the drag -k |v| v of the air if `drag_per_m`, k [1/m], is given.

    Raises ValueError for an impossible release, and for a die that no kernel follows with this law or against drag.
    """
    quaternion = np.asarray(release.quaternion, float)
    start = State(
        float(release.time_s),
        np.asarray(release.position_m, float),
        quaternion / np.linalg.norm(quaternion),
        np.asarray(release.velocity_m_s, float),
        np.asarray(release.omega_rad_s, float),
    )
    result = throw_die(die, start, law, until=until or Until(), table=table, drag_per_m=drag_per_m)
    return SimulatedThrow(die, result.throw, result.ending, result.landed_face)


def odds(
    die: Die,
    law: ImpactLaw,
    *,
    throws: int = 100_000,
    releases: Conditions | None = None,
    table: Table = LEVEL,
    drag_per_m: float = 0.0,
    seed: int = 1,
    threads: int = 1,
) -> Odds:
    """Throw a die many times and count the faces.

    `releases` is their distribution: without one any orientation, a height of 15 to 20 edges, at rest. The counts depend on
    `seed` alone, not on `threads`. Raises ValueError for releases below the table. `drag_per_m` as of `throw`.

    >>> import diethrow as dt
    >>> dt.odds(dt.make_die("cube", 0.016, 0.0048), dt.SmoothImpact(0.5), throws=1000).tally.rested
    1000
    """
    edge_m = die.solid.edge_m
    drawn = releases or UniformConditions(0.0, (HEIGHT_EDGES[0] * edge_m, HEIGHT_EDGES[1] * edge_m))
    setup = ThrowSetup(die, law, table, drag_per_m=drag_per_m)
    check_releases(setup, drawn)
    *_, tally = tally_throws(setup, drawn, throws, seed, threads=threads)
    return Odds(die, tally)


def basins(
    die: Die,
    law: ImpactLaw,
    x: Axis,
    y: Axis,
    *,
    fixed: dict[str, float] | None = None,
    table: Table = LEVEL,
    drag_per_m: float = 0.0,
    threads: int = 1,
) -> Basins:
    """Throw a die from every point of a plane of conditions; `fixed` holds the others (that of the paper's Fig. 6 by default).

    Raises ValueError for conditions that are named twice or not at all."""
    window = Window(x, y, dict(FIG_6_CONDITIONS if fixed is None else fixed))
    shape = (y.pixels, x.pixels)
    face, impacts, ending = np.zeros(shape, np.uint16), np.zeros(shape, np.int32), np.zeros(shape, np.int8)
    setup = ThrowSetup(die, law, table, drag_per_m=drag_per_m)
    for low, high, landings in map_rows(setup, window, threads=threads):
        part = (high - low, x.pixels)
        face[low:high] = landings.face.reshape(part)
        impacts[low:high] = landings.impacts.reshape(part)
        ending[low:high] = landings.ending.reshape(part)
    return Basins(die, x, y, face, impacts, ending)


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt

    return plt.subplots(layout="constrained")[1]
