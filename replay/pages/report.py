"""The page of one throw: of an analysed one with its findings, figures, tables and reservations, or of a simulated one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...model.die import Die
from ...model.rotations import euler_from_quat
from ...model.throw import Impact, State, Throw
from ..elements import (
    MEASURED,
    SIMULATED,
    UNKNOWN,
    Record,
    ReportDetails,
    bounce_sentence,
    certainty_sentences,
    chi_of,
    decimals_for,
    effects_sentences,
    fixed,
    hex_colour,
    landing_sentence,
    motion_of,
    motions_of,
    number,
    parameter_text,
    role,
    track_of,
    verdict,
)
from ..figures import throw_heights
from ..player import player_html, player_policy, player_script, player_style
from . import captioned_figures
from .check import findings_table
from .downloads import downloads_html
from .embedded_viewer import VIEWER_PLACE, VIEWER_POLICY, viewer_html
from .interval_sources import sources_html
from .methods import bibtex, methods_html, methods_text
from .page_parts import STATIC_POLICY, WIDE, as_table, captioned, key_value_table, plotted, whole_page

if TYPE_CHECKING:
    from ...fitting.results import Fit, Parameter

MAX_LISTED_BOUNCES = 50
"""Bounces listed on the page of a simulated throw; a throw near χ = 1 has thousands."""
HEIGHTS_CAPTION = "Height of every corner over time. Dashed lines: bounces."
UNKNOWN_ERRORS = np.full(3, np.nan)


def write_report(path: Path, record: Record, details: ReportDetails | None = None, replay: Path | None = None) -> None:
    """Write the page of an analysed throw. Values that are not determined carry the reason that the fit gives.

    With `replay`, a recording, the page contains the viewer and the recording. Raises OSError if a file cannot be read or
    written.
    """
    path.write_text(report_page(record, details or ReportDetails(), replay), encoding="utf-8")


def report_page(record: Record, details: ReportDetails | None = None, replay: Path | None = None) -> str:
    """The page as HTML; every text from outside the program is escaped."""
    details = details or ReportDetails()
    paragraphs, references = methods_text(record, details)
    parts = [
        f"<h1>{escape(record.title)}</h1>",
        _subtitle(record),
        _verdict(record),
        _throw(record, replay is not None),
        _bounces(record),
        _fit(record),
        _residuals(record, details),
        _landing(record),
        _checks(record, details),
        methods_html(paragraphs, references),
        downloads_html({**details.tables, "references.bib": bibtex(references)}),
        _origin(details.origin),
        viewer_html(replay) if replay is not None else "",
        player_script(),
    ]
    return whole_page(record.title, (part for part in parts if part), player_style(), _policy(replay is not None))


def throw_page(title: str, die: Die, throw: Throw, fps: float, sentences: Sequence[str], replay: Path) -> str:
    """The page of a simulated throw as HTML, with the viewer and the recording at `replay`. Raises OSError as `viewer_html`.

    It shows the result in words, the throw at `fps` [Hz] to be played, the heights of the corners, and the bounces.
    """
    motion = motion_of("simulated", track_of(throw, fps), throw)
    bounces = [bounce_sentence(k, impact) for k, impact in enumerate(throw.bounces[:MAX_LISTED_BOUNCES], 1)]
    if len(throw.bounces) > len(bounces):
        bounces.append(f"and {len(throw.bounces) - len(bounces)} more")
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<div class="verdict"><p>{escape(" ".join(sentences))}</p></div>',
        player_html(die.solid, [motion], throw.bounces),
        VIEWER_PLACE,
        captioned(
            plotted((WIDE, 4.0), lambda ax: throw_heights(ax, die.solid, throw), HEIGHTS_CAPTION), HEIGHTS_CAPTION
        ),
        "<h2>Bounces</h2>",
        _list(bounces or ["None."]),
        viewer_html(replay),
        player_script(),
    ]
    return whole_page(title, parts, player_style(), VIEWER_POLICY)


def _policy(embedded: bool) -> str:
    """The content security policy of a page with a player, and perhaps the viewer."""
    return VIEWER_POLICY if embedded else f"{STATIC_POLICY}; {player_policy()}"


# --- sections ---


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
    """`0.583, 95 % interval 0.580 to 0.586`: both ends, because the interval may be asymmetric."""
    if parameter is None or parameter.value is None:
        return UNKNOWN
    if parameter.low is None or parameter.high is None:
        return number(parameter.value, 3)
    decimals = decimals_for(parameter.high - parameter.low)
    ends = f"{fixed(parameter.low, decimals)} to {fixed(parameter.high, decimals)}"
    return f"{fixed(parameter.value, decimals)}, {100 * (parameter.level or 0.95):.3g} % interval {ends}"


def _throw(record: Record, embedded: bool) -> str:
    figures = {figure.name: figure.as_html() for figure in captioned_figures.clip_figures(record)}
    picture = figures.pop("stroboscope", "")
    return "\n".join(
        [
            "<h2>The throw</h2>",
            player_html(record.die.solid, motions_of(record), record.measured.bounces, record.camera, picture),
            *([VIEWER_PLACE] if embedded else []),
            *figures.values(),
            captioned_figures.height_figure(record).as_html(),
        ]
    )


def _bounces(record: Record) -> str:
    impacts = record.measured.bounces
    if not impacts:
        return "<h2>Bounces</h2>\n<p>No bounce was observed.</p>"
    header = (
        "bounce",
        "time [ms]",
        "contact",
        "normal velocity before → after [m/s]",
        "χ (interval)",
        "energy before → after [mJ]",
        "lowest face before → after",
    )
    table = as_table(header, (_bounce_row(k, impact) for k, impact in enumerate(impacts, 1)))
    return "\n".join(
        ["<h2>Bounces</h2>", table, captioned_figures.as_html(captioned_figures.restitution_figures(record))]
    )


def _fit(record: Record) -> str:
    fit = record.fit
    if fit is None:
        return "<h2>Fit</h2>\n<p>No model was fitted.</p>"
    rows = [_parameter_row(name, parameter, fit) for name, parameter in fit.parameters.items()]
    parts = ["<h2>Fit</h2>", as_table(("parameter", "value", "interval", "in the fit"), rows), sources_html(fit)]
    if fit.considered or fit.chosen:
        parts += ["<h3>Effects</h3>", _effects(fit)]
    if fit.initial is not None:
        parts += ["<h3>Initial conditions</h3>", _initial(fit.initial, fit)]
        parts += [figure.as_html() for figure in captioned_figures.fit_figures(record) if figure.name == "correlations"]
    if fit.messages:
        parts += ["<h3>Messages of the fit</h3>", _list(fit.messages)]
    return "\n".join(part for part in parts if part)


def _residuals(record: Record, details: ReportDetails) -> str:
    if record.simulated is None:
        return ""
    figures = captioned_figures.as_html(captioned_figures.residual_figures(record, details))
    nothing = "<p>No frame has both a measured and a simulated pose, so there are no residuals.</p>"
    return f"<h2>Residuals</h2>\n{figures or nothing}"


def _landing(record: Record) -> str:
    if record.fit is None:
        return ""
    sentences = [landing_sentence(record.fit), *certainty_sentences(record.estimates)]
    parts = ["<h2>Landing</h2>", f"<p>{escape(' '.join(sentences))}</p>"]
    parts += [figure.as_html() for figure in captioned_figures.fit_figures(record) if figure.name.startswith("odds")]
    return "\n".join(parts)


def _checks(record: Record, details: ReportDetails) -> str:
    if not details.findings and not record.notices:
        return ""
    parts = ["<h2>Calibration and timing</h2>"]
    if details.findings:
        parts.append(findings_table(details.findings))
    if record.notices:
        parts += ["<h3>Footage and tracking</h3>", _list(record.notices)]
    return "\n".join(parts)


def _origin(origin: Mapping[str, Any] | None) -> str:
    if origin is None:
        return ""
    packages = ", ".join(f"{name} {version}" for name, version in origin.get("packages", {}).items())
    rows = [
        ("program", f"diethrow {origin.get('diethrow', UNKNOWN)}"),
        ("command", " ".join(map(str, origin.get("command", ()))) or "called from Python"),
        ("python", f"{origin.get('python', UNKNOWN)} on {origin.get('platform', UNKNOWN)}"),
        ("packages", packages),
    ]
    inputs = [
        f"<tr><td>{escape(str(file.get('path')))}</td><td>{escape(str(file.get('bytes')))}</td>"
        f'<td class="hash">{escape(str(file.get("sha256")))}</td></tr>'
        for file in origin.get("inputs", ())
    ]
    files = (
        '<div class="wide"><table>\n<thead><tr><th>input</th><th>bytes</th><th>SHA-256</th></tr></thead>\n<tbody>\n'
        + "\n".join(inputs)
        + "\n</tbody></table></div>"
    )
    facts = key_value_table((name, text) for name, text in rows if text)
    return "\n".join(["<h2>Provenance</h2>", facts, files if inputs else ""])


# --- rows ---


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


def _parameter_row(name: str, parameter: Parameter, fit: Fit) -> tuple[str, ...]:
    reason = f"{UNKNOWN}: {_reason(name, fit)}"
    if parameter.value is None:
        return parameter_text(name), reason, UNKNOWN, role(parameter)
    if parameter.low is None or parameter.high is None:
        no_interval = reason if parameter.free else "none: the parameter is held"
        return parameter_text(name), number(parameter.value), no_interval, role(parameter)
    decimals = decimals_for(parameter.high - parameter.low)
    ends = f"{fixed(parameter.low, decimals)} to {fixed(parameter.high, decimals)}"
    level = f" ({100 * parameter.level:.3g} %)" if parameter.level is not None else ""
    return parameter_text(name), fixed(parameter.value, decimals), ends + level, role(parameter)


def _reason(name: str, fit: Fit) -> str:
    """The messages that name the parameter; all messages if none does."""
    symbols = (name, {"chi": "χ", "mu": "μ"}.get(name, name))
    matching = [message for message in fit.messages if any(symbol in message for symbol in symbols)]
    return " ".join(matching or fit.messages) or "the fit gives no reason."


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
        ("Euler angles ψ, ϑ, φ (z-x-z) [rad]", _vector(euler_from_quat(state.quaternion))[0], ""),
        ("angular velocity, body axes [rad/s]", _vector(state.rotation.T @ state.omega_rad_s)[0], ""),
    ]
    return as_table(("world axes", "value", "standard errors"), rows)


def _vector(values: np.ndarray, errors: np.ndarray = UNKNOWN_ERRORS) -> tuple[str, str]:
    return "(" + ", ".join(fixed(float(value), 4) for value in values) + ")", _spread(errors)


def _spread(errors: np.ndarray, unit: str = "") -> str:
    if not np.isfinite(errors).all():
        return UNKNOWN
    return "(" + ", ".join(number(float(error), 2) for error in errors) + ")" + unit


def _effects(fit: Fit) -> str:
    rows = [(name, "included", "", "") for name in fit.chosen]
    rows += [
        (
            effect.name,
            "not included",
            number(effect.evidence, 3) if effect.evidence is not None else "not tried",
            effect.why_not or "",
        )
        for effect in fit.considered
    ]
    table = as_table(("effect", "", "gain in log-likelihood [1]", "reason"), rows)
    return f"<p>{escape(' '.join(effects_sentences(fit)))}</p>\n{table}"


def _list(sentences: Iterable[str]) -> str:
    return "<ul>\n" + "\n".join(f"<li>{escape(sentence)}</li>" for sentence in sentences) + "\n</ul>"
