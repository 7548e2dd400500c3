"""One page for one throw: the findings in words, figures, tables, and every reservation. It needs no network."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from ..model.motion import Impact, State
from . import figures
from .pages import as_address, as_table, captioned, drawing, plotted, whole_page
from .palette import MEASURED, SIMULATED, hex_colour
from .record import Motion, Record, Residuals, motions_of, residuals
from .words import UNKNOWN, chi_of, decimals_for, fixed, number, role, verdict

if TYPE_CHECKING:
    from ..fitting.results import Fit, Parameter

STRIP_FRAMES = 5
"""Most frames of the clip shown side by side."""


def write_report(path: Path, record: Record) -> None:
    """Write the page. What is not determined is said to be so, with the reason that the fit gives.

    Raises OSError where the file cannot be written.
    """
    path.write_text(page(record), encoding="utf-8")


def page(record: Record) -> str:
    """The whole page as HTML; every text that comes from outside is escaped."""
    parts = [
        f"<h1>{escape(record.title)}</h1>",
        _subtitle(record),
        _verdict(record),
        _pictures(record),
        _bounces(record.measured.impacts),
        _fit(record),
        _notes(record),
    ]
    return whole_page(record.title, (part for part in parts if part))


def _subtitle(record: Record) -> str:
    solid = record.die.solid
    edge = float(np.linalg.norm(np.subtract(*solid.vertices[solid.edges[0]])))
    text = (
        f"{solid.name}, edge {1e3 * edge:.4g} mm, mass {1e3 * record.die.mass_kg:.4g} g; "
        f"{len(record.track)} frames at {record.fps:.6g} frames per second"
    )
    key = f'<span class="dot" style="background:{hex_colour(MEASURED)}"></span>measured'
    if record.simulated is not None:
        key += f'<span class="dot" style="background:{hex_colour(SIMULATED)}"></span>simulated'
    return f'<p class="key">{escape(text)}</p>\n<p class="key">{key}</p>'


def _verdict(record: Record) -> str:
    chi = record.fit.parameters.get("chi") if record.fit is not None else None
    headline = "No model was fitted" if record.fit is None else f"χ = {_short(chi)}"
    if chi is None or chi.value is None:
        headline = headline.replace("χ = ", "χ ")
    sentences = " ".join(escape(sentence) for sentence in verdict(record))
    return f'<div class="verdict"><p class="headline">{escape(headline)}</p><p>{sentences}</p></div>'


def _short(parameter: Parameter | None) -> str:
    """`0.583 ± 0.003`-like headline; the interval need not be symmetric, so its ends are given."""
    if parameter is None or parameter.value is None:
        return UNKNOWN
    if parameter.low is None or parameter.high is None:
        return number(parameter.value, 3)
    decimals = decimals_for(parameter.high - parameter.low)
    ends = f"{fixed(parameter.low, decimals)} to {fixed(parameter.high, decimals)}"
    return f"{fixed(parameter.value, decimals)}, {100 * (parameter.level or 0.95):.3g} % interval {ends}"


# Figures


def _pictures(record: Record) -> str:
    motions = motions_of(record)
    impacts = record.measured.impacts
    parts = ["<h2>The throw</h2>"]
    parts.append(_film_strip(record, motions))
    parts.append(_heights(record, motions))
    if any(np.isfinite(impact.chi) for impact in impacts):
        chi = record.fit.parameters.get("chi") if record.fit is not None else None
        caption = "Apparent restitution of every bounce with its interval"
        caption += ", and the fitted χ with its own as a band." if chi is not None and chi.value is not None else "."
        picture = plotted((5.2, 2.9), lambda ax: figures.restitution(ax, impacts, chi))
        parts.append(captioned(picture, caption, narrow=True))
    if record.simulated is not None:
        parts.append(_residual_figures(residuals(record.track, record.simulated), impacts))
    return "\n".join(parts)


def _film_strip(record: Record, motions: list[Motion]) -> str:
    """A few frames of the clip: the first and last with a pose, and those nearest to the bounces."""
    clip, camera = record.clip, record.camera
    if clip is None or camera is None:
        return ""
    seen = motions[0].frame[(motions[0].frame >= clip.first_frame) & (motions[0].frame < clip.first_frame + len(clip))]
    if not len(seen):
        return ""
    instants = [clip.times_s[seen[0] - clip.first_frame], *(impact.time_s for impact in record.measured.impacts)]
    nearest = [int(seen[np.abs(clip.times_s[seen - clip.first_frame] - instant).argmin()]) for instant in instants]
    chosen = sorted({*nearest[: STRIP_FRAMES - 1], int(seen[-1])})
    with drawing((8.4, 8.4 * clip.height_px / clip.width_px / max(len(chosen), 3) + 0.25)) as figure:
        for ax, frame in zip(figure.subplots(1, max(len(chosen), 3), squeeze=False)[0], chosen, strict=False):
            figures.edges_on_frame(ax, clip, camera, record.die.solid, motions, frame)
            ax.set_title(f"frame {frame}", fontsize=8.0, color="#5b6470")
        for ax in figure.axes:
            ax.set_axis_off()
        picture = as_address(figure, "png")
    lines = "measured edges blue" + (", simulated orange" if len(motions) > 1 else "")
    return captioned(picture, f"The die on film, at its first and last pose and at its bounces: {lines}.")


def _heights(record: Record, motions: list[Motion]) -> str:
    def draw(ax: Axes) -> Axes:
        track, solid = record.track, record.die.solid
        for motion, impacts in zip(motions, (record.measured.impacts, ()), strict=False):
            table = track if motion.name == "measured" else record.simulated
            assert table is not None
            seen = np.flatnonzero(track.tracked)
            # The model goes on where nothing was seen; the figure shows the stretch that can be compared.
            rows = slice(seen[0], seen[-1] + 1) if len(seen) and len(table) == len(track) else slice(None)
            poses = table.time_s[rows], table.position_m[rows], table.quaternion[rows]
            figures.corner_heights(ax, solid, *poses, impacts, label=motion.name)
        return ax

    caption = "Height of every corner over time: measured dots"
    caption += ", simulated lines" if record.simulated is not None else ""
    return captioned(plotted((8.4, 4.0), draw), caption + ". Dashed: the bounces.")


def _residual_figures(rest: Residuals, impacts: tuple[Impact, ...]) -> str:
    if not len(rest.frame):
        return "<p>No frame has both a measured and a simulated pose, so there are no residuals.</p>"
    parts = [
        captioned(
            plotted((8.4, 2.3), lambda ax: figures.position_residuals(ax, rest, impacts)),
            "Measured minus simulated position, in world axes.",
        ),
        captioned(
            plotted((8.4, 2.1), lambda ax: figures.angle_residuals(ax, rest, impacts)),
            "Angle between the measured and the simulated orientation.",
        ),
    ]
    if np.isfinite(rest.sigmas).any():
        caption = (
            "Both together in standard errors of the measured poses: root mean square of six; noise alone gives 1."
        )
        parts.append(captioned(plotted((8.4, 2.1), lambda ax: figures.sigma_residuals(ax, rest, impacts)), caption))
    return "\n".join(parts)


# Tables


def _bounces(impacts: tuple[Impact, ...]) -> str:
    if not impacts:
        return "<h2>Bounces</h2>\n<p>No bounce was seen.</p>"
    header = (
        "bounce",
        "time [ms]",
        "contact",
        "normal velocity before → after [m/s]",
        "χ (interval)",
        "energy before → after [mJ]",
        "lowest face before → after",
    )
    return "<h2>Bounces</h2>\n" + as_table(header, (_bounce_row(k, impact) for k, impact in enumerate(impacts, 1)))


def _bounce_row(count: int, impact: Impact) -> tuple[str, ...]:
    time = fixed(1e3 * impact.time_s, 3)
    if np.isfinite(impact.sigma_time_s):
        time += f" ± {number(1e3 * impact.sigma_time_s, 2)}"
    contact = impact.contact + (" " + " ".join(map(str, impact.vertices)) if impact.vertices else "")
    velocity = _arrow(impact.normal_velocity_before_m_s, impact.normal_velocity_after_m_s, 3)
    energy = _arrow(1e3 * impact.energy_before_J, 1e3 * impact.energy_after_J, 3)
    faces = f"{impact.lowest_face_before} → {impact.lowest_face_after}"
    return str(count), time, contact, velocity, chi_of(impact), energy, faces


def _arrow(before: float, after: float, decimals: int) -> str:
    return f"{fixed(before, decimals)} → {fixed(after, decimals)}" if np.isfinite([before, after]).any() else UNKNOWN


def _fit(record: Record) -> str:
    fit = record.fit
    if fit is None:
        return "<h2>Fit</h2>\n<p>No model was fitted.</p>"
    rows = [_parameter_row(name, parameter, fit) for name, parameter in fit.parameters.items()]
    parts = ["<h2>Fit</h2>", as_table(("parameter", "value", "interval", "part in the fit"), rows)]
    if fit.initial is not None:
        parts += ["<h2>Initial conditions</h2>", _initial(fit.initial, fit)]
    if fit.considered or fit.chosen:
        parts += ["<h2>Effects</h2>", _effects(fit)]
    if fit.face_odds:
        odds = [(str(face), f"{100 * share:.1f} %") for face, share in sorted(fit.face_odds.items())]
        parts += ["<h2>Odds of each face</h2>", as_table(("face", "share of simulated landings"), odds)]
    return "\n".join(parts)


def _parameter_row(name: str, parameter: Parameter, fit: Fit) -> tuple[str, ...]:
    reason = f"{UNKNOWN}: {_reason(name, fit)}"
    if parameter.value is None:
        return name, reason, UNKNOWN, role(parameter)
    if parameter.low is None or parameter.high is None:
        return name, number(parameter.value), reason if parameter.free else "held, so it has none", role(parameter)
    decimals = decimals_for(parameter.high - parameter.low)
    ends = f"{fixed(parameter.low, decimals)} to {fixed(parameter.high, decimals)}"
    level = f" ({100 * parameter.level:.3g} %)" if parameter.level is not None else ""
    return name, fixed(parameter.value, decimals), ends + level, role(parameter)


def _reason(name: str, fit: Fit) -> str:
    """The messages that speak of the parameter; all of them where none names it."""
    symbols = (name, {"chi": "χ", "mu": "μ"}.get(name, name))
    about = [message for message in fit.messages if any(symbol in message for symbol in symbols)]
    return " ".join(about or fit.messages) or "the fit gives no reason."


def _initial(state: State, fit: Fit) -> str:
    errors = np.full(12, np.nan)
    if fit.initial_covariance is not None:
        errors = np.sqrt(np.clip(np.diag(fit.initial_covariance), 0.0, None))
    quaternion = "(" + ", ".join(fixed(float(value), 6) for value in state.quaternion) + ")"
    rows = [
        ("time [s]", fixed(state.time_s, 6), ""),
        ("position [mm]", *_vector(1e3 * state.position_m, 1e3 * errors[:3])),
        ("quaternion w, x, y, z [1]", quaternion, _spread(np.rad2deg(errors[3:6]), " °")),
        ("velocity [m/s]", *_vector(state.velocity_m_s, errors[6:9])),
        ("angular velocity [rad/s]", *_vector(state.omega_rad_s, errors[9:])),
    ]
    return as_table(("world axes", "value", "standard errors"), rows)


def _vector(values: np.ndarray, errors: np.ndarray) -> tuple[str, str]:
    return "(" + ", ".join(fixed(float(value), 4) for value in values) + ")", _spread(errors)


def _spread(errors: np.ndarray, unit: str = "") -> str:
    if not np.isfinite(errors).all():
        return UNKNOWN
    return "(" + ", ".join(number(float(error), 2) for error in errors) + ")" + unit


def _effects(fit: Fit) -> str:
    rows = [(name, "in the model", "", "") for name in fit.chosen]
    rows += [
        (
            effect.name,
            "left out",
            number(effect.evidence, 3) if effect.evidence is not None else "not tried",
            effect.why_not or "",
        )
        for effect in fit.considered
    ]
    return as_table(("effect", "", "gain in log-likelihood [1]", "why not"), rows)


def _notes(record: Record) -> str:
    parts = []
    if record.fit is not None and record.fit.messages:
        parts += ["<h2>Messages of the fit</h2>", _list(record.fit.messages)]
    if record.notices:
        parts += ["<h2>Footage and tracking</h2>", _list(record.notices)]
    return "\n".join(parts)


def _list(sentences: Iterable[str]) -> str:
    return "<ul>\n" + "\n".join(f"<li>{escape(sentence)}</li>" for sentence in sentences) + "\n</ul>"
