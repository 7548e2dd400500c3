"""The analysis of one throw as a value: tables, plots, further fits and predictions, the report, the recording.

    >>> import diethrow as dt
    >>> a = dt.load("out/cube_wood")               # doctest: +SKIP
    >>> a.parameters.loc["chi", ["low", "high"]]   # doctest: +SKIP

`analyze` makes one from a scene, `load` from a folder; `save` writes the folder. Everything that needs pandas, matplotlib or
Rerun imports it when it is first asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..files.analysis_folder import AnalysedThrow, read_analysis, result_tables, write_values
from ..files.csv_and_json import write_json
from ..files.outputs import check_free_space, whole_folder
from ..files.scene import Scene, read_scene
from ..model.errors import InputError
from ..runs import PLAIN, Progress, Shown, silent

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from ..fitting.results import IntervalMethod


@dataclass(frozen=True, eq=False, repr=False)
class Analysis(AnalysedThrow):
    """One throw, measured and modelled."""

    # --- tables ---

    @cached_property
    def frames(self) -> pd.DataFrame:
        """The measured poses, one row a frame."""
        from .tables import frames_table

        return frames_table(self.track)

    @cached_property
    def simulated(self) -> pd.DataFrame | None:
        """The model's poses on the same frames; None without a model."""
        from .tables import frames_table

        return None if self.record.simulated is None else frames_table(self.record.simulated)

    @cached_property
    def bounces(self) -> pd.DataFrame:
        """The measured impacts."""
        from .tables import bounces_table

        return bounces_table(self.throw.impacts)

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """The parameters with their intervals."""
        from .tables import parameters_table

        return parameters_table(self.result.parameters)

    @cached_property
    def effects(self) -> pd.DataFrame:
        """The effects that were accepted and those that were refused."""
        from .tables import effects_table

        return effects_table(self.result.chosen, self.result.considered)

    @cached_property
    def covariance(self) -> pd.DataFrame | None:
        """Of initial conditions and free parameters; None without a fit."""
        from .tables import matrix_table

        found = self.result.covariance
        return None if found is None else matrix_table(found, self.result.covariance_names)

    # --- pictures ---

    @property
    def plot(self) -> Plots:
        """One method a figure, drawn on the axes it is given or on new ones."""
        return Plots(self)

    # --- further work ---

    def fit(self, effects: Sequence[str] | None = None, intervals: IntervalMethod = "profile") -> Analysis:
        """The same measured throw fitted again, with only some `effects` on trial (None: all), and other intervals.

        Raises ValueError for a name that is no effect."""
        from ..commands.clip.fit import refitted

        return _as_analysis(refitted(self, None if effects is None else tuple(effects), intervals))

    def predict(self, from_frame: int | None = None) -> pd.DataFrame:
        """The poses that the fitted law predicts from the frames before `from_frame` alone, with standard errors; None: before
        the first bounce. Raises ValueError where these frames determine no state."""
        from ..commands.clip.predict import predicted_track
        from .tables import frames_table

        return frames_table(predicted_track(self, from_frame))

    def report(self, path: str | Path, *, embed_replay: bool = False) -> Path:
        """Write the report, one HTML page, with the viewer in it if asked for."""
        from tempfile import TemporaryDirectory

        from ..replay.pages import write_report

        with TemporaryDirectory() as folder:
            replay = self.recording(Path(folder) / "replay.rrd") if embed_replay else None
            details = replace(self.details, tables=self.details.tables or self._tables(Path(folder) / "values"))
            write_report(Path(path), self.record, details, replay)
        return Path(path)

    def recording(self, path: str | Path) -> Path:
        """Write the Rerun recording. Raises OutputPlaceError where the disk has no room for it."""
        from ..commands.clip.fit import replay_bytes
        from ..replay.recording import write_recording

        check_free_space(Path(path), replay_bytes(self.record))

        write_recording(Path(path), self.record)
        return Path(path)

    def show(self) -> None:
        """Open the Rerun viewer; it listens on localhost only."""
        from tempfile import mkdtemp

        from ..commands.results.viewer import open_viewer

        open_viewer([self.recording(Path(mkdtemp(prefix="diethrow_")) / "replay.rrd")])

    def save(self, folder: str | Path, *, force: bool = False, shown: Shown = PLAIN) -> Analysis:
        """Write all results to a folder, from which `load` makes this value again; returns it with that folder.

        Raises OutputExistsError if the folder exists, unless `force`."""
        from ..replay.pages import write_figures, write_report

        out = Path(folder)
        with whole_folder(out, force=force, inputs=self.scene.settings_paths) as place:
            write_values(place, self)
            write_json(place / "provenance.json", dict(self.details.origin or {}))
            replay = self.recording(place / "replay.rrd")
            details = replace(self.details, tables=result_tables(place))
            write_report(place / "report.html", self.record, details, replay if shown.embed_replay else None)
            if shown.figures:
                write_figures(place / "figures", self.record, self.details)
        return replace(self, folder=out)

    # --- in a notebook ---

    def __repr__(self) -> str:
        bounces = len(self.throw.impacts)
        return f"<Analysis {self.record.title}: {self._chi}, {bounces} bounces, {self._tracked}>"

    def _repr_html_(self) -> str:
        """One screen: what was tracked, the parameters, and the reservations."""
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{_number(p.value)}</td><td>{_number(p.low)} to {_number(p.high)}</td></tr>"
            for name, p in self.result.parameters.items()
        )
        notes = "".join(f"<li>{escape(note)}</li>" for note in (*self.notices, *self.result.messages)[:6])
        return (
            f"<h4>{escape(self.record.title)}</h4><p>{escape(self._tracked)}, {len(self.throw.impacts)} bounces, of which the "
            f"model explains {self.result.bounces_fitted}</p><table><tr><th>parameter</th><th>value</th>"
            f"<th>interval</th></tr>{rows}</table><ul>{notes}</ul>"
        )

    def _tables(self, folder: Path) -> dict[str, str]:
        """The tables, by way of a new folder."""
        folder.mkdir()
        write_values(folder, self)
        return result_tables(folder)

    @property
    def _chi(self) -> str:
        chi = self.result.parameters["chi"]
        return "chi not determined" if chi.value is None else f"chi {_number(chi.value)}"

    @property
    def _tracked(self) -> str:
        return f"{int(self.track.tracked.sum())} of {len(self.track)} frames tracked"


@dataclass(frozen=True)
class Plots:
    """The figures of an analysis. Each method returns the axes it drew on; without axes it makes a figure with matplotlib."""

    analysis: Analysis

    def heights(self, ax: Axes | None = None) -> Axes:
        """Height of every corner, measured and simulated."""
        return self._drawn("heights", ax)

    def bounces(self, ax: Axes | None = None) -> Axes:
        """Apparent restitution of every bounce, with the fitted one."""
        return self._drawn("restitution", ax)

    def residuals(self, ax: Axes | None = None) -> Axes:
        """Position, measured minus simulated, in standard errors where these are known."""
        return self._drawn("residuals_position_sigmas", ax, "residuals_position")

    def rotation_residuals(self, ax: Axes | None = None) -> Axes:
        """Rotation from the simulated to the measured orientation, the same."""
        return self._drawn("residuals_rotation_sigmas", ax, "residuals_angle")

    def stroboscope(self, ax: Axes | None = None) -> Axes:
        """The whole throw in one picture; it needs the clip."""
        return self._drawn("stroboscope", ax)

    def correlation(self, ax: Axes | None = None) -> Axes:
        """Correlations of initial conditions and parameters."""
        return self._drawn("correlations", ax)

    def landing(self, ax: Axes | None = None) -> Axes:
        """Odds of the landing faces."""
        return self._drawn("odds", ax)

    def _drawn(self, name: str, ax: Axes | None, otherwise: str = "") -> Axes:
        from ..replay.pages import report_figures

        figures = {figure.name: figure for figure in report_figures(self.analysis.record, self.analysis.details)}
        figure = figures.get(name) or figures.get(otherwise)
        if figure is None:
            raise InputError(f"{name}: this analysis has no data for the figure; it has {', '.join(figures)}")
        if ax is None:
            from matplotlib import pyplot as plt

            ax = plt.subplots(figsize=figure.inches, layout="constrained")[1]
        return figure.draw(ax)


def analyze(
    scene: Scene | str | Path,
    out: str | Path | None = None,
    *,
    quality: str = "standard",
    every: int = 1,
    shrink: int = 1,
    timing: str = "corrected",
    intervals: str = "profile",
    force: bool = False,
    progress: Progress | None = None,
) -> Analysis:
    """Everything from the clip of a scene to the fit; with `out` also written to that folder, as `diethrow analyze` does.

    `progress` is called with the stage, the amount done and the total. Raises SceneError for a scene that cannot be analysed,
    RunError for a clip without a die, OutputExistsError for a folder that exists (unless `force`).

    >>> analyze("data_samples/cube_wood/scene.toml")   # doctest: +SKIP
    <Analysis cube_wood: chi 0.58288, 3 bounces, 239 of 260 frames tracked>
    """
    from ..commands.clip.analyze import analysed
    from ..commands.clip.analyze import analyze as analyze_into
    from ..commands.clip.run_options import RunOptions

    options = RunOptions(quality, every, shrink, timing, intervals).arguments("analyze")
    value = scene if isinstance(scene, Scene) else read_scene(Path(scene))
    if out is not None:
        return _as_analysis(analyze_into(value, Path(out), force=force, progress=progress or silent, **options))
    del options["shown"]
    return _as_analysis(analysed(value, progress=progress or silent, **options))


def load(folder: str | Path) -> Analysis:
    """The analysis that was saved in a folder. The clip is opened where it still is; else the figures made of it are left out.

    Raises FileNotFoundError for a folder without one, ValueError for files that are damaged or of a version that this program
    does not know."""
    from ..commands.clip.footage import clip_of_analysis

    found = read_analysis(Path(folder))
    return _as_analysis(replace(found, record=replace(found.record, clip=clip_of_analysis(found))))


def to_xarray(analysis: Analysis) -> Any:
    """The poses as an `xarray.Dataset` over the frames: position, quaternion, covariance, status.

    Raises ImportError where xarray is not installed."""
    xarray = import_module("xarray")
    track = analysis.track
    axes, parts = list("xyz"), ["x", "y", "z", "rx", "ry", "rz"]
    return xarray.Dataset(
        {
            "position_m": (("frame", "axis"), track.position_m, {"units": "m", "frame": "world"}),
            "quaternion": (("frame", "component"), track.quaternion, {"order": "wxyz, body to world"}),
            "covariance": (("frame", "row", "column"), track.covariance, {"units": "m, rad", "frame": "world"}),
            "status": ("frame", track.status.astype(str)),
        },
        coords={
            "frame": track.frame,
            "time_s": ("frame", track.time_s, {"units": "s"}),
            "axis": axes,
            "component": list("wxyz"),
            "row": parts,
            "column": parts,
        },
        attrs={"title": analysis.record.title},
    )


def _as_analysis(found: AnalysedThrow) -> Analysis:
    return Analysis(**{part.name: getattr(found, part.name) for part in fields(found)})


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.5g}"
