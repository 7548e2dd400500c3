"""The page of speed against accuracy: the settings that were tried, their Pareto front, and the recommended one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from ...tracking.footage import Decimation
from ..elements import IMPACT, MEASURED, SIMULATED, hex_colour
from ..figures import remove_box
from .captioned_figures import CaptionedFigure
from .matplotlib_figures import captioned_plot
from .page_parts import WIDE, as_table, whole_page

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NARROW_SPEED_RANGE = 8.0
"""Ratio of the fastest to the slowest setting up to which the speed axis also has numbers between 1, 2 and 5."""


@dataclass(frozen=True)
class Setting:
    """One choice of options with its speed and accuracy."""

    kind: str
    """`tracking`, `work`, `fit` or `model`."""
    name: str
    rate: float
    """Frames of the clip, fits or throws per second of processor time."""
    seconds: float
    """Processor time."""
    error: float | None
    """See `ERRORS`; None if there is no result to compare."""
    chi: float | None = None
    chi_low: float | None = None
    chi_high: float | None = None
    chi_error: float | None = None
    """|χ - χ of the reference|."""
    coverage: float | None = None
    """Share of the intervals that contain the true χ."""
    options: tuple[str, ...] = ()
    """The options of `diethrow analyze` that select it."""
    on_front: bool = False
    """Whether it lies on the Pareto front: no other setting is both faster and more accurate."""
    why_not: str | None = None
    """Why there is no result."""

    @property
    def half_width(self) -> float | None:
        """The longer side of the χ interval."""
        if self.chi is None or self.chi_low is None or self.chi_high is None:
            return None
        return max(self.chi_high - self.chi, self.chi - self.chi_low)

    @property
    def choice(self) -> tuple[str, Decimation]:
        """Quality and decimation that the options of a tracking name."""
        values = dict(zip(self.options[::2], self.options[1::2], strict=True))
        return values["--quality"], Decimation(int(values.get("--every", "1")), int(values.get("--shrink", "1")))

    @property
    def chi_uncertainty(self) -> float | None:
        """Possible error of χ: the longer side of its interval or its difference from the reference, whichever is larger."""
        if self.half_width is None:
            return None
        return max(self.half_width, self.chi_error or 0.0)


ERRORS = {
    "tracking": "median distance of the corners from the finest run [mm]",
    "work": "median distance of the corners from the finest run [mm]",
    "fit": "difference of χ from the reference",
    "model": "share of throws that land on another face",
}
"""Meaning of `Setting.error` by kind."""


@dataclass(frozen=True)
class Trade:
    """All settings that were tried."""

    settings: tuple[Setting, ...]
    reference: str
    """What χ is compared with."""
    within: float
    """Requested uncertainty of χ."""

    def of(self, kind: str) -> tuple[Setting, ...]:
        """The settings of one kind."""
        return tuple(setting for setting in self.settings if setting.kind == kind)

    @property
    def recommended(self) -> Setting | None:
        """The fastest tracking whose χ is certain to `within`; None if there is none."""
        return fastest_within(self.of("tracking"), self.within)

    @property
    def advice(self) -> str:
        """One line."""
        best = self.recommended
        if best is None:
            reached = [s.chi_uncertainty for s in self.of("tracking") if s.chi_uncertainty is not None]
            best_reached = f"the best reaches ±{min(reached):.2g}" if reached else "none gives χ"
            return f"No setting gives χ to ±{self.within:g} on this scene: {best_reached}."
        options = " ".join(best.options) or "no option"
        return (
            f"For χ to ±{self.within:g}: diethrow analyze with {options}, {best.rate:.0f} frames per second, reaches "
            f"±{best.chi_uncertainty:.2g}."
        )


def fastest_within(settings: Sequence[Setting], within: float) -> Setting | None:
    """The fastest setting whose χ is certain to `within`; None if there is none."""
    good = [s for s in settings if s.chi_uncertainty is not None and s.chi_uncertainty <= within]
    return max(good, key=lambda s: s.rate, default=None)


# --- the page ---

_RATES = {"tracking": "frames/s", "work": "frames/s", "fit": "fits/s", "model": "throws/s"}
_FORMATS = {"tracking": ".3g", "work": ".3g", "fit": ".0%", "model": ".2%"}
_HEADINGS = {
    "tracking": "Tracking",
    "work": "Tracking at standard quality, one number changed",
    "fit": "Fit, on the finest track",
    "model": "Model",
}


def trade_page(title: str, trade: Trade) -> str:
    """The page as HTML."""
    parts = [
        f"<h1>Speed against accuracy: {escape(title)}</h1>",
        f'<div class="verdict"><p class="headline">{escape(trade.advice)}</p>'
        f"<p>χ is compared with {escape(trade.reference)}. Speeds are per second of processor time, all stages of a "
        "setting together. Bold: no other setting is both faster and more accurate.</p></div>",
    ]
    for kind, heading in _HEADINGS.items():
        settings = trade.of(kind)
        if settings:
            parts += [f"<h2>{heading}</h2>", *(_figure_html(each) for each in _figures(trade) if each.name == kind)]
            parts += [_table(kind, settings), *_reasons(settings)]
    return whole_page(title, parts, "td:nth-child(2) { white-space: nowrap; }")


def write_trade_figures(folder: Path, trade: Trade) -> None:
    """Write the figures of the page: tracking.png, work.png, fit.png, model.png, and each as SVG."""
    for figure in _figures(trade):
        figure.write(folder)


def speed_against_error(
    ax: Axes, settings: Sequence[Setting], error_of: Callable[[Setting], float | None], x: str, y: str
) -> Axes:
    """One point per setting on logarithmic axes, the Pareto front as a line; an error of 0 stands at the lower edge."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    known = [(s, e) for s in settings if (e := error_of(s)) is not None and s.rate > 0.0]
    floor = 0.5 * min((e for _, e in known if e > 0.0), default=1.0)
    points = [(s, max(e, floor)) for s, e in known]
    front = sorted(((s.rate, e) for s, e in points if s.on_front), key=lambda point: point[0])
    ax.plot(*zip(*front, strict=True), color=hex_colour(SIMULATED), linewidth=1.2, zorder=1) if front else None
    for number, (setting, value) in enumerate(points, start=1):
        colour = hex_colour(SIMULATED if setting.on_front else MEASURED)
        ax.plot(setting.rate, value, "o", color=colour, markersize=5.0, zorder=2)
        ax.annotate(
            str(number), (setting.rate, value), xytext=(4.0, 4.0), textcoords="offset points", fontsize=7.5,
            color=hex_colour(IMPACT),
        )  # fmt: skip
    ax.set_xscale("log")
    ax.set_yscale("log")
    # With powers of ten alone, most of these axes would have one number.
    span = max((s.rate for s, _ in points), default=1.0) / min((s.rate for s, _ in points), default=1.0)
    steps = (1.0, 2.0, 5.0) if span > NARROW_SPEED_RANGE else (1.0, 1.2, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
    ax.xaxis.set_major_locator(LogLocator(subs=steps))
    ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    return remove_box(ax)


def _figures(trade: Trade) -> list[CaptionedFigure]:
    """A figure for each kind that has a result."""
    drawn: list[tuple[str, Callable[[Setting], float | None], str, str]] = [
        (
            "tracking",
            lambda s: s.chi_uncertainty,
            "frames of the clip per second of processor time",
            "uncertainty of χ",
        ),
        ("work", lambda s: s.chi_uncertainty, "frames of the clip per second of processor time", "uncertainty of χ"),
        ("fit", lambda s: s.half_width, "fits per second of processor time", "half width of the χ interval"),
        ("model", lambda s: s.error, "throws per second of processor time", "share on another face"),
    ]
    caption = (
        "Each point is a setting, with its number in the table. Line: Pareto front, no other setting is both faster and more "
        "accurate. Right is faster, low is more accurate."
    )
    figures = []
    for kind, error_of, x, y in drawn:
        settings = [s for s in trade.of(kind) if error_of(s) is not None]
        if settings:
            draw = partial(speed_against_error, settings=settings, error_of=error_of, x=x, y=y)
            figures.append(CaptionedFigure(kind, (WIDE, 3.6), caption, draw))
    return figures


def _figure_html(figure: CaptionedFigure) -> str:
    return captioned_plot(figure.inches, figure.draw, figure.caption)


def _table(kind: str, settings: Sequence[Setting]) -> str:
    """The settings, numbered as in the figure."""
    header = ["", "setting", _RATES[kind]]
    header += [] if kind == "model" else ["χ", "interval", "off by"]
    header += {
        "tracking": ["corners off [mm]"],
        "work": ["corners off [mm]"],
        "fit": ["coverage"],
        "model": ["on another face"],
    }[kind]
    rows, number = [], 0
    for setting in settings:
        answered = setting.why_not is None
        number += answered
        cells = [str(number) if answered else "", setting.name, f"{setting.rate:.3g}" if setting.rate else "–"]
        if kind != "model":
            cells += _chi_cells(setting)
        value = setting.coverage if kind == "fit" else setting.error
        cells.append("–" if value is None else format(value, _FORMATS[kind]))
        rows.append((setting.on_front, cells))
    table = as_table(header, [cells for _, cells in rows])
    return _bold_rows(table, [on for on, _ in rows])


def _reasons(settings: Sequence[Setting]) -> list[str]:
    """Why some settings give no χ."""
    items = [f"<li>{escape(s.name)}: {escape(s.why_not)}</li>" for s in settings if s.why_not is not None]
    return [f'<p class="key">Settings without a value of χ:</p><ul class="key">{"".join(items)}</ul>'] if items else []


def _chi_cells(setting: Setting) -> list[str]:
    if setting.chi is None:
        return ["not determined", "–", "–"]
    interval = "–" if setting.chi_low is None else f"{setting.chi_low:.5f} to {setting.chi_high:.5f}"
    return [f"{setting.chi:.5f}", interval, "–" if setting.chi_error is None else f"{setting.chi_error:.1e}"]


def _bold_rows(table: str, bold: Sequence[bool]) -> str:
    """The table with some of its rows in bold."""
    head, *rows = table.split("<tr><td")
    marks = (' style="font-weight:600"' if on else "" for on in bold)
    return head + "".join(f"<tr{mark}><td{row}" for mark, row in zip(marks, rows, strict=True))
