"""Speed against accuracy as a page: what was tried, which settings nothing beats, and the one to use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from ...tracking.footage import Decimation
from ..elements import IMPACT, MEASURED, SIMULATED, hex_colour
from .captioned_figures import CaptionedFigure
from .page_parts import as_table, captioned, plotted, whole_page

NARROW_SPEED_RANGE = 8.0
"""Between settings that lie no further apart than this the axis of speed has numbers between 1, 2 and 5."""


@dataclass(frozen=True)
class Setting:
    """One choice, and what it gave."""

    kind: str
    """`tracking`, `work`, `fit` or `model`."""
    name: str
    rate: float
    """Frames of the clip, fits or throws a second of processor time."""
    seconds: float
    """Of processor time."""
    error: float | None
    """See `ERRORS`; None where there is no answer to compare."""
    chi: float | None = None
    chi_low: float | None = None
    chi_high: float | None = None
    chi_error: float | None = None
    """|χ - that of the reference|."""
    coverage: float | None = None
    options: tuple[str, ...] = ()
    """Of `diethrow analyze`, that choose it."""
    on_front: bool = False
    why_not: str | None = None
    """Why there is no answer."""

    @property
    def half_width(self) -> float | None:
        """Of the χ interval, its longer side."""
        if self.chi is None or self.chi_low is None or self.chi_high is None:
            return None
        return max(self.chi_high - self.chi, self.chi - self.chi_low)

    @property
    def choice(self) -> tuple[str, Decimation]:
        """Quality and decimation that the options of a tracking name."""
        told = dict(zip(self.options[::2], self.options[1::2], strict=True))
        return told["--quality"], Decimation(int(told.get("--every", "1")), int(told.get("--shrink", "1")))

    @property
    def chi_uncertainty(self) -> float | None:
        """How far χ may be off: the longer side of its interval, or its distance from the reference."""
        if self.half_width is None:
            return None
        return max(self.half_width, self.chi_error or 0.0)


ERRORS = {
    "tracking": "median distance of the corners from the finest run [mm]",
    "work": "median distance of the corners from the finest run [mm]",
    "fit": "distance of χ from the reference",
    "model": "share of throws that land on another face",
}
"""What `Setting.error` is."""


@dataclass(frozen=True)
class Trade:
    """All settings that were tried."""

    settings: tuple[Setting, ...]
    reference: str
    """What χ was compared with."""
    within: float

    def of(self, kind: str) -> tuple[Setting, ...]:
        """The settings of one trade."""
        return tuple(setting for setting in self.settings if setting.kind == kind)

    @property
    def recommended(self) -> Setting | None:
        """The fastest tracking that gives χ to within what was asked for; None where none does."""
        return fastest_within(self.of("tracking"), self.within)

    @property
    def advice(self) -> str:
        """One line."""
        best = self.recommended
        if best is None:
            reached = [s.chi_uncertainty for s in self.of("tracking") if s.chi_uncertainty is not None]
            told = f"the best comes to ±{min(reached):.2g}" if reached else "none gives χ"
            return f"No setting gives χ to ±{self.within:g} on this scene: {told}."
        options = " ".join(best.options) or "no option"
        return (
            f"For χ to ±{self.within:g}: diethrow analyze with {options}, {best.rate:.0f} frames a second; it gives "
            f"±{best.chi_uncertainty:.2g}."
        )


def fastest_within(settings: Sequence[Setting], within: float) -> Setting | None:
    """The fastest setting whose χ is within what is asked for; None where none is."""
    good = [s for s in settings if s.chi_uncertainty is not None and s.chi_uncertainty <= within]
    return max(good, key=lambda s: s.rate, default=None)


# --- the page ---------------------------------------------------------------------------------------------------------

_RATES = {"tracking": "frames/s", "work": "frames/s", "fit": "fits/s", "model": "throws/s"}
_FORMATS = {"tracking": ".3g", "work": ".3g", "fit": ".0%", "model": ".2%"}
_HEADINGS = {
    "tracking": "Tracking",
    "work": "Tracking at standard quality, one number changed",
    "fit": "Fit, on the finest track",
    "model": "Model",
}


def trade_page(title: str, trade: Trade) -> str:
    """The whole page as HTML."""
    parts = [
        f"<h1>Speed against accuracy: {escape(title)}</h1>",
        f'<div class="verdict"><p class="headline">{escape(trade.advice)}</p>'
        f"<p>χ is compared with {escape(trade.reference)}. Speeds are for one second of a processor, all stages of "
        "the setting together; in bold, what nothing beats in both.</p></div>",
    ]
    for kind, heading in _HEADINGS.items():
        settings = trade.of(kind)
        if settings:
            parts += [f"<h2>{heading}</h2>", *(_picture(plate) for plate in _plates(trade) if plate.name == kind)]
            parts += [_table(kind, settings), *_reasons(settings)]
    return whole_page(title, parts, "td:nth-child(2) { white-space: nowrap; }")


def write_trade_figures(folder: Path, trade: Trade) -> None:
    """The pictures of the page as files: tracking.png, work.png, fit.png, model.png, and each as SVG."""
    for plate in _plates(trade):
        plate.write(folder)


def speed_against_error(
    ax: Axes, settings: Sequence[Setting], badness: Callable[[Setting], float | None], x: str, y: str
) -> Axes:
    """One point a setting on logarithmic axes, those on the front joined; a value of 0 stands at the lower edge."""
    told = [(s, b) for s in settings if (b := badness(s)) is not None and s.rate > 0.0]
    floor = 0.5 * min((b for _, b in told if b > 0.0), default=1.0)
    places = [(s, max(b, floor)) for s, b in told]
    front = sorted(((s.rate, b) for s, b in places if s.on_front), key=lambda place: place[0])
    ax.plot(*zip(*front, strict=True), color=hex_colour(SIMULATED), linewidth=1.2, zorder=1) if front else None
    for number, (setting, value) in enumerate(places, start=1):
        colour = hex_colour(SIMULATED if setting.on_front else MEASURED)
        ax.plot(setting.rate, value, "o", color=colour, markersize=5.0, zorder=2)
        ax.annotate(
            str(number), (setting.rate, value), xytext=(4.0, 4.0), textcoords="offset points", fontsize=7.5,
            color=hex_colour(IMPACT),
        )  # fmt: skip
    ax.set_xscale("log")
    ax.set_yscale("log")
    # Powers of ten would leave most of these axes with one number.
    span = max((s.rate for s, _ in places), default=1.0) / min((s.rate for s, _ in places), default=1.0)
    steps = (1.0, 2.0, 5.0) if span > NARROW_SPEED_RANGE else (1.0, 1.2, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
    ax.xaxis.set_major_locator(LogLocator(subs=steps))
    ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def _plates(trade: Trade) -> list[CaptionedFigure]:
    """A picture of each trade that has anything to show."""
    drawn: list[tuple[str, Callable[[Setting], float | None], str, str]] = [
        ("tracking", lambda s: s.chi_uncertainty, "frames of the clip a second of a processor", "χ may be off by"),
        ("work", lambda s: s.chi_uncertainty, "frames of the clip a second of a processor", "χ may be off by"),
        ("fit", lambda s: s.half_width, "fits a second of a processor", "half width of the χ interval"),
        ("model", lambda s: s.error, "throws a second of a processor", "share on another face"),
    ]
    report_figures = []
    for kind, badness, x, y in drawn:
        settings = [s for s in trade.of(kind) if badness(s) is not None]
        if settings:
            caption = (
                "Each point is a setting, by its number in the table; joined: those that nothing beats in both. Right is "
                "faster, low is better."
            )
            draw = partial(speed_against_error, settings=settings, badness=badness, x=x, y=y)
            report_figures.append(CaptionedFigure(kind, (8.4, 3.6), caption, draw))
    return report_figures


def _picture(plate: CaptionedFigure) -> str:
    return captioned(plotted(plate.inches, plate.draw), plate.caption)


def _table(kind: str, settings: Sequence[Setting]) -> str:
    """The settings in the order in which the picture numbers them."""
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
        told = setting.coverage if kind == "fit" else setting.error
        cells.append("–" if told is None else format(told, _FORMATS[kind]))
        rows.append((setting.on_front, cells))
    table = as_table(header, [cells for _, cells in rows])
    return _bold_rows(table, [on for on, _ in rows])


def _reasons(settings: Sequence[Setting]) -> list[str]:
    """Why some settings leave χ open."""
    told = [f"<li>{escape(s.name)}: {escape(s.why_not)}</li>" for s in settings if s.why_not is not None]
    return [f'<p class="key">Settings that leave χ open:</p><ul class="key">{"".join(told)}</ul>'] if told else []


def _chi_cells(setting: Setting) -> list[str]:
    if setting.chi is None:
        return ["open", "–", "–"]
    interval = "–" if setting.chi_low is None else f"{setting.chi_low:.5f} to {setting.chi_high:.5f}"
    return [f"{setting.chi:.5f}", interval, "–" if setting.chi_error is None else f"{setting.chi_error:.1e}"]


def _bold_rows(table: str, bold: Sequence[bool]) -> str:
    """The table with some of its rows in bold."""
    head, *rows = table.split("<tr><td")
    marks = (' style="font-weight:600"' if on else "" for on in bold)
    return head + "".join(f"<tr{mark}><td{row}" for mark, row in zip(marks, rows, strict=True))
