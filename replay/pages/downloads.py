"""The tables of an analysis within its page, as links that save them: the page alone then hands on the numbers as well."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape

MOST_BYTES = 2_000_000
"""Of one table in a page. The tables of a longer clip stay beside the page."""
KINDS = {"csv": "text/csv", "json": "application/json", "bib": "application/x-bibtex"}
"""Media types by the ends of names."""


def downloads_html(tables: Mapping[str, str]) -> str:
    """Links to save `tables`, the contents of files by their names; nothing without tables."""
    if not tables:
        return ""
    items = "\n".join(f"<li>{_link(name, text.encode())}</li>" for name, text in tables.items())
    return f'<h2>Tables</h2>\n<ul class="downloads">\n{items}\n</ul>'


def _link(name: str, data: bytes) -> str:
    size = f"{len(data) / 1000:.0f} kB" if len(data) >= 1000 else f"{len(data)} bytes"
    if len(data) > MOST_BYTES:
        return f"{escape(name)} ({size}), in the folder of this page"
    kind = KINDS[name.rpartition(".")[2]]
    address = f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"
    return f'<a download="{escape(name)}" href="{address}">{escape(name)}</a> ({size})'
