import json
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from example_policies import load


@pytest.fixture(scope="module")
def example(request: pytest.FixtureRequest, repository: Path) -> Path:
    """The folder that a test module names as `EXAMPLE`."""
    return repository / "examples" / str(request.module.EXAMPLE)


@pytest.fixture(scope="module")
def policy(example: Path) -> ModuleType:
    """The code of its only submission."""
    [file] = example.glob("*/policy.py")
    return load(file)


@pytest.fixture(scope="module")
def figures(example: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((example / "figures.json").read_text())
    return found
