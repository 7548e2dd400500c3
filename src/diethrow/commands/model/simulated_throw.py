"""Simulate one throw from its release to its end, and write tables, a figure and a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...files.csv_and_json import write_json
from ...files.fit_records import state_table
from ...files.outputs import MIN_FREE_BYTES, check_free_space, whole_folder
from ...files.plan import Plan
from ...files.provenance import Stopwatch, write_provenance
from ...files.settings import refuse
from ...files.throw_records import simulated_track, write_bounces, write_simulated, write_vertices
from ...model.ensembles import ThrowSetup, decidable_in_double_precision
from ...model.throw import BodyKind, Ending, ThrowResult, Until, body_kind, throw_die
from ...replay.figures import throw_heights
from ...tracking.track import Track

REPLAY_ROW_BYTES = 2048
"""Upper limit of what one pose takes in a recording."""
MAX_ROWS = 10_000_000
"""Largest number of rows of simulated.csv; more indicate a wrong unit of `output.fps` or `until.time_s`."""
_STOPPED = (Ending.TIME_REACHED, Ending.IMPACTS_REACHED, Ending.IMPACT_CAP, Ending.BOUNCING)
"""Endings at a limit of the simulation, before the throw ends by itself."""


def throw(
    plan: Plan, out: Path, *, force: bool = False, embed_replay: bool = False, command: tuple[str, ...] = ()
) -> ThrowResult:
    """Simulate the throw of a plan and write it to the folder `out`; `embed_replay` adds a page that contains the viewer.

    Raises ValueError for an impossible release, OutputExistsError if the folder exists (unless `force`). After an error
    no folder remains.
    """
    watch = Stopwatch()
    with whole_folder(out, force=force, inputs=plan.inputs) as folder:
        with watch.stage("throw"):
            until = Until(time_s=plan.until_s, impacts=plan.until_impacts)
            result = throw_die(
                plan.die, plan.release, plan.law, until=until, table=plan.model_table, drag_per_m=plan.drag_per_m
            )
        with watch.stage("records"):
            write_vertices(folder / "vertices.csv", plan.die.solid)
            write_bounces(folder / "bounces.csv", result.throw.bounces)
            rows = rows_of(plan, result)
            write_simulated(folder / "simulated.csv", rows)
            table = throw_table(plan, result)
            write_json(folder / "throw.json", table)
        with watch.stage("figure"):
            draw_heights(folder / "heights.png", plan, result)
        with watch.stage("replay"):
            from ...replay.recording import write_throw_recording  # Rerun, which takes a third of a second to load

            check_free_space(folder, MIN_FREE_BYTES + REPLAY_ROW_BYTES * len(rows))
            write_throw_recording(folder / "replay.rrd", plan.die, result.throw, plan.fps, plan.path.stem)
            if embed_replay:
                from ...replay.pages import throw_page

                title, sentences = plan.path.stem, table["messages"]
                page = throw_page(title, plan.die, result.throw, plan.fps, sentences, folder / "replay.rrd")
                (folder / "replay.html").write_text(page, encoding="utf-8")
        write_provenance(folder, command=command, understood=plan, inputs=plan.inputs, seconds=watch.seconds)
    return result


UNDECIDED = "Whether this throw is decidable in double precision is unknown"
STOPPED_BEFORE = "the simulation stopped before its end"
OF_ONE_MOMENT = "it is computed for dice with one moment of inertia about their centroid"
IN_VACUUM = "it is computed for throws in vacuum"


def rows_of(plan: Plan, result: ThrowResult) -> Track:
    """The poses at t = k / fps, from the release to the end of the last flight."""
    end_s = result.throw.flights[-1].end_s
    count = int(np.floor(end_s * plan.fps + 1e-9)) + 1
    if count > MAX_ROWS:
        wanted = f"this gives {count} rows over {end_s:.3g} s; wanted at most {MAX_ROWS}"
        raise refuse(plan.path, "output.fps", plan.fps, wanted)
    frame = np.arange(count)
    return simulated_track(result.throw, frame, frame / plan.fps)


def throw_table(plan: Plan, result: ThrowResult) -> dict[str, Any]:
    """The contents of throw.json. Whether rounding decided the throw is null for one that stopped at a limit."""
    messages = [result.ending.value]
    if result.depends_on_numbering:
        messages.append(
            "Several corners touched at one instant and were struck one after the other: the result depends on the numbers of "
            "the corners."
        )
    if result.landed_face is None and result.ending is not Ending.RESTED:
        messages.append("Landing face unknown: the die is not at rest on a face when the throw ends.")
    ended = result.landed_face is not None or result.ending not in _STOPPED
    is_centred = body_kind(plan.die) is BodyKind.CENTRED
    unknown = OF_ONE_MOMENT if not is_centred else IN_VACUUM if plan.drag_per_m else None if ended else STOPPED_BEFORE
    setup = ThrowSetup(plan.die, plan.law, plan.model_table)
    check = decidable_in_double_precision(setup, plan.release) if unknown is None else None
    messages.append(check.sentence if check else f"{UNDECIDED}: {unknown}.")
    return {
        "landed_face": result.landed_face,
        "ending": result.ending.name.lower(),
        "impact_count": result.impact_count,
        "end": state_table(result.end),
        "decidable": check.decidable if check else None,
        "error_growth": check.error_growth if check else None,
        "error_m": check.error_m if check and np.isfinite(check.error_m) else None,
        "margin": check.margin if check and np.isfinite(check.margin) else None,
        "messages": messages,
    }


def draw_heights(path: Path, plan: Plan, result: ThrowResult) -> None:
    """Write the figure of the heights of all corners over time, with the impacts."""
    from matplotlib.figure import Figure  # a third of a second, after the first result

    figure = Figure(figsize=(9.0, 5.0), dpi=150, layout="constrained")
    throw_heights(figure.add_subplot(), plan.die.solid, result.throw)
    figure.savefig(path)
