"""The example of an analysis as a notebook, run from top to bottom in a kernel of its own."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs" / "gallery"


def notebook_of(script: Path) -> nbformat.NotebookNode:
    """Its cells begin at lines with `# %%`; comments below such a line are text, as is the docstring."""
    docstring, *cells = script.read_text(encoding="utf-8").split("\n# %%\n")
    sources = [
        "\n".join(line for line in cell.splitlines() if not line.startswith("# ")) for cell in (docstring, *cells)
    ]
    return nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source) for source in sources])


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_example_of_an_analysis_runs_as_a_notebook(tmp_path: Path) -> None:
    notebook = notebook_of(EXAMPLES / "plot_2_analysis.py")
    # A last line that is a value is shown, as a person would do.
    notebook.cells.append(nbformat.v4.new_code_cell("throw"))
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(ROOT)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 6
    assert "<td>chi</td>" in outputs[-1].data["text/html"]
