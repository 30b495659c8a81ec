"""Builds the documentation site: `.venv/bin/sphinx-build -W docs web/documentation`, which setup/docs.sh does."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "builder"))

project = "ViTac Arena"
copyright = "the ViTac Arena developers"  # noqa: A001 - Sphinx's name
version = release = version_of("vitac-arena")
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "animations",
    "generated_pages",
    "notebooks",
    "plain_types",
    "finished_pages",
]
exclude_patterns = ["builder", "generated", "tutorials/*/tutorial_*", "tutorials/peg_insertion_heuristic"]

# The tutorial runs when the site is built, in miniature.
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 300  # of a cell [s]; the first one that steps may compile the physics
nb_merge_streams = True

# Links to headings of these levels work as they do where Markdown is shown with the source.
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_default_options = {"exclude-members": "model_config"}

html_theme = "furo"
html_title = f"ViTac Arena {version}"
html_copy_source = False
html_show_sourcelink = False
