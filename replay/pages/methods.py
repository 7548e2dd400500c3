"""The methods of an analysis in two paragraphs that can go into a paper, with the references and their BibTeX.

Each sentence is written from the record: what was measured, what was fitted, which effects were needed, and what the interval
holds. A sentence whose facts are missing is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from ...tracking.track import ABSENT
from ..elements import Record, ReportDetails, count_word, interval, number, plural
from .interval_sources import share_words

if TYPE_CHECKING:
    from ...fitting.results import Fit


@dataclass(frozen=True)
class Reference:
    """A publication."""

    key: str
    """In BibTeX."""
    kind: str
    text: str
    """As a list of references has it."""
    fields: Mapping[str, str]
    """Of BibTeX."""

    @property
    def bibtex(self) -> str:
        """Its entry."""
        lines = "".join(f"  {name} = {{{value}}},\n" for name, value in self.fields.items())
        return f"@{self.kind}{{{self.key},\n{lines}}}\n"


def _article(
    key: str, authors: str, title: str, journal: str, volume: str, pages: str, year: str, doi: str
) -> Reference:
    names = authors.replace(" and ", ", ")
    return Reference(
        key,
        "article",
        f"{names}: {title}. {journal} {volume}, {pages.replace('--', '–')} ({year}). doi:{doi}",
        {
            "author": authors,
            "title": title,
            "journal": journal,
            "volume": volume,
            "pages": pages,
            "year": year,
            "doi": doi,
        },
    )


MODEL = _article(
    "kapitaniak2012",
    "M. Kapitaniak and J. Strzalko and J. Grabski and T. Kapitaniak",
    "The three-dimensional dynamics of the die throw",
    "Chaos",
    "22",
    "047504",
    "2012",
    "10.1063/1.4746038",
)
FRICTION = _article(
    "stronge1990",
    "W. J. Stronge",
    "Rigid body collisions with friction",
    "Proceedings of the Royal Society A",
    "431",
    "169--181",
    "1990",
    "10.1098/rspa.1990.0125",
)
ALGEBRAIC = _article(
    "chatterjee1998",
    "A. Chatterjee and A. Ruina",
    "A new algebraic rigid-body collision law based on impulse space considerations",
    "Journal of Applied Mechanics",
    "65",
    "939--951",
    "1998",
    "10.1115/1.2791938",
)
EVIDENCE = _article(
    "chen2008",
    "J. Chen and Z. Chen",
    "Extended Bayesian information criteria for model selection with large model spaces",
    "Biometrika",
    "95",
    "759--771",
    "2008",
    "10.1093/biomet/asn034",
)
PROFILE = _article(
    "venzon1988",
    "D. J. Venzon and S. H. Moolgavkar",
    "A method for computing profile-likelihood-based confidence intervals",
    "Applied Statistics",
    "37",
    "87--94",
    "1988",
    "10.2307/2347496",
)
SIEVE = _article(
    "buhlmann1997",
    "P. Bühlmann",
    "Sieve bootstrap for time series",
    "Bernoulli",
    "3",
    "123--148",
    "1997",
    "10.2307/3318584",
)
INTERVALS = {
    "profile": ("profile-likelihood interval", PROFILE),
    "covariance": ("interval from the covariance of the fit", None),
    "bootstrap": ("interval from a bootstrap of the residuals", SIEVE),
}
"""The kinds of intervals in words, and their sources."""
RESTITUTIONS = {
    "stronge": "χ² is the ratio of the work of the normal force in restitution to that in compression",
    "poisson": "χ is the ratio of the normal impulses in restitution and compression",
    "newton": "χ is the ratio of the normal velocities after and before the impact",
    "algebraic": "χ is the ratio of the normal velocities after and before the impact",
}


def program_reference(version: str | None) -> Reference:
    """The program, in this version if it is known."""
    title = "diethrow: experiment against simulation for high-speed footage of thrown dice"
    fields = {"author": "{The diethrow authors}", "title": title, **({"version": version} if version else {})}
    text = f"The diethrow authors: {title}." + (f" Version {version}." if version else "")
    return Reference("diethrow", "software", text, fields)


class Citations:
    """The references in the order in which a text cites them."""

    def __init__(self) -> None:
        self.references: list[Reference] = []

    def mark(self, reference: Reference) -> str:
        """`[2]`."""
        if reference not in self.references:
            self.references.append(reference)
        return f"[{self.references.index(reference) + 1}]"


def methods_text(record: Record, details: ReportDetails) -> tuple[list[str], list[Reference]]:
    """The paragraphs, and the references that they cite, in their order."""
    citations = Citations()
    paragraphs = [" ".join(_measurement(record, details.origin or {}, citations))]
    if record.fit is not None and record.fit.bounces_fitted:
        paragraphs.append(" ".join(_model(record, record.fit, citations)))
    return paragraphs, citations.references


def methods_html(paragraphs: Sequence[str], references: Sequence[Reference]) -> str:
    """The section of a page, from what `methods_text` gives."""
    listed = "\n".join(f"<li>{escape(reference.text)}</li>" for reference in references)
    return (
        "<h2>Methods, to be pasted into a paper</h2>\n"
        + "\n".join(f"<p>{escape(text)}</p>" for text in paragraphs)
        + f'\n<ol class="references">\n{listed}\n</ol>\n<details><summary>BibTeX</summary><pre>{escape(bibtex(references))}</pre>'
        "</details>"
    )


def bibtex(references: Sequence[Reference]) -> str:
    """The entries of all references."""
    return "\n".join(reference.bibtex for reference in references)


def _measurement(record: Record, origin: Mapping[str, Any], citations: Citations) -> Iterator[str]:
    solid, track = record.die.solid, record.track
    edges = np.linalg.norm(np.subtract(*solid.vertices[solid.edges.T]), axis=1)
    length = f"edge {number(1e3 * float(edges.mean()))} mm"
    if np.ptp(edges) > 1e-6 * edges.mean():
        length = f"edges of {number(1e3 * float(edges.min()))} to {number(1e3 * float(edges.max()))} mm"
    visible = int((track.status != ABSENT).sum())
    program = program_reference(origin.get("diethrow"))
    yield (
        f"A die ({solid.name}, {length}, mass {number(1e3 * record.die.mass_kg)} g) was filmed at {number(record.fps, 6)} frames "
        "per second."
    )
    frames = f"{int(track.tracked.sum())} of the {plural(visible, 'frame')} that show it"
    # Without a camera the track may be from any program.
    measured = (
        f"Its pose was measured on {frames}, with"
        if record.camera
        else f"Its pose is given on {frames}, and was analysed with"
    )
    yield f"{measured} diethrow {citations.mark(program)}."
    variances = np.einsum("kii->ki", track.covariance[track.tracked])
    if len(variances) and np.isfinite(variances).all():
        errors = np.sqrt(np.median(variances, axis=0))
        yield (
            f"The median standard errors of a pose are {number(1e3 * float(errors[:3].max()), 2)} mm or less along the world's "
            f"axes and {number(float(np.rad2deg(errors[3:].max())), 2)}° or less about them."
        )
    count = len(record.measured.bounces)
    if count:
        impacts = "impact was" if count == 1 else "impacts were"
        yield f"{count_word(count)} {impacts} found where two free flights meet."


def _model(record: Record, fit: Fit, citations: Citations) -> Iterator[str]:
    law = f"the rigid-impact model of Kapitaniak et al. {citations.mark(MODEL)}"
    mu = fit.parameters.get("mu")
    if mu is not None and mu.value is not None:
        if fit.restitution == "algebraic":
            law += f" and the friction of the algebraic law of Chatterjee and Ruina {citations.mark(ALGEBRAIC)}"
        else:
            law += f" and Coulomb friction integrated along the normal impulse {citations.mark(FRICTION)}"
        law += f"; {RESTITUTIONS[fit.restitution]}"
    share = plural(fit.bounces_fitted, "impact")
    if fit.bounces_fitted < len(record.measured.bounces):
        share = f"the first {share} of {len(record.measured.bounces)}"
    yield (
        f"The restitution coefficient χ and the initial position, orientation, velocity and angular velocity were estimated by "
        f"weighted least squares from the poses before and after {share}, with {law}."
    )
    added = [name for name in fit.chosen if name != "smooth impact"]
    tried = sum(effect.evidence is not None for effect in fit.considered)
    needed = f"The model includes {', '.join(added)}." if added else "No effect beyond the smooth impact was needed."
    if tried:
        others = "other effect" if tried == 1 else "other effects"
        needed += f" {count_word(tried)} {others} did not improve it by the criterion of {citations.mark(EVIDENCE)}."
    yield needed
    method, source = INTERVALS[fit.choices.intervals]
    cited = f" {citations.mark(source)}" if source is not None else ""
    values = [
        f"{'χ' if name == 'chi' else 'μ' if name == 'mu' else name} = {interval(p.value, p.low, p.high, p.level)}"
        for name, p in fit.parameters.items()
        if p.free and p.value is not None
    ]
    if values:
        yield f"The result, each with its {method}{cited}, is {', '.join(values)}."
    if fit.residual_rms is not None:
        yield (
            "Measured and simulated poses differ by "
            f"{number(fit.residual_rms, 2)} standard errors of the measurement (root mean square)."
        )
    shares = fit.variance_shares.get("chi", {})
    if shares:
        yield f"The variance of χ is made of: {share_words(shares)}."
