"""The command line: parse, call, print.

Only typer is imported here, as in `printing` and `progress`. What computes is imported inside the commands, so that
`--help` answers at once.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from .printing import (
    print_analysis,
    print_batch,
    print_camera,
    print_check,
    print_joint_fit,
    print_notices,
    print_shot,
    print_throw,
    print_throws,
    print_tracking,
    print_trade,
)
from .progress import announce_for_workers, announcing, batch_bar, progress_bars

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from .fitting.whole_throw import IntervalMethod
    from .tracking.quality import Quality

FAILED, MISUSED, INTERRUPTED = 1, 2, 130
"""Exit status: the run gave no result; the scene or the command line is wrong; Ctrl-C."""

app = typer.Typer(
    name="diethrow",
    help="Experiment against simulation for high-speed footage of thrown dice.",
    epilog="Example:  diethrow analyze data_samples/cube_wood/scene.toml --out out/cube_wood",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="The scene file: clip, camera, table and die.")]
Threads = Annotated[int | None, typer.Option("--threads", min=1, help="Left out: one for each core.")]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Work on a Dask cluster, tcp://host:port of its scheduler; needs pip install 'diethrow[distributed]'.",
    ),
]
AllowOutside = Annotated[bool, typer.Option("--allow-outside", help="Let the scene name files outside its own folder.")]
OutFolder = Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder to make.")]
Fineness = Annotated[
    str,
    typer.Option(
        "--quality",
        metavar="fast|standard|fine",
        help="fast: each frame once, edges alone; standard: twice, and the marks on the faces; fine: the same with more steps.",
    ),
]
Every = Annotated[int, typer.Option("--every", min=1, metavar="N", help="Use every N-th frame.")]
Shrink = Annotated[
    int, typer.Option("--shrink", min=1, metavar="F", help="Make pictures smaller: the mean of F × F pixels.")
]
Intervals = Annotated[
    str,
    typer.Option(
        "--intervals",
        metavar="profile|covariance|bootstrap",
        help="Where intervals come from: the profile of the likelihood, the covariance, or residuals drawn anew.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace the folder if it exists, once the new one is complete.")]
EmbedReplay = Annotated[
    bool,
    typer.Option("--embed-replay", help="Put the viewer and the recording into report.html: 20 MB, and no network."),
]
Figures = Annotated[bool, typer.Option("--figures", help="Also the figures of the report as PNG and SVG, in figures/.")]


def main() -> None:
    """The program `diethrow`."""
    app(prog_name="diethrow")


def _print_version(wanted: bool) -> None:
    if wanted:
        from . import __version__

        typer.echo(f"diethrow {__version__}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """Experiment against simulation for high-speed footage of thrown dice."""


@app.command(
    epilog="Example:  diethrow analyze clips/cube_wood/scene.toml --out out/cube_wood; a page to send, with the replay in it:  "
    "diethrow analyze clips/cube_wood/scene.toml --embed-replay --out out/cube_wood"
)
def analyze(
    scene: SceneFile,
    out: OutFolder,
    quality: Fineness = "standard",
    every: Every = 1,
    shrink: Shrink = 1,
    intervals: Intervals = "profile",
    chi_within: Annotated[
        float | None,
        typer.Option("--chi-within", metavar="WIDTH", help="Use the fastest setting that gives χ to ± so much."),
    ] = None,
    trade_file: Annotated[
        Path | None,
        typer.Option("--trade", metavar="TRADE.json", help="What diethrow trade measured on such a scene."),
    ] = None,
    embed_replay: EmbedReplay = False,
    figures: Figures = False,
    allow_outside: AllowOutside = False,
    force: Force = False,
) -> None:
    """From clip to replay: track the die, find its bounces, fit the model, write tables, a recording and a report."""
    with _one_sentence_errors():
        from .scene import read_scene

        # Before the stages are imported: a mistake in a scene is told at once.
        checked = read_scene(scene, allow_outside=allow_outside)
        from .analyze import Shown
        from .analyze import analyze as analyze_scene
        from .compiling import model_ahead
        from .tracking.coarser import Coarseness

        with _options_that_fit():
            chosen, method = _quality(quality), _interval_method(intervals)
        if trade_file is not None and chi_within is None:
            _stop("--trade without --chi-within; say how well χ is wanted, as in --chi-within 0.01", MISUSED)
        with progress_bars() as progress:
            if chi_within is not None:
                from .trade import setting_for

                quality, less = setting_for(checked, chi_within, trade_file, progress)
                chosen, every, shrink = _quality(quality), less.every, less.shrink
                told = f"--quality {quality} --every {every} --shrink {shrink}"
                typer.echo(f"diethrow: for χ to ±{chi_within:g} chosen: {told}", err=True)
        how = ("--quality", quality, *_given("--every", every, 1), *_given("--shrink", shrink, 1))
        how = (*how, *_given("--intervals", intervals, "profile"))
        drawn = (*_flag("--embed-replay", embed_replay), *_flag("--figures", figures))
        with progress_bars() as progress, model_ahead():
            result = analyze_scene(
                checked,
                out,
                force=force,
                quality=chosen,
                coarseness=Coarseness(every, shrink),
                intervals=method,
                shown=Shown(embed_replay, figures),
                progress=progress,
                command=(*_command("analyze", scene, out, force, allow_outside), *how, *drawn),
            )
        print_analysis(result)


@app.command(epilog="Example:  diethrow track clips/cube_wood/scene.toml --out out/track")
def track(
    scene: SceneFile,
    out: OutFolder,
    quality: Fineness = "standard",
    every: Every = 1,
    shrink: Shrink = 1,
    allow_outside: AllowOutside = False,
    force: Force = False,
) -> None:
    """The tracking stage alone: poses with covariances, and bounces."""
    with _one_sentence_errors():
        from .scene import read_scene

        checked = read_scene(scene, allow_outside=allow_outside)
        from .analyze import track_only
        from .tracking.coarser import Coarseness

        how = ("--quality", quality, *_given("--every", every, 1), *_given("--shrink", shrink, 1))
        with progress_bars() as progress:
            result = track_only(
                checked,
                out,
                force=force,
                quality=_quality(quality),
                coarseness=Coarseness(every, shrink),
                progress=progress,
                command=(*_command("track", scene, out, force, allow_outside), *how),
            )
        print_tracking(result, out)


@app.command(
    epilog="Example:  diethrow fit out/track/track_frames.csv --scene clips/cube_wood/scene.toml --out out/fit"
)
def fit(
    tracks: Annotated[
        list[Path],
        typer.Argument(metavar="TRACK.csv...", help="A track, its covariances beside it; several: a joint fit."),
    ],
    scene: Annotated[Path, typer.Option("--scene", metavar="SCENE", help="The scene file; only die and table count.")],
    out: OutFolder,
    intervals: Intervals = "profile",
    threads: Threads = None,
    scheduler: Scheduler = None,
    force: Force = False,
) -> None:
    """The fitting stage alone, on any track with the columns of track.csv; of several tracks, what they share."""
    with _one_sentence_errors():
        from .scene import read_scene

        checked = read_scene(scene, allow_outside=True)  # no footage is opened
        with _options_that_fit():
            method = _interval_method(intervals)
        if len(tracks) > 1:
            if method != "profile":
                _stop("--intervals with several tracks; a joint fit draws its intervals from the throws", MISUSED)
            from .fit_many import fit_tracks

            with _executor(scheduler) as executor, progress_bars() as progress:
                many = fit_tracks(
                    tracks,
                    checked,
                    out,
                    force=force,
                    threads=threads or _cores(),
                    executor=executor,
                    progress=progress,
                    command=_as_typed(),
                )
            print_joint_fit(many)
            return
        from .analyze import fit_track

        how = _given("--intervals", intervals, "profile")
        command = ("diethrow", "fit", str(tracks[0]), "--scene", str(scene), *_options(out, force), *how)
        with progress_bars() as progress:
            result = fit_track(
                tracks[0], checked, out, force=force, intervals=method, progress=progress, command=command
            )
        print_analysis(result)


@app.command(
    epilog="Example:  diethrow predict tosses/*.csv --scene tosses/scene.toml --fit out/joint/fit.json "
    "--from-frame first-bounce --out out/foretold"
)
def predict(
    tracks: Annotated[list[Path], typer.Argument(metavar="TRACK.csv...", help="Tracks from any tracker.")],
    scene: Annotated[Path, typer.Option("--scene", metavar="SCENE", help="The scene file; only die and table count.")],
    fit: Annotated[Path, typer.Option("--fit", metavar="FIT.json", help="The parameters, of one throw or of many.")],
    out: Annotated[Path, typer.Option("--out", metavar="CSV|DIR", help="Of one track a CSV; of several a folder.")],
    from_frame: Annotated[
        str,
        typer.Option("--from-frame", metavar="K|first-bounce", help="Only frames before this one tell the state."),
    ] = "first-bounce",
    draws: Annotated[
        int | None,
        typer.Option(
            "--draws", min=0, help="Throws drawn for the odds of the faces. [default: 100 for one track, else 0]"
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Foretell throws: the state from the frames before K, simulated on to the last frame with the parameters of a fit."""
    with _one_sentence_errors():
        from .scene import read_scene

        checked = read_scene(scene, allow_outside=True)  # no footage is opened
        from .fitting.prediction import DRAWS
        from .predict import predict_tracks, summary

        drawn = (DRAWS if len(tracks) == 1 else 0) if draws is None else draws
        with progress_bars() as progress:
            made, left_out = predict_tracks(
                tracks, checked, fit, out, from_frame=from_frame, draws=drawn, force=force, progress=progress
            )
        for line in summary(made, checked.die):
            typer.echo(line)
        print_notices(left_out)
        typer.echo(f"See {out}")


@app.command(epilog="Example:  diethrow throw throw.toml --out out/throw")
def throw(
    plan: Annotated[Path, typer.Argument(metavar="THROW.toml", help="The throw file: die, law, release and end.")],
    out: OutFolder,
    embed_replay: Annotated[
        bool,
        typer.Option("--embed-replay", help="Also replay.html: the viewer and the recording in one page, 20 MB."),
    ] = False,
    force: Force = False,
) -> None:
    """Simulate one throw from its initial conditions to its end."""
    with _one_sentence_errors():
        from .plan import read_plan

        checked = read_plan(plan)
        from .throw import throw as simulate

        command = (*_command("throw", plan, out, force), *_flag("--embed-replay", embed_replay))
        with announcing():
            result = simulate(checked, out, force=force, embed_replay=embed_replay, command=command)
        print_throw(result, out)


@app.command(
    epilog="Example:  diethrow film throw.toml --scene clips/cube_wood/scene.toml --out out/film; "
    "diethrow analyze out/film/scene.toml --out out/seen"
)
def film(
    plan: Annotated[Path, typer.Argument(metavar="THROW.toml", help="The throw file: die, law, release and end.")],
    out: OutFolder,
    scene: Annotated[
        Path | None,
        typer.Option(
            "--scene",
            metavar="SCENE",
            help="Its camera, rate, exposure, surface and marks; left out: a camera that keeps the throw in view.",
        ),
    ] = None,
    frames: Annotated[int | None, typer.Option("--frames", help="Left out: as many as the throw lasts.")] = None,
    start: Annotated[float, typer.Option("--start", metavar="S", help="Leave so much of the fall out [s].")] = 0.0,
    size: Annotated[int, typer.Option("--size", metavar="PX", help="Width and height, where there is no scene.")] = 512,
    fps: Annotated[
        float | None, typer.Option("--fps", metavar="HZ", help="Recording rate; left out: the scene's.")
    ] = None,
    exposure: Annotated[
        float | None, typer.Option("--exposure", metavar="S", help="Of a frame [s]; left out: the scene's, or 0.0002.")
    ] = None,
    bits: Annotated[int, typer.Option("--bits", help="8, 10, 12 or 16 for each pixel.")] = 8,
    noise: Annotated[float, typer.Option("--noise", help="Factor on the sensor's noise; 0 for none.")] = 1.0,
    blur: Annotated[float, typer.Option("--blur", metavar="PX", help="Standard deviation of the point spread.")] = 0.6,
    samples: Annotated[int, typer.Option("--samples", help="Light paths for each pixel; more are smoother.")] = 48,
    seed: Annotated[int, typer.Option("--seed", help="Of textures and noise.")] = 1,
    threads: Threads = None,
    variant: Annotated[
        str,
        typer.Option("--variant", help="Of Mitsuba; llvm_ad_mono is twice as fast where LLVM 16 or newer is found."),
    ] = "scalar_rgb",
    force: Force = False,
) -> None:
    """Render a simulated throw as a camera would film it, with the truth beside it, ready for analyze."""
    with _one_sentence_errors():
        from .plan import read_plan
        from .scene import read_scene

        checked = read_plan(plan)
        seen = read_scene(scene, allow_outside=True) if scene else None  # no footage is opened
        from .film import FilmSettings
        from .film import film as shoot

        with _options_that_fit():
            settings = FilmSettings(
                frames=frames,
                start_s=start,
                size_px=size,
                fps=fps,
                exposure_s=exposure,
                bit_depth=bits,
                noise=noise,
                blur_px=blur,
                samples=samples,
                seed=seed,
                threads=threads or _cores(),
                variant=variant,
            )
        with progress_bars() as progress:
            shot = shoot(
                checked, out, scene=seen, settings=settings, force=force, progress=progress, command=_as_typed()
            )
        print_shot(shot, out)


@app.command(
    epilog="Examples:  diethrow replay out/cube_wood --open\n\n"
    "diethrow replay out/throw_1 out/throw_2 --out both.rrd --open     (several throws, or several models of one)\n\n"
    "diethrow replay out --out throws     (a folder of throws: one recording each, and a table)"
)
def replay(
    throws: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR...", help="Folders that analyze, fit or throw made; a folder of them stands for all."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE.rrd|DIR",
            help="FILE.rrd: all throws in one recording. DIR: a recording for each, and throws.csv. Left out: neither.",
        ),
    ] = None,
    align: Annotated[
        str, typer.Option("--align", metavar="bounce|frame", help="Set the clocks by the first bounce, or by frame 0.")
    ] = "bounce",
    models: Annotated[
        bool | None,
        typer.Option(
            "--models/--throws",
            help="Several models of one throw, or several throws; left out: models where all come from one clip or track.",
            show_default=False,
        ),
    ] = None,
    look: Annotated[
        bool, typer.Option("--open", help="Show it in the viewer, which then tells nobody and serves nobody else.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace what --out names.")] = False,
) -> None:
    """Look at throws: a table, one recording of several, and the viewer."""
    with _one_sentence_errors():
        from .replays import find_recordings, gather, join

        found = find_recordings(throws)
        print_throws(found)
        shown = [one.path for one in found]
        if out is not None and out.suffix == ".rrd":
            same = join(found, out, align=align, models=models, force=force)
            typer.echo(f"{len(found)} {'models of one throw' if same else 'throws'} in {out}")
            shown = [out]
        elif out is not None:
            gather(found, out, force=force)
            typer.echo(f"{len(found)} recordings and throws.csv in {out}")
            shown = [out / f"{one.name}.rrd" for one in found]
        if look:
            from .viewer import open_viewer

            open_viewer(shown)


Shape = Annotated[str, typer.Option("--shape", help="tetrahedron, cube, octahedron, dodecahedron or icosahedron.")]
Edge = Annotated[float, typer.Option("--edge", metavar="M", help="Edge of the die [m].")]
Mass = Annotated[float, typer.Option("--mass", metavar="KG", help="Mass of the die [kg].")]
Mu = Annotated[float | None, typer.Option("--mu", help="Coulomb friction; left out: the paper's smooth impact.")]
Amplitude = Annotated[float, typer.Option("--amplitude", metavar="M", help="Of the table's oscillation [m].")]
Frequency = Annotated[float, typer.Option("--frequency", metavar="HZ", help="Of the table's oscillation [Hz].")]
Phase = Annotated[float, typer.Option("--phase", metavar="RAD", help="Of the table at the release [rad].")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with a run of the same settings that was stopped.")]


@app.command(
    epilog="Example:  diethrow odds --shape cube --chi 0.3 --chi 0.5 --omega 40 --throws 100000 --out out/odds"
)
def odds(
    out: OutFolder,
    shape: Shape = "cube",
    edge: Edge = 0.02,
    mass: Mass = 0.016,
    chi: Annotated[
        list[float] | None, typer.Option("--chi", help="Restitution, 0 to 1; several: a series each. [default: 0.5]")
    ] = None,
    mu: Mu = None,
    conditions: Annotated[
        str,
        typer.Option(
            "--conditions",
            help="paper: Euler angles uniform, body spin (0, OMEGA, 0); uniform: every orientation and direction of spin "
            "alike.",
        ),
    ] = "paper",
    omega: Annotated[float, typer.Option("--omega", help="The spin [rad/s].")] = 40.0,
    height: Annotated[
        tuple[float, float] | None,
        typer.Option("--height", metavar="LOW HIGH", help="Range of the release [m]; left out: 15 to 20 edges."),
    ] = None,
    throws: Annotated[int, typer.Option("--throws", help="For each chi.")] = 100_000,
    after: Annotated[int, typer.Option("--after", help="Count the lowest face at the first so many impacts.")] = 5,
    amplitude: Amplitude = 0.0,
    frequency: Frequency = 0.0,
    phase: Phase = 0.0,
    seed: Annotated[int, typer.Option("--seed", help="Of the releases.")] = 1,
    threads: Threads = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    force: Force = False,
) -> None:
    """Landing probabilities of every face, with intervals; what does not land is told apart."""
    with _one_sentence_errors(), _that_can_go_on():
        with _options_that_fit():
            from .model.tables import Table
            from .odds import OddsPlan

            plan = OddsPlan(
                shape=shape,
                edge_m=edge,
                mass_kg=mass,
                chi=tuple(chi or (0.5,)),
                omega_rad_s=omega,
                conditions=conditions,
                height_m=height,
                throws=throws,
                seed=seed,
                after=after,
                mu=mu,
                table=Table(amplitude_m=amplitude, frequency_hz=frequency, phase_rad=phase),
            )
        from .odds import odds as throw_often
        from .odds import summary

        with _executor(scheduler) as executor, progress_bars() as progress:
            tallies = throw_often(
                plan,
                out,
                force=force,
                resume=resume,
                threads=threads or _cores(),
                executor=executor,
                progress=progress,
                command=_as_typed(),
            )
        for line in summary(plan, tallies):
            typer.echo(line)
        typer.echo(f"See {out}")


@app.command(
    epilog="Example:  diethrow basins --chi 0.2 --x z0 0.1 0.4 --y omega_eta 0 50 --pixels 1000 1000 --out out/basins"
)
def basins(
    out: OutFolder,
    x: Annotated[
        tuple[str, float, float],
        typer.Option(
            "--x",
            metavar="NAME LOW HIGH",
            help="Horizontal axis: z0, psi, theta, phi, vx, vy, vz [SI], "
            "omega_xi, omega_eta or omega_zeta (body axes).",
        ),
    ] = ("z0", 0.1, 0.4),
    y: Annotated[
        tuple[str, float, float], typer.Option("--y", metavar="NAME LOW HIGH", help="Vertical axis, as --x.")
    ] = ("omega_eta", 0.0, 50.0),
    fix: Annotated[
        list[str] | None,
        typer.Option(
            "--fix",
            metavar="NAME=VALUE",
            help="Another initial condition. [default: the paper's Fig. 6: "
            "psi=0.3, theta=1.2, phi=0.6, no velocity; z0=0.3 where it is no axis]",
        ),
    ] = None,
    zoom: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option("--zoom", metavar="X0 X1 Y0 Y1", help="Only this part of the plane, in as many pixels."),
    ] = None,
    pixels: Annotated[
        tuple[int, int], typer.Option("--pixels", metavar="COLUMNS ROWS", help="Of the map: a throw for each.")
    ] = (500, 500),
    shape: Shape = "tetrahedron",
    edge: Edge = 0.040793,
    mass: Mass = 0.016,
    chi: Annotated[float, typer.Option("--chi", help="Restitution, 0 to 1.")] = 0.2,
    mu: Mu = None,
    amplitude: Amplitude = 0.0,
    frequency: Frequency = 0.0,
    phase: Phase = 0.0,
    at_impact: Annotated[
        int | None, typer.Option("--at-impact", help="Colour by the face that is lowest at this impact.")
    ] = None,
    predictability: Annotated[
        bool, typer.Option("--predictability", help="Measure how near a condition must be known to tell the face.")
    ] = False,
    samples: Annotated[int, typer.Option("--samples", help="Conditions drawn for --predictability.")] = 8192,
    seed: Annotated[int, typer.Option("--seed", help="Of those conditions.")] = 1,
    threads: Threads = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    force: Force = False,
) -> None:
    """Basins of attraction: the landed face over a plane of initial conditions, as a picture and as data."""
    with _one_sentence_errors(), _that_can_go_on():
        with _options_that_fit():
            from .basins import BasinsPlan, axes_of, fixed_from
            from .model.tables import Table

            horizontal, vertical = axes_of(x, y, zoom, pixels)
            plan = BasinsPlan(
                x=horizontal,
                y=vertical,
                fixed=fixed_from(fix or []),
                shape=shape,
                edge_m=edge,
                mass_kg=mass,
                chi=chi,
                mu=mu,
                table=Table(amplitude_m=amplitude, frequency_hz=frequency, phase_rad=phase),
                at_impact=at_impact,
                predictability=predictability,
                conditions=samples,
                seed=seed,
            )
        from .basins import basins as map_basins
        from .basins import summary

        with _executor(scheduler) as executor, progress_bars() as progress:
            mapped, measured = map_basins(
                plan,
                out,
                force=force,
                resume=resume,
                threads=threads or _cores(),
                executor=executor,
                progress=progress,
                command=_as_typed(),
            )
        for line in summary(plan, mapped, measured):
            typer.echo(line)
        typer.echo(f"Look at it:  {out / 'basins.png'}")


@app.command(epilog="Example:  diethrow lyapunov --shape tetrahedron --edge 0.040793 --orbits 8 --out out/lyapunov")
def lyapunov(
    out: OutFolder,
    shape: Shape = "cube",
    edge: Edge = 0.02,
    mass: Mass = 0.016,
    chi: Annotated[
        float, typer.Option("--chi", help="Restitution, 0 to 1; below 1 only a table that oscillates has an exponent.")
    ] = 1.0,
    mu: Mu = None,
    amplitude: Amplitude = 0.0,
    frequency: Frequency = 0.0,
    phase: Phase = 0.0,
    impacts: Annotated[int, typer.Option("--impacts", help="Of each orbit.")] = 10_000,
    orbits: Annotated[int, typer.Option("--orbits", help="Neighbours of the start, one after the other.")] = 8,
    leave_out: Annotated[int, typer.Option("--leave-out", help="Impacts at the beginning that do not count.")] = 200,
    position: Annotated[
        tuple[float, float, float], typer.Option("--position", metavar="X Y Z", help="Of the start [m].")
    ] = (0.0, 0.0, 0.3),
    euler: Annotated[
        tuple[float, float, float], typer.Option("--euler", metavar="PSI THETA PHI", help="Of the start [rad].")
    ] = (0.001, 0.00001, 0.0001),
    velocity: Annotated[
        tuple[float, float, float], typer.Option("--velocity", metavar="X Y Z", help="Of the start [m/s].")
    ] = (0.6, 0.0, -0.7),
    omega_body: Annotated[
        tuple[float, float, float],
        typer.Option("--omega-body", metavar="XI ETA ZETA", help="Angular velocity of the start, body axes [rad/s]."),
    ] = (0.0, 60.0, 0.0),
    seed: Annotated[int, typer.Option("--seed", help="Of the neighbours.")] = 1,
    force: Force = False,
) -> None:
    """The largest Lyapunov exponent of a die that bounces on; the start is the paper's Fig. 5 unless given."""
    with _one_sentence_errors():
        with _options_that_fit():
            from .lyapunov import LyapunovPlan
            from .model.tables import Table

            plan = LyapunovPlan(
                shape=shape,
                edge_m=edge,
                mass_kg=mass,
                chi=chi,
                mu=mu,
                table=Table(amplitude_m=amplitude, frequency_hz=frequency, phase_rad=phase),
                impacts=impacts,
                orbits=orbits,
                left_out=leave_out,
                seed=seed,
                position_m=position,
                euler_rad=euler,
                velocity_m_s=velocity,
                omega_body_rad_s=omega_body,
            )
        from .lyapunov import lyapunov as follow
        from .lyapunov import summary

        with progress_bars() as progress:
            result = follow(plan, out, force=force, progress=progress, command=_as_typed())
        for line in summary(plan, result):
            typer.echo(line)
        typer.echo(f"See {out}")


@app.command(epilog="Example:  diethrow paper --quick --out out/paper")
def paper(
    out: OutFolder,
    quick: Annotated[
        bool, typer.Option("--quick", help="A hundredth of the throws: a few minutes instead of tens.")
    ] = False,
    seed: Annotated[int, typer.Option("--seed", help="Of everything that is drawn.")] = 1,
    threads: Threads = None,
    force: Force = False,
) -> None:
    """Replicate Kapitaniak et al. (2012): figures, odds and exponents on one page, with a verdict for each statement."""
    with _one_sentence_errors():
        from .paper import paper as replicate
        from .paper import plan_of, summary

        with _options_that_fit():
            plan = plan_of(quick, seed)
        with progress_bars() as progress:
            command = _as_typed()
            result = replicate(plan, out, force=force, threads=threads or _cores(), progress=progress, command=command)
        for line in summary(result):
            typer.echo(line)
        typer.echo(f"Look at it:  {out / 'paper.html'}")


@app.command(epilog="Example:  diethrow batch clips/*/scene.toml --out out/all --workers 4")
def batch(
    scenes: Annotated[list[Path], typer.Argument(metavar="SCENES...", help="Scene files; each makes a folder in DIR.")],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="The folder of all results; begun again, it goes on.")
    ],
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Processes of this machine; left out: one for each core.")
    ] = None,
    scheduler: Scheduler = None,
    quality: Fineness = "standard",
    only_track: Annotated[
        bool, typer.Option("--only-track", help="The tracking stage alone, as diethrow track.")
    ] = False,
    allow_outside: AllowOutside = False,
) -> None:
    """Analyse many scenes: results.csv, failures.csv, and a folder for each. A finished clip is done again only where its
    files, the version or the quality changed.

    The exit status is 1 where a clip failed. Ctrl-C and kill cost the clips in hand; the same command goes on.
    """
    with _one_sentence_errors(), _whose_finished_clips_stay():
        from .batch import run_batch

        _quality(quality)
        if scheduler is None:
            announce_for_workers()
        with _executor(scheduler) as executor, batch_bar() as progress:
            result = run_batch(
                scenes,
                out,
                executor=executor,
                workers=workers,
                stage="track" if only_track else "analyze",
                quality=quality,
                allow_outside=allow_outside,
                progress=progress,
            )
        print_batch(result, out)
        if result.failures:
            raise typer.Exit(FAILED)


@app.command(epilog="Example:  diethrow rerun out/cube_wood")
def rerun(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Results of any command, with their provenance.json.")],
    within: Annotated[
        float,
        typer.Option(
            "--within",
            min=0.0,
            help="Largest difference, as a share of the largest number of a column; 0: bit for bit.",
        ),
    ] = 1e-6,
) -> None:
    """Make results again from their provenance, and say whether the numbers agree. Nothing is written.

    The exit status is 0 where they do, 1 where they do not or cannot be made again.
    """
    with _one_sentence_errors():
        from .repeat import rerun as make_again
        from .repeat import summary

        comparison = make_again(folder, within=within)
        for line in summary(comparison):
            typer.echo(line)
        if not comparison.agree:
            raise typer.Exit(FAILED)


@app.command(
    epilog="Example:  diethrow trade clips/cube_wood/scene.toml --chi-within 0.01 --out out/trade; then  "
    "diethrow analyze clips/another/scene.toml --chi-within 0.01 --trade out/trade/trade.json --out out/another"
)
def trade(
    scene: SceneFile,
    out: OutFolder,
    chi_within: Annotated[
        float, typer.Option("--chi-within", metavar="WIDTH", help="How well χ is wanted: ± so much.")
    ] = 0.01,
    coverage: Annotated[
        int, typer.Option("--coverage", min=0, metavar="N", help="Simulated tracks for each coverage; 0: none.")
    ] = 20,
    allow_outside: AllowOutside = False,
    force: Force = False,
) -> None:
    """Speed against accuracy on one scene, measured: tracking, fit and model from coarse to fine, and what to use."""
    with _one_sentence_errors():
        from .scene import read_scene

        checked = read_scene(scene, allow_outside=allow_outside)
        from .trade import trade as measure_trade

        how = ("--chi-within", str(chi_within), *_given("--coverage", coverage, 20))
        with progress_bars() as progress:
            result = measure_trade(
                checked,
                out,
                within=chi_within,
                draws=coverage,
                force=force,
                progress=progress,
                command=(*_command("trade", scene, out, force, allow_outside), *how),
            )
        print_trade(result)
        typer.echo(f"See {out / 'trade.html'}")


@app.command(epilog="Example:  diethrow check clips/cube_wood/scene.toml --out out/check")
def check(
    scene: SceneFile,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="A folder for check.json and check.html; left out: none."),
    ] = None,
    allow_outside: AllowOutside = False,
    force: Force = False,
) -> None:
    """Before tracking: is the clip fit for it? Timing, blur, pixels, background, scale and vertical, with verdicts.

    The exit status is 1 where something is bad.
    """
    with _one_sentence_errors():
        from .scene import read_scene

        checked = read_scene(scene, allow_outside=allow_outside)
        from .check import check_clip

        with announcing():
            result = check_clip(checked, out, force=force, command=_as_typed())
        print_check(result)
        if out is not None:
            typer.echo(f"See {out / 'check.html'}")
        if result.bad:
            raise typer.Exit(FAILED)


@app.command(
    epilog="Example:  diethrow calibrate board_*.png --table board_on_table.png --squares 7x5 --square-mm 10 "
    "--marker-mm 7.5 --out out/camera"
)
def calibrate(
    pictures: Annotated[
        list[Path], typer.Argument(metavar="PICTURES...", help="Pictures of the board, tilted to all sides.")
    ],
    out: OutFolder,
    square_mm: Annotated[float, typer.Option("--square-mm", metavar="MM", help="Side of a square as printed.")],
    squares: Annotated[str, typer.Option("--squares", metavar="CxR", help="Squares along columns and rows.")] = "7x5",
    board: Annotated[str, typer.Option("--board", help="charuco or chessboard.")] = "charuco",
    marker_mm: Annotated[
        float | None, typer.Option("--marker-mm", metavar="MM", help="Side of a marker; ChArUco only.")
    ] = None,
    dictionary: Annotated[
        str, typer.Option("--dictionary", help="OpenCV's name of the markers' dictionary.")
    ] = "DICT_4X4_50",
    table: Annotated[
        Path | None,
        typer.Option("--table", metavar="PICTURE", help="The board flat on the table: gives the camera's place."),
    ] = None,
    thickness_mm: Annotated[
        float, typer.Option("--thickness-mm", metavar="MM", help="Of the board that lies on the table.")
    ] = 0.0,
    force: Force = False,
) -> None:
    """Camera and table pose from pictures of a ChArUco board or a chessboard: camera.toml, calibration.json and a page."""
    with _one_sentence_errors():
        with _options_that_fit():
            from .tracking.boards import make_board

            columns, rows = _two_counts("squares", squares)
            marker_m = None if marker_mm is None else 1e-3 * marker_mm
            printed = make_board(board, columns, rows, 1e-3 * square_mm, marker_m, dictionary)
        from .calibrate import calibrate_camera

        with announcing():
            found = calibrate_camera(
                pictures, printed, out, table=table, thickness_m=1e-3 * thickness_mm, force=force, command=_as_typed()
            )
        print_camera(found, len(pictures) + (table is not None and table not in pictures), out)


@contextmanager
def _one_sentence_errors() -> Iterator[None]:
    """Tell an error in one sentence, with its exit status; DIETHROW_TRACEBACK=1 shows where it came from."""
    try:
        yield
    except KeyboardInterrupt:
        _stop("stopped; no output was left behind", INTERRUPTED)
    except (SystemError, RuntimeError) as error:
        if not _stems_from_interrupt(error):
            raise
        _stop("stopped; no output was left behind", INTERRUPTED)
    except (ValueError, OSError) as error:
        if os.environ.get("DIETHROW_TRACEBACK"):
            raise
        from .outputs import OutputExistsError, OutputPlaceError
        from .settings import SceneError

        print_notices(tuple(getattr(error, "__notes__", ())))
        misused = isinstance(error, (SceneError, OutputExistsError, OutputPlaceError))
        _stop(" ".join(str(error).split()) or type(error).__name__, MISUSED if misused else FAILED)


@contextmanager
def _options_that_fit() -> Iterator[None]:
    """An option that cannot be is told in one sentence, with the status of a misused command."""
    try:
        yield
    except ValueError as error:
        _stop(" ".join(str(error).split()), MISUSED)


@contextmanager
def _that_can_go_on() -> Iterator[None]:
    """A long run that is stopped leaves its work file, and says how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        _stop("stopped; no output was left behind, and --resume goes on with what was done", INTERRUPTED)


@contextmanager
def _whose_finished_clips_stay() -> Iterator[None]:
    """A batch that is stopped keeps what is finished, and says how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        _stop("stopped; what is finished stays, and the same command does the rest", INTERRUPTED)


@contextmanager
def _executor(scheduler: str | None) -> Iterator[Executor | None]:
    """A Dask cluster as an executor; None where no scheduler is named."""
    if scheduler is None:
        yield None
        return
    from .executors import cluster_at

    with cluster_at(scheduler) as executor:
        yield executor


def _two_counts(name: str, text: str) -> tuple[int, int]:
    """`7x5` as two numbers."""
    first, cross, second = text.lower().replace("×", "x").partition("x")
    if not (cross and first.strip().isdecimal() and second.strip().isdecimal()):
        raise ValueError(f"{name} = {text}; wanted two whole numbers with an x between them, as in 7x5")
    return int(first), int(second)


def _cores() -> int:
    """Cores that this process may use."""
    from .executors import cores

    return cores()


def _as_typed() -> tuple[str, ...]:
    """The command line."""
    return ("diethrow", *sys.argv[1:])


def _stems_from_interrupt(error: BaseException) -> bool:
    """Whether this is Ctrl-C in disguise: within a compiled kernel it comes out as a chain of SystemErrors; while a kernel
    is compiled, LLVM's callback may swallow it, and numba then misses the code that the callback should have handed on."""
    while error.__cause__ is not None:
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt) or "no compiled object yet" in str(error)


def _stop(sentence: str, status: int) -> NoReturn:
    typer.echo(f"diethrow: {sentence}", err=True)
    raise typer.Exit(status)


def _quality(name: str) -> Quality:
    """The tracker's setting of that name. Raises ValueError, in a sentence, where there is none."""
    from .tracking.quality import QUALITIES

    if name not in QUALITIES:
        raise ValueError(f"--quality {name}: wanted {', '.join(QUALITIES)}")
    return QUALITIES[name]


def _interval_method(name: str) -> IntervalMethod:
    """The method of that name. Raises ValueError, in a sentence, where there is none."""
    from .fitting.whole_throw import INTERVAL_METHODS

    for method in INTERVAL_METHODS:
        if name == method:
            return method
    raise ValueError(f"--intervals {name}: wanted {', '.join(INTERVAL_METHODS)}")


def _given(name: str, value: int | str, default: int | str) -> tuple[str, ...]:
    """An option as typed; nothing where it says what goes without saying."""
    return () if value == default else (name, str(value))


def _command(name: str, file: Path, out: Path, force: bool, allow_outside: bool = False) -> tuple[str, ...]:
    outside = ("--allow-outside",) if allow_outside else ()
    return ("diethrow", name, str(file), *_options(out, force), *outside)


def _flag(name: str, given: bool) -> tuple[str, ...]:
    return (name,) if given else ()


def _options(out: Path, force: bool) -> tuple[str, ...]:
    return ("--out", str(out), *(("--force",) if force else ()))


if __name__ == "__main__":
    main()
