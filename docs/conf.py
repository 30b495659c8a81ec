"""Builds the documentation site: `.venv/bin/sphinx-build -W docs web/documentation`, which setup/docs.sh does."""

import gc
import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "builder"))

# Few of a build's many objects are garbage; looking for it as often as usual takes a sixth of the build.
gc.set_threshold(100_000)

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
templates_path = ["templates"]
html_title = f"ViTac Arena {version}"
html_favicon = "../web/static/mark.svg"
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "arena.html",
        "sidebar/search.html",
        "sidebar/scroll-start.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
    ]
}
html_copy_source = False
html_show_sourcelink = False
