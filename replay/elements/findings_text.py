"""Findings as text: formatted numbers, and the sentences of the report, the recording and its event log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ...model.throw import Impact
from ...tracking.track import ABSENT
from .record import Record

if TYPE_CHECKING:
    from ...fitting.predict import Estimate
    from ...fitting.results import Fit, Parameter

UNKNOWN = "not determined"
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MAX_LISTED_TIMES = 6
"""Bounces whose times the summary lists."""
CERTAIN_ODDS = 0.95
"""Odds from which the landing face counts as certain: higher values delay the bounce from which it is reported."""

PARAMETER_TEXTS = {
    "chi": "restitution χ [1]",
    "mu": "Coulomb friction μ [1]",
    "chi_fade_s_per_m": "decrease of χ with the normal speed [s/m]",
    "mu_fade_s_per_m": "decrease of μ with the normal speed [s/m]",
    "corner_radius_m": "radius of the corners [m]",
    "inertia_kg_m2": "moment of inertia [kg m²]",
    "tilt_x_rad": "tilt of the table about x [rad]",
    "tilt_y_rad": "tilt of the table about y [rad]",
    "drag_per_m": "air drag [1/m]",
    "table_amplitude_m": "amplitude of the table's motion [m]",
    "table_frequency_hz": "frequency of the table's motion [Hz]",
    "table_phase_rad": "phase of the table's motion at t = 0 [rad]",
    "clock_scale": "true seconds per second of the clip [1]",
    "length_scale": "metres of the track per true metre [1]",
}
"""Meaning and unit of each parameter of a fit."""


# --- numbers ---


def number(value: float | None, digits: int = 4) -> str:
    """A number with `digits` significant digits and a true minus sign; `not determined` for None and NaN."""
    if value is None or not np.isfinite(value):
        return UNKNOWN
    text = f"{value:.{digits}g}"
    mantissa, _, exponent = text.partition("e")
    if exponent:
        text = f"{mantissa} × 10{str(int(exponent)).translate(SUPERSCRIPTS)}"
    return text.replace("-", "−")


def fixed(value: float, decimals: int) -> str:
    """A number with a fixed count of decimals and a true minus sign; `not determined` for NaN."""
    return f"{value:.{decimals}f}".replace("-", "−") if np.isfinite(value) else UNKNOWN


def decimals_for(width: float) -> int:
    """Decimals that show an interval of this width with two digits, from 2 to 8."""
    return int(np.clip(1 - np.floor(np.log10(width)) if width > 0 else 4, 2, 8))


def interval(value: float | None, low: float | None, high: float | None, level: float | None = 0.95) -> str:
    """`0.583 (95 % interval 0.580 to 0.586)`; the width of the interval sets the decimals."""
    if value is None or not np.isfinite(value):
        return UNKNOWN
    if low is None or high is None or level is None or not np.isfinite([low, high]).all():
        return f"{number(value)} (interval {UNKNOWN})"
    decimals = decimals_for(high - low)
    low_text, high_text = fixed(low, decimals), fixed(high, decimals)
    return f"{fixed(value, decimals)} ({100 * level:.3g} % interval {low_text} to {high_text})"


def short_interval(value: float | None, low: float | None, high: float | None) -> str:
    """`0.583 (0.580 to 0.586)`; the width of the interval sets the decimals."""
    if value is None or low is None or high is None or not np.isfinite([value, low, high]).all():
        return number(value)
    decimals = decimals_for(high - low)
    return f"{fixed(value, decimals)} ({fixed(low, decimals)} to {fixed(high, decimals)})"


def plural(count: int, noun: str) -> str:
    """`1 bounce`, `3 bounces`."""
    return f"{count} {noun}" + ("" if count == 1 else "s")


# --- one impact, one estimate, one parameter ---


def bounce_sentence(number_: int, impact: Impact) -> str:
    """One bounce on one line, as the event log shows it."""
    contact = impact.contact + (" " + " ".join(map(str, impact.vertices)) if impact.vertices else "")
    before, after = impact.normal_velocity_before_m_s, impact.normal_velocity_after_m_s
    text = f"bounce {number_} at {fixed(1e3 * impact.time_s, 3)} ms, {contact}"
    if np.isfinite([before, after]).all():
        text += f", {fixed(before, 3)} → {fixed(after, 3)} m/s"
    if np.isfinite(impact.impulse_N_s).all():
        text += f", {impulse_of(impact)}"
    return text + (f", χ = {chi_of(impact)}" if np.isfinite(impact.chi) else "")


def impulse_of(impact: Impact) -> str:
    """Magnitude of the table's impulse on the die."""
    return f"{number(1e3 * float(np.linalg.norm(impact.impulse_N_s)), 3)} mN s"


def chi_of(impact: Impact) -> str:
    """The apparent restitution of one bounce with its interval."""
    known = np.isfinite([impact.chi_low, impact.chi_high]).all()
    return short_interval(impact.chi, impact.chi_low, impact.chi_high) if known else number(impact.chi, 3)


def estimate_sentence(estimate: Estimate) -> str:
    """The result of a fit to the frames up to the end of one flight, on one line of the event log."""
    chi = estimate.chi
    text = f"after {plural(estimate.bounces, 'bounce')}: χ = {short_interval(chi.value, chi.low, chi.high)}"
    if odds := estimate.face_odds:
        likeliest = max(odds, key=lambda face: odds[face])
        text += f", lands on face {likeliest} with odds of {odds[likeliest]:.2f}"
    return text


def role(parameter: Parameter) -> str:
    """Whether the parameter was fitted, and whether it lies at a bound."""
    return ("fitted" if parameter.free else "held") + (", at the bound of its law" if parameter.at_bound else "")


def parameter_text(name: str) -> str:
    """A parameter's name with its meaning; a parameter without an entry keeps its name, which carries the unit."""
    return f"{name}: {PARAMETER_TEXTS[name]}" if name in PARAMETER_TEXTS else name


# --- the throw ---


def verdict(record: Record) -> list[str]:
    """The result in up to three sentences: what was observed, how well the model fits, and where the die lands."""
    observed = _observation_sentence(record)
    if record.fit is None:
        return [observed, "No model was fitted."]
    return [observed, _model_sentence(record), landing_sentence(record.fit)]


def short_verdict(record: Record) -> str:
    """The result in a few words, for a table."""
    bounces, fit = len(record.measured.impacts), record.fit
    if fit is None:
        return "no model fitted"
    if not bounces or not fit.bounces_fitted:
        return "no bounce explained" if bounces else "no bounce observed"
    return f"{fit.bounces_fitted} of {plural(bounces, 'bounce')} explained"


def landing_sentence(fit: Fit) -> str:
    """The face on which the die comes to rest, or the odds of the likeliest one."""
    if fit.landed_face is not None:
        return f"The die comes to rest on face {fit.landed_face}."
    if not fit.face_odds:
        return "Landing face unknown: the simulation stopped before the die came to rest."
    face, share = max(fit.face_odds.items(), key=lambda item: item[1])
    return f"Landing face undecided: face {face} is the likeliest, with odds of {100 * share:.0f} %."


def certainty_sentences(estimates: Sequence[Estimate]) -> list[str]:
    """From which bounce on the landing face was certain, by fits to more and more frames; empty without such fits."""
    known = [estimate for estimate in estimates if estimate.face_odds]
    if len(known) < 2:
        return []
    likeliest = [max((estimate.face_odds or {}).items(), key=lambda item: item[1]) for estimate in known]
    face = likeliest[-1][0]
    last_uncertain = max((k for k, (f, share) in enumerate(likeliest) if f != face or share < CERTAIN_ODDS), default=-1)
    if last_uncertain == len(known) - 1:
        return ["No face becomes certain before the clip ends."]
    first = known[last_uncertain + 1]
    return [
        f"Face {face} is certain (odds of {100 * CERTAIN_ODDS:.0f} % or more) from the flight after bounce "
        f"{first.bounces} on, which begins at {fixed(1e3 * first.time_s, 1)} ms."
    ]


def effects_sentences(fit: Fit) -> list[str]:
    """Which effects the model includes, and what became of the others."""
    given = {"smooth impact"}
    if "table_amplitude_m" not in fit.parameters:
        given.add("oscillating table")  # its motion comes from the scene
    if "corner_radius_m" not in fit.parameters:
        given.add("rounded corners")  # their radius comes from the scene
    added = [name for name in fit.chosen if name not in given]
    if added:
        first = f"The frames cannot be explained without {_listed(added)}. The model includes {_listed(fit.chosen)}."
    elif fit.chosen:
        first = f"The simplest model of this scene is sufficient: {_listed(fit.chosen)}."
    else:
        first = "No model of an impact was needed."
    tried = [effect for effect in fit.considered if effect.evidence is not None]
    untried = len(fit.considered) - len(tried)
    sentences = [first]
    if tried:
        best = max(tried, key=lambda effect: effect.evidence or 0.0)
        sentences.append(
            f"{count_word(len(tried))} other {'effect was' if len(tried) == 1 else 'effects were'} tried and rejected. The "
            f"largest gain in log-likelihood is {number(best.evidence, 2)}, from {best.name}."
        )
    if untried:
        sentences.append(
            f"{count_word(untried)} {'was' if untried == 1 else 'were'} not tried; the table gives the reasons."
        )
    return sentences


def markdown(record: Record, display: tuple[str, ...] = ()) -> str:
    """The findings as a page for the viewer; `display` says how the images were made."""
    lines = [f"# {record.title}", "", *(f"{sentence}\n" for sentence in verdict(record))]
    if record.fit is not None:
        lines += ["## Fitted parameters", "", "| parameter | value | |", "| --- | --- | --- |"]
        lines += [f"| {name} | {_of(p)} | {role(p)} |" for name, p in record.fit.parameters.items()]
        lines += ["", "## Messages of the fit", "", *(f"- {m}" for m in record.fit.messages or ("None.",))]
    lines += ["", "## Footage and tracking", "", *(f"- {n}" for n in (*record.notices, *display) or ("No notices.",))]
    return "\n".join(lines)


def _observation_sentence(record: Record) -> str:
    track, impacts = record.track, record.measured.bounces
    visible = int((track.status != ABSENT).sum())
    text = f"The pose is known on {int(track.tracked.sum())} of the {plural(visible, 'frame')} that show the die; "
    if not impacts:
        return text + "no bounce was observed."
    listed = [f"{1e3 * impact.time_s:.1f}" for impact in impacts[:MAX_LISTED_TIMES]]
    times = _listed(listed) if len(impacts) <= MAX_LISTED_TIMES else ", ".join([*listed, "…"])
    found = "one bounce was" if len(impacts) == 1 else f"{count_word(len(impacts)).lower()} bounces were"
    unresolved = sum(impact.contact == "unresolved" for impact in impacts)
    end = f"; {unresolved} of them could not be resolved into single contacts." if unresolved else "."
    return f"{text}{found} found, at {times} ms{end}"


def _model_sentence(record: Record) -> str:
    fit, bounces = record.fit, len(record.measured.bounces)
    assert fit is not None
    chi = fit.parameters.get("chi")
    text = f"The restitution coefficient χ is {UNKNOWN}" if chi is None or chi.value is None else f"χ is {_of(chi)}"
    if fit.bounces_fitted and fit.residual_rms is not None:
        share = f"{'all' if fit.bounces_fitted == bounces else f'{fit.bounces_fitted} of'} {bounces} bounces"
        share = "the only bounce" if bounces == 1 else share
        return (
            f"{text}; the model explains {share}. Its poses differ from the measured ones by {number(fit.residual_rms, 3)} "
            "standard errors, root mean square (noise alone gives 1)."
        )
    reason = "the model explains none of the bounces; see the messages." if bounces else "the messages give the reason."
    return f"{text}; {reason}"


def _of(parameter: Parameter) -> str:
    return interval(parameter.value, parameter.low, parameter.high, parameter.level)


def count_word(count: int) -> str:
    """A count as the first word of a sentence: `Three`, `13`."""
    words = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine", "Ten", "Eleven", "Twelve")
    return words[count] if count < len(words) else str(count)


def _listed(names: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
