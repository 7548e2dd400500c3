"""The findings of a check as a table, as the page of a check and the report of a throw show them."""

from __future__ import annotations

from html import escape

from ...tracking.check import Finding, Verdict
from ..elements import IMPACT, MEASURED, SIMULATED, hex_colour

COLOURS = {
    Verdict.GOOD: hex_colour(MEASURED),
    Verdict.DOUBTFUL: hex_colour(IMPACT),
    Verdict.BAD: hex_colour(SIMULATED),
}


def findings_table(findings: tuple[Finding, ...]) -> str:
    """Every finding in a row: its name, verdict, what was measured and what to change."""
    rows = "\n".join(
        f'<tr><td>{escape(finding.name)}</td><td><span class="dot" style="background:{COLOURS[finding.verdict]}"></span>'
        f"{finding.verdict.value}</td><td>{escape(finding.measured)}</td><td>{escape(finding.advice)}</td></tr>"
        for finding in findings
    )
    return (
        '<div class="wide"><table>\n<thead><tr><th></th><th>verdict</th><th>measured</th><th>what to change</th></tr></thead>\n'
        f"<tbody>\n{rows}\n</tbody></table></div>"
    )
