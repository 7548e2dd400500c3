"""The sentences of a replay: what the report, the recording and its event log say about a throw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..model.motion import Impact
from ..tracking.track import ABSENT, LOST
from .record import Record

if TYPE_CHECKING:
    from ..fitting.growing import Estimate
    from ..fitting.results import Parameter

UNKNOWN = "not determined"


def number(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits and a true minus sign; `not determined` for None and NaN."""
    if value is None or not np.isfinite(value):
        return UNKNOWN
    text = f"{value:.{digits}g}"
    mantissa, _, exponent = text.partition("e")
    if exponent:
        text = f"{mantissa} × 10^{int(exponent)}"
    return text.replace("-", "−")


def fixed(value: float, decimals: int) -> str:
    """A number with so many decimals and a true minus sign; `not determined` for NaN."""
    return f"{value:.{decimals}f}".replace("-", "−") if np.isfinite(value) else UNKNOWN


def interval(value: float | None, low: float | None, high: float | None, level: float | None = 0.95) -> str:
    """`0.583 (95 % interval 0.580 to 0.586)`, with the decimals that the interval deserves."""
    if value is None or not np.isfinite(value):
        return UNKNOWN
    if low is None or high is None or level is None or not np.isfinite([low, high]).all():
        return f"{number(value)} (interval {UNKNOWN})"
    decimals = decimals_for(high - low)
    low_text, high_text = fixed(low, decimals), fixed(high, decimals)
    return f"{fixed(value, decimals)} ({100 * level:.3g} % interval {low_text} to {high_text})"


def decimals_for(width: float) -> int:
    """Decimals that show an interval of this width with two digits, between 2 and 8."""
    return int(np.clip(1 - np.floor(np.log10(width)) if width > 0 else 4, 2, 8))


def plural(count: int, what: str) -> str:
    """`1 bounce`, `3 bounces`."""
    return f"{count} {what}" + ("" if count == 1 else "s")


def verdict(record: Record) -> list[str]:
    """What the analysis found, in a few sentences."""
    said = [_tracking_sentence(record), _bounce_sentence(record)]
    if record.fit is None:
        return [*said, "No model was fitted."]
    said.append(_restitution_sentence(record.fit.parameters.get("chi")))
    bounces = len(record.measured.impacts)
    if record.fit.bounces_fitted and record.fit.residual_rms is not None:
        share = f"{record.fit.bounces_fitted} of {plural(bounces, 'bounce')}"
        said.append(
            f"The model explains {share}; its poses differ from the measured ones by "
            f"{number(record.fit.residual_rms, 3)} standard errors, root mean square (noise alone gives 1)."
        )
    elif bounces:
        said.append("The model explains none of the bounces; see the messages.")
    if record.fit.landed_face is not None:
        said.append(f"The die comes to rest on face {record.fit.landed_face}.")
    return said


def short_verdict(record: Record) -> str:
    """What became of the throw, in a few words for a table."""
    bounces, fit = len(record.measured.impacts), record.fit
    if fit is None:
        return "no model fitted"
    if not bounces or not fit.bounces_fitted:
        return "no bounce explained" if bounces else "no bounce seen"
    return f"{fit.bounces_fitted} of {plural(bounces, 'bounce')} explained"


def bounce_sentence(number_: int, impact: Impact) -> str:
    """One bounce on one line, as the event log shows it."""
    where = impact.contact + (" " + " ".join(map(str, impact.vertices)) if impact.vertices else "")
    before, after = impact.normal_velocity_before_m_s, impact.normal_velocity_after_m_s
    text = f"bounce {number_} at {fixed(1e3 * impact.time_s, 3)} ms, {where}"
    if np.isfinite([before, after]).all():
        text += f", {fixed(before, 3)} → {fixed(after, 3)} m/s"
    if np.isfinite(impact.impulse_N_s).all():
        text += f", {impulse_of(impact)}"
    return text + (f", χ = {chi_of(impact)}" if np.isfinite(impact.chi) else "")


def impulse_of(impact: Impact) -> str:
    """How hard the table struck."""
    return f"{number(1e3 * float(np.linalg.norm(impact.impulse_N_s)), 3)} mN s"


def estimate_sentence(estimate: Estimate) -> str:
    """What is known after so many bounces, on one line of the event log."""
    chi = estimate.chi
    text = f"after {plural(estimate.bounces, 'bounce')}: χ = {short_interval(chi.value, chi.low, chi.high)}"
    if odds := estimate.face_odds:
        likeliest = max(odds, key=lambda face: odds[face])
        text += f", lands on face {likeliest} with odds of {odds[likeliest]:.2f}"
    return text


def short_interval(value: float | None, low: float | None, high: float | None) -> str:
    """`0.583 (0.580 to 0.586)`, with the decimals that the interval deserves."""
    if value is None or low is None or high is None or not np.isfinite([value, low, high]).all():
        return number(value)
    decimals = decimals_for(high - low)
    return f"{fixed(value, decimals)} ({fixed(low, decimals)} to {fixed(high, decimals)})"


def chi_of(impact: Impact) -> str:
    """The apparent restitution of one bounce with its interval, short."""
    known = np.isfinite([impact.chi_low, impact.chi_high]).all()
    return short_interval(impact.chi, impact.chi_low, impact.chi_high) if known else number(impact.chi, 3)


def markdown(record: Record, display: tuple[str, ...] = ()) -> str:
    """The same findings as a page for the viewer; `display` says how the pictures were made."""
    lines = [f"# {record.title}", "", *(f"{sentence}\n" for sentence in verdict(record))]
    if record.fit is not None:
        lines += ["## Fitted parameters", "", "| parameter | value | |", "| --- | --- | --- |"]
        lines += [f"| {name} | {_of(p)} | {role(p)} |" for name, p in record.fit.parameters.items()]
        lines += ["", "## Messages of the fit", "", *(f"- {m}" for m in record.fit.messages or ("None.",))]
    lines += ["", "## Footage and tracking", "", *(f"- {n}" for n in (*record.notices, *display) or ("No notices.",))]
    return "\n".join(lines)


def role(parameter: Parameter) -> str:
    """How the parameter took part in the fit."""
    held = "fitted" if parameter.free else "held"
    return held + (", at the bound of its law" if parameter.at_bound else "")


def _word(count: int) -> str:
    """A number that may begin a sentence."""
    words = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine", "Ten", "Eleven", "Twelve")
    return words[count] if count < len(words) else str(count)


def _of(parameter: Parameter) -> str:
    return interval(parameter.value, parameter.low, parameter.high, parameter.level)


def _tracking_sentence(record: Record) -> str:
    track = record.track
    absent, lost, known = (
        int(n) for n in ((track.status == ABSENT).sum(), (track.status == LOST).sum(), track.tracked.sum())
    )
    text = f"The die is in view on {len(track) - absent} of {plural(len(track), 'frame')}; its pose is known on {known}"
    return text + (f" and was lost on {lost}." if lost else " of them." if absent else ".")


def _bounce_sentence(record: Record) -> str:
    impacts = record.measured.impacts
    if not impacts:
        return "No bounce was seen."
    unresolved = sum(impact.contact == "unresolved" for impact in impacts)
    times = ", ".join(f"{1e3 * impact.time_s:.1f}" for impact in impacts[:6]) + (", …" if len(impacts) > 6 else "")
    found = "One bounce was" if len(impacts) == 1 else f"{_word(len(impacts))} bounces were"
    text = f"{found} found, at {times} ms"
    return text + (f"; {unresolved} of them could not be resolved into single contacts." if unresolved else ".")


def _restitution_sentence(chi: Parameter | None) -> str:
    if chi is None or chi.value is None:
        return f"The restitution coefficient χ is {UNKNOWN}; the messages say why."
    return f"The restitution coefficient χ is {_of(chi)}."
