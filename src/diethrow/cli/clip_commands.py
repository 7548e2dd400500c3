"""Commands that work on clips and tracks: analyze, track, fit, predict, batch, trade, check, calibrate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from .app import app
from .errors import CLIPS_KEPT, FAILED, MISUSED, checked_options, one_sentence_errors, stop_with_status, stopped_with
from .options import (
    AllowOutside,
    AsJson,
    BoardKind,
    ChiWithin,
    DieAndTable,
    EffectsOnTrial,
    EmbedReplay,
    Every,
    Figures,
    Fineness,
    Force,
    FrameTiming,
    Intervals,
    MarkerDictionary,
    MarkerSide,
    MisfitLimit,
    OutFolder,
    SceneFile,
    Scheduler,
    Shrink,
    Squares,
    Threads,
    TradeFile,
    UsualFriction,
    as_typed,
    check_half_width,
    checked_scene,
    choices_of,
    command_words,
    executor_for,
    given_option,
    output_words,
    run_on,
    two_counts,
)
from .printing import (
    batch_record,
    print_analysis,
    print_batch,
    print_camera,
    print_check,
    print_found_files,
    print_joint_fit,
    print_json,
    print_new_scene,
    print_notices,
    print_setting,
    print_tracking,
    print_trade,
)
from .progress import announce_for_workers, announcing, batch_bar, progress_bars


@app.command(
    epilog="Example:  diethrow analyze clips/cube_wood/scene.toml --out out/cube_wood; one page with the replay in it:  "
    "diethrow analyze clips/cube_wood/scene.toml --embed-replay --out out/cube_wood"
)
def analyze(
    scene: SceneFile,
    out: OutFolder,
    quality: Fineness = "standard",
    every: Every = 1,
    shrink: Shrink = 1,
    timing: FrameTiming = "corrected",
    intervals: Intervals = "profile",
    chi_within: ChiWithin = None,
    trade_file: TradeFile = None,
    embed_replay: EmbedReplay = False,
    figures: Figures = False,
    allow_outside: AllowOutside = False,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """From clip to replay: track the die, find its bounces, fit the model; write tables, a recording and a report."""
    with one_sentence_errors():
        checked = checked_scene(scene, allow_outside)
        from ..commands.clip.analyze import analyze as analyze_scene
        from ..commands.clip.run_options import RunOptions

        with checked_options():
            check_half_width(chi_within, trade_file)
        options, tracked = RunOptions(quality, every, shrink, timing, intervals, embed_replay, figures), None
        with progress_bars() as progress:
            if chi_within is not None:
                from ..commands.clip.trade import setting_for

                chosen = setting_for(checked, chi_within, trade_file, progress)
                less = chosen.decimation
                # What was tracked to choose the setting has the times as they are usually corrected.
                tracked = chosen.tracked if timing == "corrected" else None
                options = replace(options, quality=chosen.quality, every=less.every, shrink=less.shrink)
                print_setting(chi_within, options)
        with progress_bars("analyze") as progress:
            result = analyze_scene(
                checked,
                out,
                force=force,
                progress=progress,
                command=(*command_words("analyze", scene, out, force, allow_outside), *options.words("analyze")),
                tracked=tracked,
                **options.arguments("analyze"),
            )
        print_analysis(result, as_json)


@app.command(epilog="Example:  diethrow track clips/cube_wood/scene.toml --out out/track")
def track(
    scene: SceneFile,
    out: OutFolder,
    quality: Fineness = "standard",
    every: Every = 1,
    shrink: Shrink = 1,
    timing: FrameTiming = "corrected",
    allow_outside: AllowOutside = False,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """The tracking stage alone: poses with covariances, and bounces."""
    with one_sentence_errors():
        checked = checked_scene(scene, allow_outside)
        from ..commands.clip.run_options import RunOptions
        from ..commands.clip.track import track_only

        options = RunOptions(quality, every, shrink, timing)
        with progress_bars() as progress:
            result = track_only(
                checked,
                out,
                force=force,
                progress=progress,
                command=(*command_words("track", scene, out, force, allow_outside), *options.words("track")),
                **options.arguments("track"),
            )
        print_tracking(result, out, as_json)


@app.command(
    epilog="Example:  diethrow fit out/track/track_frames.csv --scene clips/cube_wood/scene.toml --out out/fit"
)
def fit(
    tracks: Annotated[
        list[Path],
        typer.Argument(
            metavar="TRACK.csv...", help="A track, with its covariances beside it; several tracks: a joint fit."
        ),
    ],
    scene: DieAndTable,
    out: OutFolder,
    intervals: Intervals = "profile",
    misfit_limit: MisfitLimit = None,
    usual_friction: UsualFriction = None,
    effects: EffectsOnTrial = None,
    threads: Threads = None,
    scheduler: Scheduler = None,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """The fitting stage alone, on any track with the columns of track.csv; of several, the shared parameters."""
    with one_sentence_errors():
        checked = checked_scene(scene, allow_outside=True)  # no footage is opened
        with checked_options():
            choices = choices_of(intervals, misfit_limit, usual_friction, effects)
        own = (
            *given_option("--intervals", intervals, "profile"),
            *given_option("--misfit-limit", misfit_limit, None),
            *given_option("--usual-friction", usual_friction, None),
            *given_option("--effects", effects, None),
        )
        if len(tracks) > 1:
            if own:
                stop_with_status(
                    f"{own[0]} does not apply to several tracks, whose joint fit has its own search and resamples throws; leave "
                    "it out",
                    MISUSED,
                )
            from ..commands.clip.joint_fit import fit_tracks

            joint = run_on(scheduler, fit_tracks, tracks, checked, out, threads=threads, force=force)
            if as_json:
                print_json(out / "fit.json")
            else:
                print_joint_fit(joint)
            return
        from ..commands.clip.fit import fit_track

        command = ("diethrow", "fit", str(tracks[0]), "--scene", str(scene), *output_words(out, force), *own)
        with progress_bars() as progress:
            result = fit_track(
                tracks[0], checked, out, force=force, choices=choices, progress=progress, command=command
            )
        print_analysis(result, as_json)


@app.command(
    epilog="Example:  diethrow predict tosses/*.csv --scene tosses/scene.toml --fit out/joint/fit.json "
    "--from-frame first-bounce --out out/predicted"
)
def predict(
    tracks: Annotated[list[Path], typer.Argument(metavar="TRACK.csv...", help="Tracks from any tracker.")],
    scene: DieAndTable,
    fit: Annotated[
        Path,
        typer.Option("--fit", metavar="FIT.json", help="The fit whose parameters are used, of one throw or of many."),
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="CSV|DIR", help="A CSV file for one track; a folder for several.")
    ],
    from_frame: Annotated[
        str,
        typer.Option("--from-frame", metavar="K|first-bounce", help="Only frames before this one determine the state."),
    ] = "first-bounce",
    draws: Annotated[
        int | None,
        typer.Option(
            "--draws", min=0, help="Throws sampled for the odds of the faces. [default: 100 for one track, else 0]"
        ),
    ] = None,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Predict throws: estimate the state from the frames before K and simulate to the last frame with a fit's parameters."""
    with one_sentence_errors():
        checked = checked_scene(scene, allow_outside=True)  # no footage is opened
        from ..commands.clip.predict import predict_tracks, prediction_table, summary
        from ..fitting.predict import DRAWS

        drawn = (DRAWS if len(tracks) == 1 else 0) if draws is None else draws
        read = (*map(str, tracks), "--scene", str(scene), "--fit", str(fit), "--from-frame", from_frame)
        command = ("diethrow", "predict", *read, "--draws", str(drawn), *output_words(out, force))
        with progress_bars() as progress:
            made, left_out = predict_tracks(
                tracks,
                checked,
                fit,
                out,
                from_frame=from_frame,
                draws=drawn,
                force=force,
                progress=progress,
                command=command,
            )
        if as_json:
            print_json({"out": str(out), "throws": [prediction_table(one) for one in made], "left_out": left_out})
            return
        typer.echo("\n".join(summary(made, checked.die)))
        print_notices(left_out)
        typer.echo(f"See {out}")


@app.command(epilog="Example:  diethrow batch clips/*/scene.toml --out out/all --workers 4")
def batch(
    scenes: Annotated[list[Path], typer.Argument(metavar="SCENES...", help="Scene files; each gets a folder in DIR.")],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder of all results; an existing one is continued.")
    ],
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Number of local processes. [default: one per core]")
    ] = None,
    scheduler: Scheduler = None,
    quality: Fineness = "standard",
    every: Every = 1,
    shrink: Shrink = 1,
    timing: FrameTiming = "corrected",
    intervals: Intervals = "profile",
    chi_within: ChiWithin = None,
    trade_file: TradeFile = None,
    embed_replay: EmbedReplay = False,
    figures: Figures = False,
    only_track: Annotated[
        bool, typer.Option("--only-track", help="Run the tracking stage alone, as diethrow track.")
    ] = False,
    as_json: AsJson = False,
    allow_outside: AllowOutside = False,
) -> None:
    """Analyse many scenes: results.csv, failures.csv, and a folder for each scene.

    A finished clip is analysed again only if its files, the version or the options changed. The exit status is 1 if a clip
    failed. After Ctrl-C or a kill, the same command continues with the unfinished clips.
    """
    with one_sentence_errors(), stopped_with(CLIPS_KEPT):
        from ..commands.clip.batch import run_batch
        from ..commands.clip.run_options import RunOptions

        options = RunOptions(quality, every, shrink, timing, intervals, embed_replay, figures)
        with checked_options():
            check_half_width(chi_within, trade_file)
            if only_track:
                options.refuse_those_of_analyze()
        if chi_within is not None:
            if trade_file is None:
                stop_with_status(
                    "--chi-within of a batch needs --trade, the measurements of one scene for all; or run analyze for each",
                    MISUSED,
                )
            from ..commands.clip.trade import setting_from

            chosen, less = setting_from(trade_file, chi_within)
            options = replace(options, quality=chosen, every=less.every, shrink=less.shrink)
            print_setting(chi_within, options)
        if scheduler is None:
            announce_for_workers()
        with executor_for(scheduler) as executor, batch_bar() as progress:
            result = run_batch(
                scenes,
                out,
                executor=executor,
                workers=workers,
                stage="track" if only_track else "analyze",
                options=options,
                allow_outside=allow_outside,
                progress=progress,
            )
        if as_json:
            print_json(batch_record(result, out))
        else:
            print_batch(result, out)
        if result.failures:
            raise typer.Exit(FAILED)


@app.command(
    epilog="Example:  diethrow trade clips/cube_wood/scene.toml --chi-within 0.01 --out out/trade; then  "
    "diethrow analyze clips/another/scene.toml --chi-within 0.01 --trade out/trade/trade.json --out out/another"
)
def trade(
    scene: SceneFile,
    out: OutFolder,
    chi_within: Annotated[
        float, typer.Option("--chi-within", metavar="WIDTH", help="Wanted half-width of the 95 % interval of χ.")
    ] = 0.01,
    coverage: Annotated[
        int, typer.Option("--coverage", min=0, metavar="N", help="Simulated tracks per coverage rate; 0: none.")
    ] = 20,
    allow_outside: AllowOutside = False,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Measure speed against accuracy on one scene: tracking, fit and model from coarse to fine, and the setting to use."""
    with one_sentence_errors():
        checked = checked_scene(scene, allow_outside)
        from ..commands.clip.trade import trade as measure_trade

        with checked_options():
            check_half_width(chi_within)
        how = ("--chi-within", str(chi_within), *given_option("--coverage", coverage, 20))
        with progress_bars() as progress:
            result = measure_trade(
                checked,
                out,
                within=chi_within,
                draws=coverage,
                force=force,
                progress=progress,
                command=(*command_words("trade", scene, out, force, allow_outside), *how),
            )
        if as_json:
            print_json(out / "trade.json")
            return
        print_trade(result)
        typer.echo(f"See {out / 'trade.html'}")


@app.command(
    epilog="Examples:  diethrow new clips/throw_7     (asks what the files do not say)\n\n"
    "diethrow new clips/throw_7 --yes --fps 1500 --edge-mm 16 --mass-g 4.8 --square-mm 10 --marker-mm 7.5"
)
def new(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="A folder with a clip, and perhaps pictures of a board and a background."
        ),
    ],
    shape: Annotated[
        str | None, typer.Option("--shape", help="The die: cube, tetrahedron, ... [default: cube]")
    ] = None,
    edge_mm: Annotated[float | None, typer.Option("--edge-mm", metavar="MM", help="Its edge, by caliper.")] = None,
    mass_g: Annotated[float | None, typer.Option("--mass-g", metavar="G", help="Its mass.")] = None,
    fps: Annotated[
        float | None, typer.Option("--fps", metavar="HZ", help="Recording rate, where the file has none.")
    ] = None,
    exposure_s: Annotated[
        float | None, typer.Option("--exposure-s", metavar="S", help="Time of the open shutter.")
    ] = None,
    surface: Annotated[
        str, typer.Option("--surface", help="The table, as text; mirror: it reflects the die.")
    ] = "wood",
    squares: Squares = "7x5",
    board: BoardKind = "charuco",
    square_mm: Annotated[
        float | None, typer.Option("--square-mm", metavar="MM", help="Side of a square as printed.")
    ] = None,
    marker_mm: MarkerSide = None,
    dictionary: MarkerDictionary = "DICT_4X4_50",
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing: what is not given stays open.")] = False,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Make a scene from a folder with a clip: find the files, read the camera's data, calibrate, check, and show the die found.

    The exit status is 1 where something is missing or a verdict is bad.
    """
    with one_sentence_errors():
        from ..commands.clip.new_scene import Answers, look_through, new_scene, read_clip_facts

        with checked_options():
            counts = two_counts("squares", squares)
        files = look_through(folder)
        if not as_json:
            print_found_files(files)
        clip = next((read_clip_facts(one.path) for one in files if one.role == "clip"), None)
        ask = not yes and not as_json and clip is not None
        if ask and clip is not None:
            shape = shape or typer.prompt("Shape of the die", default="cube")
            edge_mm = edge_mm or typer.prompt("Its edge in millimetres, by caliper", type=float)
            mass_g = mass_g or typer.prompt("Its mass in grams", type=float)
            if fps is None and clip.rate_hz is None:
                fps = typer.prompt("Recording rate in frames per second (not that of a player)", type=float)
            if square_mm is None and any(one.role == "board" for one in files):
                square_mm = typer.prompt("Side of a square of the board in millimetres", type=float)
                marker_mm = marker_mm or (typer.prompt("Side of a marker", type=float) if board == "charuco" else None)
        answers = Answers(
            shape=shape or "cube",
            edge_mm=edge_mm,
            mass_g=mass_g,
            fps=fps,
            exposure_s=exposure_s,
            surface=surface,
            board=board,
            squares=counts,
            square_mm=square_mm,
            marker_mm=marker_mm,
            dictionary=dictionary,
        )
        with announcing():
            made = new_scene(
                folder, answers, force=force, progress=lambda text: None if as_json else typer.echo(f"{text} ...")
            )
        print_new_scene(made, as_json)
        if made.missing or (made.check is not None and made.check.bad):
            raise typer.Exit(FAILED)


@app.command(epilog="Example:  diethrow check clips/cube_wood/scene.toml --out out/check")
def check(
    scene: SceneFile,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder for check.json and check.html. [default: none]"),
    ] = None,
    timing: FrameTiming = "corrected",
    allow_outside: AllowOutside = False,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Check a clip before tracking: timing, blur, pixels, background, scale and vertical, each with a verdict.

    The exit status is 1 if a verdict is bad.
    """
    with one_sentence_errors():
        checked = checked_scene(scene, allow_outside)
        from ..commands.clip.check import check_clip, record
        from ..commands.clip.run_options import RunOptions

        times = RunOptions(timing=timing).arguments("track")["timing"]
        with announcing():
            result = check_clip(checked, out, timing=times, force=force, command=as_typed())
        if as_json:
            print_json(record(result))
        else:
            print_check(result)
        if out is not None and not as_json:
            typer.echo(f"See {out / 'check.html'}")
        if result.bad:
            raise typer.Exit(FAILED)


@app.command(
    epilog="Example:  diethrow calibrate board_*.png --table board_on_table.png --squares 7x5 --square-mm 10 "
    "--marker-mm 7.5 --out out/camera"
)
def calibrate(
    pictures: Annotated[
        list[Path],
        typer.Argument(metavar="PICTURES...", help="Pictures or films of the board, tilted in all directions."),
    ],
    out: OutFolder,
    square_mm: Annotated[float, typer.Option("--square-mm", metavar="MM", help="Side of a square as printed.")],
    square_sigma_mm: Annotated[
        float | None,
        typer.Option("--square-sigma-mm", metavar="MM", help="Standard error of that side; left out: 0.1 % of it."),
    ] = None,
    squares: Squares = "7x5",
    board: BoardKind = "charuco",
    marker_mm: MarkerSide = None,
    dictionary: MarkerDictionary = "DICT_4X4_50",
    table: Annotated[
        Path | None,
        typer.Option(
            "--table",
            metavar="PICTURE",
            help="Picture or film of the board flat on the table: gives the camera's pose.",
        ),
    ] = None,
    thickness_mm: Annotated[
        float, typer.Option("--thickness-mm", metavar="MM", help="Thickness of the board that lies on the table.")
    ] = 0.0,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Camera and table pose from pictures of a ChArUco board or a chessboard: camera.toml, calibration.json and a page."""
    with one_sentence_errors():
        with checked_options():
            from ..tracking.calibration import make_board

            columns, rows = two_counts("squares", squares)
            marker_m = None if marker_mm is None else 1e-3 * marker_mm
            sigma_m = None if square_sigma_mm is None else 1e-3 * square_sigma_mm
            printed = make_board(board, columns, rows, 1e-3 * square_mm, marker_m, dictionary, sigma_m)
        from ..commands.clip.calibrate import calibrate_camera

        with announcing():
            found = calibrate_camera(
                pictures, printed, out, table=table, thickness_m=1e-3 * thickness_mm, force=force, command=as_typed()
            )
        if as_json:
            print_json(out / "calibration.json")
            return
        print_camera(found, out)
