"""Commands that work on folders: replay, report, rerun, watch; and warm-up, on the installation."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer

from .app import app
from .errors import CLIPS_KEPT, FAILED, one_sentence_errors, stopped_with
from .options import AsJson, EmbedReplay, Fineness, output_words
from .printing import batch_record, print_json, print_notices, print_throws
from .progress import progress_bars


@app.command(
    epilog="Examples:  diethrow replay out/cube_wood --open\n\n"
    "diethrow replay out/throw_1 out/throw_2 --out both.rrd --open     (several throws, or several models of one)\n\n"
    "diethrow replay out --out throws     (a folder of throws: one recording each, and a table)"
)
def replay(
    throws: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR...", help="Folders made by analyze, fit or throw, or a folder that holds such folders."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE.rrd|DIR",
            help="FILE.rrd: all throws in one recording. DIR: one recording per throw, and throws.csv. [default: neither]",
        ),
    ] = None,
    align: Annotated[
        Literal["bounce", "frame"],
        typer.Option("--align", help="Align the clocks at the first bounce, or at frame 0."),
    ] = "bounce",
    models: Annotated[
        bool | None,
        typer.Option(
            "--models/--throws",
            help="Several models of one throw, or several throws. [default: models if all come from one clip or track]",
            show_default=False,
        ),
    ] = None,
    look: Annotated[
        bool, typer.Option("--open", help="Open the viewer: without statistics, listening on localhost only.")
    ] = False,
    redraw: Annotated[
        bool,
        typer.Option(
            "--redraw", help="Draw each DIR/replay.rrd again from the tables beside it; one that is gone always is."
        ),
    ] = False,
    as_json: AsJson = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the output if it exists.")] = False,
) -> None:
    """Show throws: a table, one recording of several throws, or the viewer."""
    with one_sentence_errors():
        from ..commands.results.joined_recordings import RECORDING, find_recordings, gather, join

        for folder in throws:
            if (folder / "analysis.json").is_file() and (redraw or not (folder / RECORDING).exists()):
                _draw_recording(folder, folder / RECORDING)
        found = find_recordings(throws)
        if as_json:
            print_json({"throws": [{"name": one.name, **one.properties} for one in found]})
        else:
            print_throws(found)
        shown = [one.path for one in found]
        if out is not None and out.suffix == ".rrd":
            same = join(found, out, align=align, models=models, force=force)
            if not as_json:
                typer.echo(f"{len(found)} {'models of one throw' if same else 'throws'} in {out}")
            shown = [out]
        elif out is not None:
            command = ("diethrow", "replay", *map(str, throws), *output_words(out, force))
            gather(found, out, force=force, command=command)
            if not as_json:
                typer.echo(f"{len(found)} recordings and throws.csv in {out}")
            shown = [out / f"{one.name}.rrd" for one in found]
        if look:
            from ..commands.results.viewer import open_viewer

            open_viewer(shown)


def _draw_recording(folder: Path, recording: Path) -> None:
    """Draw the recording of a folder of results, without tracking."""
    from ..files.outputs import whole_file
    from ..interface import load

    with whole_file(recording, force=True) as file:
        load(folder).recording(file)


@app.command(
    epilog="Examples:  diethrow report out/cube_wood\n\ndiethrow report out/cube_wood --out throw_7.html --embed-replay"
)
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder made by analyze or fit.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.html", help="The page. [default: DIR/report.html, replaced]")
    ] = None,
    embed_replay: EmbedReplay = False,
    force: Annotated[bool, typer.Option("--force", help="Replace FILE.html if it exists.")] = False,
) -> None:
    """Draw the report again from a folder of results, without tracking."""
    with one_sentence_errors():
        from ..files.outputs import whole_file
        from ..interface import load

        analysis = load(folder)
        page = folder / "report.html" if out is None else out
        with whole_file(page, force=force or out is None) as file:
            analysis.report(file, embed_replay=embed_replay)
        typer.echo(f"the report of {analysis.record.title} is {page}")


@app.command(epilog="Example:  diethrow rerun out/cube_wood")
def rerun(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Results of any command, with their provenance.json.")],
    within: Annotated[
        float,
        typer.Option(
            "--within",
            min=0.0,
            help="Largest difference allowed, as a share of the column's largest number; 0: bit for bit.",
        ),
    ] = 1e-6,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Use the options of a run of another machine or user without asking.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Repeat a run from its provenance and report whether the numbers agree. Nothing is written.

    The exit status is 0 where they do, 1 where they do not or cannot be made again.
    """
    with one_sentence_errors():
        from ..commands.results.repeated_run import rerun as make_again
        from ..commands.results.repeated_run import summary
        from ..files.provenance import as_tables

        def accept(options: list[str]) -> bool:
            question = f"{folder} comes from elsewhere. Run its command with {' '.join(options)}?"
            return yes or (sys.stdin.isatty() and typer.confirm(question, err=True))

        comparison = make_again(folder, within=within, accept=accept)
        if as_json:
            print_json(
                {
                    "agree": comparison.agree,
                    "within": comparison.within,
                    "same": comparison.same,
                    "differences": as_tables(comparison.differences),
                    "notices": comparison.notices,
                }
            )
        else:
            typer.echo("\n".join(summary(comparison)))
        if not comparison.agree:
            raise typer.Exit(FAILED)


@app.command(
    epilog="Example:  diethrow watch /camera/today --scene /camera/today/scene.toml --out out/today --joint-every 10"
)
def watch(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="The folder that the camera saves to.")],
    scene: Annotated[Path, typer.Option("--scene", metavar="SCENE", help="The scene of all clips: a template.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Results; may exist, and goes on.")],
    joint_every: Annotated[
        int, typer.Option("--joint-every", min=0, metavar="N", help="Joint fit after every N throws; 0: none.")
    ] = 0,
    poll_s: Annotated[float, typer.Option("--poll-s", min=0.1, metavar="S", help="Time between two looks.")] = 2.0,
    once: Annotated[bool, typer.Option("--once", help="Stop when the clips that are there are done.")] = False,
    quality: Fineness = "standard",
    as_json: AsJson = False,
) -> None:
    """Analyse every clip that appears in a folder: results.csv and index.html grow throw by throw. Ctrl-C stops it, and the same
    command goes on."""
    with one_sentence_errors(), stopped_with(CLIPS_KEPT):
        from ..commands.clip.run_options import RunOptions
        from ..commands.results.watched_folder import Watched
        from ..commands.results.watched_folder import watch as watch_folder
        from ..executors import Processes

        def reported(watched: Watched) -> None:
            if as_json:
                print_json(batch_record(watched.batch, out))
                return
            print_notices(watched.notices)
            typer.echo(
                f"{len(watched.batch.results)} throws, {len(watched.batch.failures)} failures, {watched.new} new; "
                f"see {out / 'index.html'}"
            )

        if not as_json:
            typer.echo(f"watching {folder}; Ctrl-C stops")
        with Processes(1) as executor:
            watch_folder(
                folder,
                scene,
                out,
                options=RunOptions(quality=quality),
                joint_every=joint_every,
                poll_s=poll_s,
                looks=2 if once else None,
                executor=executor,
                reported=reported,
            )


@app.command("warm-up", epilog="Example:  diethrow warm-up     (after pip install, when a container image is built)")
def warm_up(
    processes: Annotated[
        int | None, typer.Option("--processes", min=1, help="Number of processes. [default: one per core]")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile all kernels now, so that no later command waits; for containers, clusters and batches."""
    with one_sentence_errors():
        from ..commands.model.compiled_kernels import summary
        from ..commands.model.compiled_kernels import warm_up as compile_all

        with progress_bars() as progress:
            done = compile_all(processes, progress)
        if as_json:
            print_json({**asdict(done), "folder": str(done.folder)})
        else:
            typer.echo(summary(done))
