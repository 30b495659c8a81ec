"""The documents that readers see, and the blocks of code in them."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

FENCE = re.compile(r"^```([\w-]*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
"""Language and text of a block."""


def documents(repository: Path) -> Iterator[tuple[str, str]]:
    """Name and Markdown of each document; the change log tells of commands as they were."""
    yield from ((name, (repository / name).read_text()) for name in ("README.md", "CONTRIBUTING.md"))
    for path in sorted([*repository.glob("docs/**/*.md"), *repository.glob("examples/*/**/*.md")]):
        yield str(path.relative_to(repository)), path.read_text()
    for path in sorted(repository.glob("docs/tutorials/*/*.ipynb")):
        cells = json.loads(path.read_text())["cells"]
        texts = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"]
        yield str(path.relative_to(repository)), "\n".join(texts)
