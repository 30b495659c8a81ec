"""Runs the tutorial's notebook in its small setting when the site is built; results are kept until the code changes.

The pages of `docs/tutorials` also appear in `examples`; what a notebook expects beside itself is a symlink.
"""

import os
import shutil
from hashlib import sha256
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.config import Config

KEPT = "generated/notebooks"
MADE = "tutorials/*/tutorial_*"
"""What a notebook writes beside itself."""


def setup(app: Sphinx) -> dict[str, Any]:
    """Set where results are kept before the notebooks are read."""
    app.connect("config-inited", _prepare)
    app.connect("builder-inited", _place_outputs, priority=600)  # after MyST-NB has made its settings of ours
    return {"parallel_read_safe": True}


def _prepare(app: Sphinx, config: Config) -> None:
    source = Path(app.srcdir)
    os.environ["VITAC_TUTORIAL"] = "small"
    remove_leftovers(source)
    config.nb_execution_cache_path = str(kept_results(source / KEPT, code_version()))


def _place_outputs(app: Sphinx) -> None:
    """Keep the executed notebooks with the other files between builds; MyST-NB puts them beside the site."""
    settings = app.env.mystnb_config  # type: ignore[attr-defined]  # MyST-NB's
    app.env.mystnb_config = settings.copy(output_folder=str(Path(app.doctreedir) / "notebooks"))  # type: ignore[attr-defined]


def remove_leftovers(source: Path) -> None:
    """Remove what an earlier run left beside the notebooks: the next one would go on from there."""
    for left in source.glob(MADE):
        if left.is_dir():
            shutil.rmtree(left)
        else:
            left.unlink()


def kept_results(folder: Path, version: str) -> Path:
    """Return the folder for results of one version of the code; those of others are removed."""
    for other in folder.glob("*"):
        if other.name != version:
            shutil.rmtree(other)
    return folder / version


def code_version() -> str:
    """Return a hash of all that the notebooks run: the evaluator's version, and the sources of the training."""
    from vitac.evaluator.version import evaluator_hash, sources_hash

    return sha256((evaluator_hash() + sources_hash("vitac.training")).encode()).hexdigest()[:16]
