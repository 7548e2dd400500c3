"""The page of the documentation and the tests at the limits say the same."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from extremes_page import COMMAND, sentence

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "extremes.md"


@pytest.mark.parametrize("file", sorted(HERE.glob("test_*.py")), ids=lambda path: path.stem)
def test_what_is_expected_stands_on_the_page(file: Path) -> None:
    """A law that was added, reworded or taken away asks for a new page."""
    functions = [node for node in ast.parse(file.read_text("utf-8")).body if isinstance(node, ast.FunctionDef)]
    laws = [node for node in functions if "happened" in {argument.arg for argument in node.args.args}]
    page = PAGE.read_text(encoding="utf-8")
    missing = [law.name for law in laws if f"| {sentence(ast.get_docstring(law) or '')} |" not in page]
    assert missing == [], f"write the page again: {COMMAND}"
