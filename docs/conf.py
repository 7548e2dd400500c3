"""The documentation: `sphinx-build -W -b html docs docs/_build`. Pictures and pages of commands are made by this build."""

from __future__ import annotations

import sys
from pathlib import Path

from sphinx.application import Sphinx

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_build_steps"))

import command_pages  # noqa: E402
import docstrings  # noqa: E402
import method_pages  # noqa: E402

import diethrow  # noqa: E402

project = "diethrow"
author = "the diethrow authors"
release = version = diethrow.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
templates_path = ["_templates"]
exclude_patterns = ["_build", "_build_steps", "_templates", "gallery", "commands/notes", "Thumbs.db"]
myst_heading_anchors = 3

# Two stages have a Table each, that of the scene file and that of the model; a short name in a signature cannot say which.
suppress_warnings = ["ref.python"]

autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True, "show-inheritance": False}
autodoc_type_aliases = {
    name: name for name in ("Array", "ArrayLike", "NDArray", "Frame", "Image", "Integers", "Progress")
}
default_role = "code"

sphinx_gallery_conf = {
    "examples_dirs": str(HERE / "gallery"),
    "gallery_dirs": "pictures",
    "filename_pattern": r"/plot_",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "min_reported_time": 1e9,
    "matplotlib_animations": False,
    "abort_on_example_error": True,
}

html_theme = "pydata_sphinx_theme"
html_title = "diethrow"
html_theme_options = {
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "header_links_before_dropdown": 6,
    "footer_start": [],
    "footer_end": [],
}
html_sidebars = {page: [] for page in ("index", "tutorial", "phone", "equipment", "comparison")}
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False


def setup(app: Sphinx) -> None:
    """Write the pages that are made from the program itself, before Sphinx looks for pages."""
    command_pages.write(HERE / "commands")
    method_pages.write(HERE)
    app.connect("autodoc-process-docstring", docstrings.as_rest)
