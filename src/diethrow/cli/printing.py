"""Results of a command in a few lines on standard output; notes on standard error."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from math import floor, log10
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from .logs import LOGGER

if TYPE_CHECKING:
    from ..commands.clip.batch import Batch
    from ..commands.clip.calibrate import CameraFound
    from ..commands.clip.check import Check
    from ..commands.clip.joint_fit import FitOfMany
    from ..commands.clip.new_scene import FoundFile, NewScene
    from ..commands.clip.run_options import RunOptions
    from ..commands.model.filmed_throw import FilmJob
    from ..commands.results.joined_recordings import ThrowRecording
    from ..files.analysis_folder import AnalysedThrow
    from ..fitting.results import Parameter
    from ..model.throw import ThrowResult
    from ..replay.pages import Trade
    from ..runs import Tracking


def print_json(record: Path | Mapping[str, Any]) -> None:
    """A record, or the file that holds it, as JSON."""
    if isinstance(record, Path):
        typer.echo(record.read_text(encoding="utf-8").rstrip())
        return
    from ..files.csv_and_json import plain

    typer.echo(json.dumps(plain(record), indent=1, ensure_ascii=False, allow_nan=False))


def _json_of(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def print_analysis(analysis: AnalysedThrow, as_json: bool = False) -> None:
    """The result of an analysis."""
    assert analysis.folder is not None
    if as_json:
        print_json(
            {
                "folder": str(analysis.folder),
                "frames": len(analysis.track),
                "frames_tracked": int(analysis.track.tracked.sum()),
                "bounces": len(analysis.throw.impacts),
                "fit": _json_of(analysis.folder / "fit.json"),
                "notices": analysis.notices,
            }
        )
        return
    rms = analysis.result.residual_rms
    rows = [
        ("frames tracked", f"{int(analysis.track.tracked.sum())} of {len(analysis.track)}"),
        (
            "bounces",
            f"{len(analysis.throw.impacts)}, of which the model explains {analysis.result.bounces_fitted}",
        ),
        ("restitution χ", _restitution(analysis.result.parameters["chi"])),
        *([] if rms is None else [("residuals", f"{rms:.2f} sigma")]),
        ("report", str(analysis.folder / "report.html")),
        ("open it", f"diethrow replay {analysis.folder} --open"),
    ]
    _print_table(rows)
    print_notices((*analysis.notices, *analysis.result.messages))


def print_tracking(result: Tracking, out: Path, as_json: bool = False) -> None:
    """Frames tracked and bounces found."""
    tracked, total = int(result.frames.tracked.sum()), len(result.frames)
    if as_json:
        bounces = len(result.measured.impacts)
        counts = {"folder": str(out), "frames": total, "frames_tracked": tracked, "bounces": bounces}
        print_json({**counts, "notices": result.notices})
        return
    print_notices(result.notices)
    typer.echo(f"{tracked} of {total} frames tracked, {len(result.measured.impacts)} bounces; see {out}")


def print_joint_fit(result: FitOfMany) -> None:
    """Parameters that the throws share."""
    rows = [
        ("throws", f"{len(result.fit.throws)} fitted, {len(result.left_out)} left out"),
        *((name, _with_interval(parameter)) for name, parameter in result.fit.parameters.items()),
        ("see", str(result.folder / "fit.json")),
    ]
    _print_table(rows)
    print_notices((*result.fit.messages, *result.left_out))


def print_throw(result: ThrowResult, out: Path) -> None:
    """Impacts, landed face and ending of a simulated throw."""
    face = "unknown" if result.landed_face is None else result.landed_face
    typer.echo(f"{result.impact_count} impacts, landed face {face}. {result.ending.value}")
    typer.echo(f"Open it:  diethrow replay {out} --open")


def print_film(job: FilmJob, out: Path) -> None:
    """The size of a rendered clip, and the command that analyses it."""
    typer.echo(f"{job.frames} frames of {job.camera.width_px} x {job.camera.height_px} pixels")
    typer.echo(f"Next:  diethrow analyze {out / 'scene.toml'} --out {out.with_name(out.name + '_analysed')}")


def print_presets(rows: list[tuple[str, str]]) -> None:
    """Names and sentences of the presets of a film."""
    _print_table(rows)


def print_batch(result: Batch, out: Path) -> None:
    """Clips finished, and the reason of every failure."""
    for failure in result.failures:
        typer.echo(f"failed: {failure.scene}: {failure.reason.removeprefix(failure.scene + ': ')}", err=True)
    finished = f"{len(result.results)} of {len(result.results) + len(result.failures)} clips finished"
    typer.echo(f"{finished}, {result.kept} of them earlier; see {out / 'results.csv'}")
    if result.failures:
        typer.echo(f"{len(result.failures)} failed; see {out / 'failures.csv'}")


def batch_record(result: Batch, out: Path) -> dict[str, Any]:
    """The same as plain values."""
    failures = [{"scene": failure.scene, "reason": failure.reason} for failure in result.failures]
    return {"folder": str(out), "finished": len(result.results), "finished_earlier": result.kept, "failures": failures}


def print_camera(found: CameraFound, out: Path) -> None:
    """The camera and, with a picture of the table, its position."""
    camera, errors = found.calibration, found.calibration.sigmas
    typer.echo(
        f"{len(camera.boards)} of {found.pictures} pictures, residuals {camera.rms_px:.3g} px, "
        f"focal length {camera.matrix[0, 0]:.6g} ± {errors[0]:.2g} px"
    )
    if found.table is not None:
        x, y, z = 1e3 * found.table.camera.centre_m
        typer.echo(f"The camera is at {x:.4g}, {y:.4g}, {z:.4g} mm, {z:.4g} mm above the table")
    print_notices(found.notices)
    typer.echo(f"Open it:  {out / 'calibration.html'}; paste {out / 'camera.toml'} into the scene")


def print_throws(found: Sequence[ThrowRecording]) -> None:
    """One row per throw."""
    from rich.console import Console
    from rich.table import Table

    from ..replay.elements import short_interval

    table = Table(box=None, pad_edge=False)
    for name in ("throw", "χ (95 % interval)", "σ", "face", "verdict"):
        table.add_column(name, no_wrap=name != "throw", overflow="fold")
    for one in found:
        properties = one.properties
        chi = short_interval(*(properties.get(name) for name in ("chi", "chi_low", "chi_high")))
        rms = properties.get("residual_rms")
        cells = (
            "" if rms is None else f"{rms:.2f}",
            str(properties.get("landed_face", "")),
            str(properties.get("verdict", "")),
        )
        table.add_row(one.name, chi if "chi" in properties else "", *cells)
    Console(highlight=False, markup=False, soft_wrap=True).print(table)


def _print_table(rows: Iterable[Sequence[str]], *headings: str) -> None:
    """Rows in columns, without markup and line breaks."""
    from rich.console import Console
    from rich.table import Table

    table = Table(*headings, show_header=bool(headings), box=None, pad_edge=False)
    for row in rows:
        table.add_row(*row)
    Console(highlight=False, markup=False, soft_wrap=True).print(table)


def _with_interval(parameter: Parameter) -> str:
    """The value with its interval, in four digits."""
    if parameter.low is None or parameter.high is None or parameter.level is None:
        return f"{parameter.value:.4g}, no interval"
    return f"{parameter.value:.4g}  ({100 * parameter.level:.0f} %: {parameter.low:.4g} to {parameter.high:.4g})"


def print_trade(result: Trade) -> None:
    """One row per setting, an asterisk for those on the front, and the setting to use."""
    rows = []
    for s in result.settings:
        chi = "" if s.chi is None else f"{s.chi:.5f}"
        width = "" if s.half_width is None else f"{s.half_width:.1e}"
        off = s.error if s.kind == "model" else s.chi_error
        covered = "" if s.coverage is None else f"{s.coverage:.0%}"
        wrong = "" if off is None else f"{off:.1e}"
        rows.append(("*" if s.on_front else "", s.name, f"{s.rate:.3g}", chi, width, wrong, covered))
    _print_table(rows, "", "setting", "per second", "χ", "±", "error", "coverage")
    typer.echo(result.advice)


def print_check(result: Check) -> None:
    """One row per finding."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 1, 0))
    table.add_column("")
    table.add_column("verdict")
    table.add_column("measured", overflow="fold")
    table.add_column("what to change", overflow="fold")
    styles = {"good": "green", "doubtful": "yellow", "bad": "bold red"}
    for finding in result.findings:
        word = finding.verdict.value
        table.add_row(finding.name, f"[{styles[word]}]{word}[/]", *_plain_cells(finding.measured, finding.advice))
    Console(highlight=False).print(table)


def _plain_cells(*texts: str) -> tuple[str, ...]:
    """Texts with their markup escaped."""
    from rich.markup import escape

    return tuple(escape(text) for text in texts)


def _restitution(chi: Parameter) -> str:
    """The value with its interval, in as many digits as the interval's width supports."""
    if chi.value is None:
        return "not determined"
    if chi.low is None or chi.high is None or chi.level is None:
        return f"{chi.value:.4f}, no interval"
    width = chi.high - chi.low
    digits = 4 if width <= 0 else min(max(3, 1 - floor(log10(width))), 9)
    return f"{chi.value:.{digits}f}  ({100 * chi.level:.0f} %: {chi.low:.{digits}f} to {chi.high:.{digits}f})"


def print_setting(chi_within: float, options: RunOptions) -> None:
    """Which options a wanted half-width of χ has led to."""
    LOGGER.warning("chosen for χ ± %g: %s", chi_within, " ".join(options.words("track")))


def print_notices(sentences: tuple[str, ...]) -> None:
    """One line per note."""
    for sentence in sentences:
        LOGGER.warning("%s", sentence)


def print_found_files(files: Sequence[FoundFile]) -> None:
    """The files of a folder, and what each seems to be."""
    _print_table([(one.path.name, f"{one.role}: {one.said}") for one in files])


def print_new_scene(made: NewScene, as_json: bool) -> None:
    """The scene of a folder: what is missing, or the verdicts and the next command."""
    if as_json:
        print_json(
            {
                "scene": str(made.path),
                "files": [{"path": str(one.path), "role": one.role, "found": one.said} for one in made.files],
                "missing": list(made.missing),
                "verdicts": {}
                if made.check is None
                else {finding.name: finding.verdict.value for finding in made.check.findings},
                "first_frame": None if made.first_frame is None else str(made.first_frame),
                "notices": list(made.notices),
            }
        )
        return
    print_notices(made.notices)
    if made.check is not None:
        print_check(made.check)
    if made.first_frame is not None:
        typer.echo(f"The first frame with the die found in it: {made.first_frame}")
    typer.echo(f"The scene is {made.path}")
    for sentence in made.missing:
        typer.echo(f"missing  {sentence}")
    if made.missing:
        typer.echo(f"Complete {made.path} by hand, or give what is missing and run `diethrow new` with --force")
    elif made.check is not None and not made.check.bad:
        typer.echo(f"Next:  diethrow analyze {made.path} --out out/{made.path.resolve().parent.name}")
