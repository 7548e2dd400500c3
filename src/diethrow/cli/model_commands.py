"""cli.model_commands."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app
from .errors import one_sentence_errors, options_that_fit, that_can_go_on
from .options import (
    Amplitude,
    Edge,
    Force,
    Frequency,
    Mass,
    Mu,
    OutFolder,
    Phase,
    Resume,
    Scheduler,
    Shape,
    Threads,
    as_typed,
    command_words,
    executor_for,
    flag_words,
    usable_cores,
)
from .printing import print_shot, print_throw
from .progress import announcing, progress_bars

if TYPE_CHECKING:
    pass


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
    with one_sentence_errors():
        from ..files.plan import read_plan

        checked = read_plan(plan)
        from ..commands.model.throw import throw as simulate

        command = (*command_words("throw", plan, out, force), *flag_words("--embed-replay", embed_replay))
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
    with one_sentence_errors():
        from ..files.plan import read_plan
        from ..files.scene import read_scene

        checked = read_plan(plan)
        seen = read_scene(scene, allow_outside=True) if scene else None  # no footage is opened
        from ..commands.model.film import FilmSettings
        from ..commands.model.film import film as shoot

        with options_that_fit():
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
                threads=threads or usable_cores(),
                variant=variant,
            )
        with progress_bars() as progress:
            shot = shoot(
                checked, out, scene=seen, settings=settings, force=force, progress=progress, command=as_typed()
            )
        print_shot(shot, out)


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
    with one_sentence_errors(), that_can_go_on():
        with options_that_fit():
            from ..commands.model.odds import OddsPlan
            from ..model.laws import Table

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
        from ..commands.model.odds import odds as throw_often
        from ..commands.model.odds import summary

        with executor_for(scheduler) as executor, progress_bars() as progress:
            tallies = throw_often(
                plan,
                out,
                force=force,
                resume=resume,
                threads=threads or usable_cores(),
                executor=executor,
                progress=progress,
                command=as_typed(),
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
    with one_sentence_errors(), that_can_go_on():
        with options_that_fit():
            from ..commands.model.basins import BasinsPlan, axes_of, fixed_from
            from ..model.laws import Table

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
        from ..commands.model.basins import basins as map_basins
        from ..commands.model.basins import summary

        with executor_for(scheduler) as executor, progress_bars() as progress:
            mapped, measured = map_basins(
                plan,
                out,
                force=force,
                resume=resume,
                threads=threads or usable_cores(),
                executor=executor,
                progress=progress,
                command=as_typed(),
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
    with one_sentence_errors():
        with options_that_fit():
            from ..commands.model.lyapunov import LyapunovPlan
            from ..model.laws import Table

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
        from ..commands.model.lyapunov import lyapunov as follow
        from ..commands.model.lyapunov import summary

        with progress_bars() as progress:
            result = follow(plan, out, force=force, progress=progress, command=as_typed())
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
    with one_sentence_errors():
        from ..paper.replication import paper as replicate
        from ..paper.replication import plan_of, summary

        with options_that_fit():
            plan = plan_of(quick, seed)
        with progress_bars() as progress:
            command = as_typed()
            result = replicate(
                plan, out, force=force, threads=threads or usable_cores(), progress=progress, command=command
            )
        for line in summary(result):
            typer.echo(line)
        typer.echo(f"Look at it:  {out / 'paper.html'}")
