"""The reference of Python names what there is: every environment, all of the training, and whatever is shown in use."""

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from pkgutil import resolve_name

import pytest
import vitac.envs
from vitac.envs.tasks.task_env import TactileTaskEnv

NEEDS_TORCH = {f"vitac.training.reference.{name}" for name in ("policy", "td3")}
BLOCK = re.compile(r"^```python-reference\n(.*?)^```$", re.DOTALL | re.MULTILINE)
WHOLE_PACKAGES = {"vitac.envs", "vitac.evaluator", "vitac.training", "vitac.server"}


@pytest.fixture(scope="module")
def reference(repository: Path) -> dict[str, set[str]]:
    """What each line of a block documents: module and names, all of its own where it names none."""
    found: dict[str, set[str]] = {}
    for page in (repository / "docs" / "reference").glob("*.md"):
        for line in "".join(BLOCK.findall(page.read_text())).splitlines():
            target, _, members = line.partition(":")
            found[target] = {name.strip() for name in members.split(",") if name.strip()}
    return found


def has(reference: dict[str, set[str]], module: str, name: str | None = None) -> bool:
    return module in reference and (name is None or not reference[module] or name in reference[module])


def code_cells(notebook: Path) -> Iterator[str]:
    for cell in json.loads(notebook.read_text())["cells"]:
        if cell["cell_type"] == "code":
            yield "".join(cell["source"])


def shown_in_use(repository: Path) -> Iterator[tuple[str, str, str | None]]:
    """Where a name of ours is shown to readers: document, module, name."""
    for page in [repository / "README.md", *sorted((repository / "docs").rglob("*.md"))]:
        if not {"reference"} & set(page.parts):
            text = re.sub(r"python -m \S+", "", page.read_text())
            for dotted in re.findall(r"(?<![\w./])vitac\.(?:envs|evaluator|training)[\w.]*\w", text):
                yield page.name, *split(dotted)
    for notebook in sorted((repository / "docs").rglob("tutorials/*/*.ipynb")):
        for cell in code_cells(notebook):
            for node in ast.walk(ast.parse(cell)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("vitac."):
                    yield from ((notebook.name, node.module or "", alias.name) for alias in node.names)


def split(dotted: str) -> tuple[str, str | None]:
    """Part a name into its module and what is in it."""
    module, _, name = dotted.rpartition(".")
    return (module, name) if (name[0].isupper() or name == "rendered_picture") else (dotted, None)


def test_what_the_reference_names_is_there(reference: dict[str, set[str]]) -> None:
    for target, members in reference.items():
        found = resolve_name(target)
        assert [name for name in members if not hasattr(found, name)] == [], target


def test_all_of_the_training_is_in_the_reference(repository: Path, reference: dict[str, set[str]]) -> None:
    files = sorted((repository / "training").rglob("*.py"))
    modules = [
        ".".join(("vitac", *file.relative_to(repository).with_suffix("").parts))
        for file in files
        if file.name != "__init__.py"
    ]
    assert len(modules) > 20
    assert [name for name in modules if not has(reference, name) and name not in NEEDS_TORCH] == []


def test_every_environment_is_in_the_reference_with_its_settings(reference: dict[str, set[str]]) -> None:
    for place in vitac.envs.ENVIRONMENTS.values():
        env = resolve_name(place)
        assert issubclass(env, TactileTaskEnv)
        settings = env.settings_type
        assert has(reference, settings.__module__, settings.__name__), place
    assert has(reference, TactileTaskEnv.__module__, TactileTaskEnv.__name__)


def test_what_is_shown_in_use_is_in_the_reference(repository: Path, reference: dict[str, set[str]]) -> None:
    environments = {place.partition(":")[0] for place in vitac.envs.ENVIRONMENTS.values()}  # on a page of their own
    shown = list(shown_in_use(repository))
    assert len(shown) > 12
    lacking = {
        f"{document}: {module} {name or ''}"
        for document, module, name in shown
        if module not in WHOLE_PACKAGES | environments and not has(reference, module, name)
    }
    assert lacking == set()
