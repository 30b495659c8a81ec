"""What reference managers read of the software is of this version."""

from importlib.metadata import version
from pathlib import Path

import yaml


def test_citation_file_names_this_version(repository: Path) -> None:
    cited = yaml.safe_load((repository / "CITATION.cff").read_text())
    assert cited["version"] == version("vitac-arena")
    assert {"cff-version", "message", "title", "authors", "license"} <= cited.keys()
    assert cited["title"].removeprefix("ViTac Arena: ") in (repository / "docs" / "citing.md").read_text()
