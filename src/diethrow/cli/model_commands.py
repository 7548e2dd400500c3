"""Commands that need no clip: throw, film, odds, basins, lyapunov, paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from .app import app
from .errors import RESUMABLE, checked_options, one_sentence_errors, stopped_with
from .options import (
    Amplitude,
    AsJson,
    DieFile,
    Drag,
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
    ThrowFile,
    as_typed,
    chosen_die,
    command_words,
    flag_words,
    run_on,
    usable_cores,
)
from .printing import print_film, print_json, print_presets, print_throw
from .progress import announcing, progress_bars


@app.command(epilog="Example:  diethrow throw throw.toml --out out/throw")
def throw(
    plan: ThrowFile,
    out: OutFolder,
    embed_replay: Annotated[
        bool,
        typer.Option(
            "--embed-replay", help="Also write replay.html: the viewer and the recording in one page of 20 MB."
        ),
    ] = False,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Simulate one throw from its initial conditions to its end."""
    with one_sentence_errors():
        from ..files.plan import read_plan

        checked = read_plan(plan)
        from ..commands.model.simulated_throw import throw as simulate

        command = (*command_words("throw", plan, out, force), *flag_words("--embed-replay", embed_replay))
        with announcing():
            result = simulate(checked, out, force=force, embed_replay=embed_replay, command=command)
        if as_json:
            print_json(out / "throw.json")
        else:
            print_throw(result, out)


def _print_presets(wanted: bool) -> None:
    """Print the presets of film, and stop."""
    if wanted:
        from ..commands.model.film_presets import preset_rows

        print_presets(preset_rows())
        raise typer.Exit


@app.command(
    epilog="Example:  diethrow film throw.toml --scene clips/cube_wood/scene.toml --out out/film; "
    "diethrow analyze out/film/scene.toml --out out/seen"
)
def film(
    plan: ThrowFile,
    out: OutFolder,
    scene: Annotated[
        Path | None,
        typer.Option(
            "--scene",
            metavar="SCENE",
            help="Take camera, rate, exposure, readout, response, surface and marks from this scene. "
            "[default: a camera that sees the whole throw]",
        ),
    ] = None,
    preset: Annotated[
        list[str] | None,
        typer.Option(
            "--preset",
            metavar="NAME",
            help="Settings of an ordinary die or camera, or a fault, by name: see --list-presets. Repeat it to combine several; "
            "a later one wins, and explicit options win over all.",
        ),
    ] = None,
    frames: Annotated[int | None, typer.Option("--frames", help="Number of frames. [default: the whole throw]")] = None,
    start: Annotated[
        float | None, typer.Option("--start", metavar="S", help="Time skipped after the release [s]. [default: 0]")
    ] = None,
    size: Annotated[
        int | None, typer.Option("--size", metavar="PX", help="Width and height without a scene. [default: 512]")
    ] = None,
    fps: Annotated[
        float | None, typer.Option("--fps", metavar="HZ", help="Recording rate [1/s]. [default: the scene's]")
    ] = None,
    exposure: Annotated[
        float | None,
        typer.Option("--exposure", metavar="S", help="Exposure of a frame [s]. [default: the scene's, or 0.0002]"),
    ] = None,
    readout: Annotated[
        float | None,
        typer.Option(
            "--readout",
            metavar="S",
            help="Rolling shutter: time from the first row's exposure to the last row's [s]. [default: the scene's, or 0]",
        ),
    ] = None,
    response: Annotated[
        str | None,
        typer.Option(
            "--response",
            metavar="CURVE",
            help="linear, srgb, or the exponent of grey = light ** exponent. [default: the scene's, or linear]",
        ),
    ] = None,
    bits: Annotated[int | None, typer.Option("--bits", help="Bits per pixel: 8, 10, 12 or 16. [default: 8]")] = None,
    noise: Annotated[
        float | None, typer.Option("--noise", help="Factor on the sensor's noise; 0: none. [default: 1]")
    ] = None,
    codec: Annotated[
        Literal["ffv1", "h264", "hevc", "mjpeg"] | None,
        typer.Option(
            "--codec",
            help="Codec of the clip. [default: ffv1, without loss]",
        ),
    ] = None,
    crf: Annotated[
        int | None,
        typer.Option(
            "--crf", help="Rate factor of h264 and hevc, quantiser of mjpeg; higher is worse. [default: 20, 22, 4]"
        ),
    ] = None,
    full_range: Annotated[
        bool | None,
        typer.Option("--full-range/--limited-range", help="Range of the luma of h264 and hevc. [default: limited]"),
    ] = None,
    blur: Annotated[
        float | None,
        typer.Option("--blur", metavar="PX", help="Standard deviation of the point spread. [default: 0.6]"),
    ] = None,
    aperture: Annotated[
        float | None,
        typer.Option(
            "--aperture", metavar="M", help="Diameter of the lens's aperture [m]. [default: 0, sharp everywhere]"
        ),
    ] = None,
    focus: Annotated[
        float | None,
        typer.Option(
            "--focus", metavar="M", help="Distance of the plane of focus [m]. [default: the die's at its first impact]"
        ),
    ] = None,
    corner_radius: Annotated[
        float | None,
        typer.Option(
            "--corner-radius", metavar="M", help="Radius of the die's corners [m]. [default: the throw file's]"
        ),
    ] = None,
    roughness: Annotated[
        float | None,
        typer.Option("--roughness", help="Of the die's gloss: 0.05 is nearly a mirror, 0.5 is dull. [default: 0.15]"),
    ] = None,
    samples: Annotated[
        int | None, typer.Option("--samples", help="Light paths per pixel; more give less render noise. [default: 48]")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Seed of textures, noise and faults. [default: 1]")] = None,
    threads: Threads = None,
    variant: Annotated[
        str | None,
        typer.Option(
            "--variant",
            help="Variant of Mitsuba; llvm_ad_mono is three times as fast with LLVM 19 or newer. [default: scalar_rgb]",
        ),
    ] = None,
    force: Force = False,
    list_presets: Annotated[
        bool,
        typer.Option("--list-presets", is_eager=True, callback=_print_presets, help="Print all presets and stop."),
    ] = False,
) -> None:
    """Render a simulated throw as a camera would film it, with the truth beside it, ready for analyze."""
    with one_sentence_errors():
        from ..files.plan import read_plan
        from ..files.scene import read_scene

        checked = read_plan(plan)
        seen = read_scene(scene, allow_outside=True) if scene else None  # no footage is opened
        from ..commands.model.film_settings import film_settings, response_named
        from ..commands.model.filmed_throw import film as shoot

        with checked_options():
            settings = film_settings(
                preset or (),
                frames=frames,
                start_s=start,
                size_px=size,
                fps=fps,
                exposure_s=exposure,
                readout_s=readout,
                response=response_named(response),
                bit_depth=bits,
                noise=noise,
                codec=codec,
                crf=crf,
                full_range=full_range,
                blur_px=blur,
                aperture_m=aperture,
                focus_m=focus,
                corner_radius_m=corner_radius,
                roughness=roughness,
                samples=samples,
                seed=seed,
                threads=threads or usable_cores(),
                variant=variant,
            )
        with progress_bars() as progress:
            job = shoot(checked, out, scene=seen, settings=settings, force=force, progress=progress, command=as_typed())
        print_film(job, out)


@app.command(
    epilog="Example:  diethrow odds --shape cube --chi 0.3 --chi 0.5 --omega 40 --throws 100000 --out out/odds"
)
def odds(
    out: OutFolder,
    die: DieFile = None,
    shape: Shape = None,
    edge: Edge = None,
    mass: Mass = None,
    chi: Annotated[
        list[float] | None,
        typer.Option("--chi", help="Restitution, 0 to 1; repeat the option for a series each. [default: 0.5]"),
    ] = None,
    mu: Mu = None,
    drag: Drag = 0.0,
    conditions: Annotated[
        Literal["paper", "uniform"],
        typer.Option(
            "--conditions",
            help="paper: uniform Euler angles, body spin (0, OMEGA, 0); uniform: uniform orientations and spin directions "
            "alike.",
        ),
    ] = "paper",
    omega: Annotated[float, typer.Option("--omega", help="Angular speed at release [rad/s].")] = 40.0,
    height: Annotated[
        tuple[float, float] | None,
        typer.Option("--height", metavar="LOW HIGH", help="Range of release heights [m]. [default: 15 to 20 edges]"),
    ] = None,
    throws: Annotated[int, typer.Option("--throws", help="Throws per chi.")] = 100_000,
    after: Annotated[int, typer.Option("--after", help="Record the lowest face at the first N impacts.")] = 5,
    amplitude: Amplitude = 0.0,
    frequency: Frequency = 0.0,
    phase: Phase = 0.0,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the releases.")] = 1,
    threads: Threads = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Landing probability of every face, with intervals; throws that do not land are counted by how they end."""
    with one_sentence_errors(), stopped_with(RESUMABLE):
        with checked_options():
            from ..commands.model.face_odds import OddsPlan
            from ..model.laws import Table

            thrown, files = chosen_die(die, shape, edge, mass)
            plan = OddsPlan(
                die=thrown,
                die_files=files,
                chi=tuple(chi or (0.5,)),
                omega_rad_s=omega,
                conditions=conditions,
                height_m=height,
                throws=throws,
                seed=seed,
                after=after,
                mu=mu,
                drag_per_m=drag,
                table=Table(amplitude_m=amplitude, frequency_hz=frequency, phase_rad=phase),
            )
        from ..commands.model.face_odds import odds as throw_often
        from ..commands.model.face_odds import summary

        tallies = run_on(scheduler, throw_often, plan, out, threads=threads, force=force, resume=resume)
        if as_json:
            print_json(out / "odds.json")
            return
        typer.echo("\n".join((*summary(plan, tallies), f"See {out}")))


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
            help="Value of another initial condition. [default: the paper's Fig. 6: "
            "psi=0.3, theta=1.2, phi=0.6, no velocity; z0=0.3 where it is no axis]",
        ),
    ] = None,
    zoom: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            "--zoom", metavar="X0 X1 Y0 Y1", help="Only this part of the plane, with the same number of pixels."
        ),
    ] = None,
    pixels: Annotated[
        tuple[int, int], typer.Option("--pixels", metavar="COLUMNS ROWS", help="Size of the map; one throw per pixel.")
    ] = (500, 500),
    die: DieFile = None,
    shape: Shape = None,
    edge: Edge = None,
    mass: Mass = None,
    chi: Annotated[float, typer.Option("--chi", help="Restitution, 0 to 1.")] = 0.2,
    mu: Mu = None,
    drag: Drag = 0.0,
    amplitude: Amplitude = 0.0,
    frequency: Frequency = 0.0,
    phase: Phase = 0.0,
    at_impact: Annotated[
        int | None, typer.Option("--at-impact", help="Colour by the face that is lowest at this impact.")
    ] = None,
    predictability: Annotated[
        bool,
        typer.Option("--predictability", help="Measure how precisely a condition must be known to predict the face."),
    ] = False,
    samples: Annotated[int, typer.Option("--samples", help="Conditions sampled for --predictability.")] = 8192,
    seed: Annotated[int, typer.Option("--seed", help="Seed of those conditions.")] = 1,
    threads: Threads = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Basins of attraction: the landed face over a plane of initial conditions, as picture and data."""
    with one_sentence_errors(), stopped_with(RESUMABLE):
        with checked_options():
            from ..commands.model.basin_maps import BasinsPlan, axes_of, fixed_from
            from ..model.laws import Table

            horizontal, vertical = axes_of(x, y, zoom, pixels)
            thrown, files = chosen_die(die, shape, edge, mass, usual=("tetrahedron", 0.040793))
            plan = BasinsPlan(
                x=horizontal,
                y=vertical,
                fixed=fixed_from(fix or []),
                die=thrown,
                die_files=files,
                chi=chi,
                mu=mu,
                drag_per_m=drag,
                table=Table(amplitude_m=amplitude, frequency_hz=frequency, phase_rad=phase),
                at_impact=at_impact,
                predictability=predictability,
                conditions=samples,
                seed=seed,
            )
        from ..commands.model.basin_maps import basins as map_basins
        from ..commands.model.basin_maps import summary

        mapped, measured = run_on(scheduler, map_basins, plan, out, threads=threads, force=force, resume=resume)
        if as_json:
            print_json(out / "basins.json")
            return
        typer.echo("\n".join((*summary(plan, mapped, measured), f"Look at it:  {out / 'basins.png'}")))


@app.command(epilog="Example:  diethrow lyapunov --shape tetrahedron --edge 0.040793 --orbits 8 --out out/lyapunov")
def lyapunov(
    out: OutFolder,
    die: DieFile = None,
    shape: Shape = None,
    edge: Edge = None,
    mass: Mass = None,
    chi: Annotated[
        float, typer.Option("--chi", help="Restitution, 0 to 1; below 1 only an oscillating table has an exponent.")
    ] = 1.0,
    mu: Mu = None,
    amplitude: Amplitude = 0.0,
    frequency: Frequency = 0.0,
    phase: Phase = 0.0,
    impacts: Annotated[int, typer.Option("--impacts", help="Impacts per orbit.")] = 10_000,
    orbits: Annotated[int, typer.Option("--orbits", help="Number of orbits, each from a neighbour of the start.")] = 8,
    leave_out: Annotated[
        int, typer.Option("--leave-out", help="First impacts of an orbit that are not counted.")
    ] = 200,
    position: Annotated[
        tuple[float, float, float], typer.Option("--position", metavar="X Y Z", help="Position at the start [m].")
    ] = (0.0, 0.0, 0.3),
    euler: Annotated[
        tuple[float, float, float],
        typer.Option("--euler", metavar="PSI THETA PHI", help="Euler angles at the start [rad]."),
    ] = (0.001, 0.00001, 0.0001),
    velocity: Annotated[
        tuple[float, float, float], typer.Option("--velocity", metavar="X Y Z", help="Velocity at the start [m/s].")
    ] = (0.6, 0.0, -0.7),
    omega_body: Annotated[
        tuple[float, float, float],
        typer.Option("--omega-body", metavar="XI ETA ZETA", help="Angular velocity at the start, body axes [rad/s]."),
    ] = (0.0, 60.0, 0.0),
    seed: Annotated[int, typer.Option("--seed", help="Seed of the neighbours.")] = 1,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """The largest Lyapunov exponent of a bouncing die; by default from the start of the paper's Fig. 5."""
    with one_sentence_errors():
        with checked_options():
            from ..commands.model.lyapunov_exponents import LyapunovPlan
            from ..model.laws import Table

            thrown, files = chosen_die(die, shape, edge, mass)
            plan = LyapunovPlan(
                die=thrown,
                die_files=files,
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
        from ..commands.model.lyapunov_exponents import lyapunov as follow
        from ..commands.model.lyapunov_exponents import summary

        with progress_bars() as progress:
            result = follow(plan, out, force=force, progress=progress, command=as_typed())
        if as_json:
            print_json(out / "lyapunov.json")
            return
        typer.echo("\n".join((*summary(plan, result), f"See {out}")))


@app.command(epilog="Example:  diethrow paper --quick --out out/paper")
def paper(
    out: OutFolder,
    quick: Annotated[
        bool, typer.Option("--quick", help="A hundredth of the throws: some minutes instead of tens.")
    ] = False,
    seed: Annotated[int, typer.Option("--seed", help="Seed of all random numbers.")] = 1,
    threads: Threads = None,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Replicate the results of Kapitaniak et al. (2012) on one page, with a verdict for each statement."""
    with one_sentence_errors():
        from ..paper.replication import paper as replicate
        from ..paper.replication import plan_of, summary

        with checked_options():
            plan = plan_of(quick, seed)
        with progress_bars() as progress:
            command = as_typed()
            result = replicate(
                plan, out, force=force, threads=threads or usable_cores(), progress=progress, command=command
            )
        if as_json:
            print_json(out / "paper.json")
            return
        typer.echo("\n".join((*summary(result), f"Look at it:  {out / 'paper.html'}")))
