"""Builds the documentation site: `.venv/bin/sphinx-build -W docs web/documentation`, which setup/docs.sh does."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "builder"))

project = "ViTac Arena"
copyright = "the ViTac Arena developers"  # noqa: A001 - Sphinx's name
version = release = version_of("vitac-arena")
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "generated_pages",
    "finished_pages",
]
exclude_patterns = ["builder", "generated"]

# Links to headings of these levels work as they do where Markdown is shown with the source.
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_default_options = {"exclude-members": "model_config"}

html_theme = "furo"
html_title = f"ViTac Arena {version}"
html_copy_source = False
html_show_sourcelink = False
