from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from vitac.envs.tasks import registry
from vitac.envs.tasks.definition import TaskDefinition
from vitac.envs.tasks.registry import ENTRY_POINT_GROUP, TaskRejected, task_definitions


@pytest.fixture(autouse=True)
def fresh_registry() -> Iterator[None]:
    task_definitions.cache_clear()
    yield
    task_definitions.cache_clear()


def added(monkeypatch: pytest.MonkeyPatch, *places: str) -> None:
    points = [EntryPoint(name="toy", value=place, group=ENTRY_POINT_GROUP) for place in places]
    monkeypatch.setattr(registry, "entry_points", lambda *, group: [point for point in points if point.group == group])


def test_every_folder_of_a_task_is_found() -> None:
    assert {"ViTac/LockOpening-v1", "ViTac/PegInsertion-v1"} <= set(task_definitions())


def test_task_of_another_package_is_added(monkeypatch: pytest.MonkeyPatch) -> None:
    added(monkeypatch, "test_definition_of_a_task:TASK")
    monkeypatch.setattr(EntryPoint, "load", lambda _: toy("Toy/Lift-v1"))
    assert task_definitions()["Toy/Lift-v1"].environment == "nowhere:Env"


def test_an_id_that_is_there_already_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    added(monkeypatch, "vitac.envs.tasks.peg_insertion.definition:TASK")
    with pytest.raises(TaskRejected, match=r"point toy adds ViTac/PegInsertion-v1, which is there already"):
        task_definitions()


def test_what_cannot_be_loaded_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    added(monkeypatch, "no.such.module:TASK")
    with pytest.raises(
        TaskRejected, match=r"adds the task no\.such\.module:TASK, which cannot be loaded \(ModuleNotFoundError"
    ):
        task_definitions()


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("raise ValueError('no gel')", "ValueError: no gel"),
        ("raise SystemExit('no licence')", "SystemExit: no licence"),
    ],
)
def test_a_package_that_fails_at_import_is_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, told: str
) -> None:
    (tmp_path / "broken_toy.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    added(monkeypatch, "broken_toy:TASK")
    with pytest.raises(TaskRejected, match=rf"adds the task broken_toy:TASK, which cannot be loaded \({told}\)"):
        task_definitions()


def test_what_is_no_task_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    added(monkeypatch, "math:pi")
    with pytest.raises(TaskRejected, match="adds math:pi, expected a TaskDefinition, got float"):
        task_definitions()


def toy(env_id: str) -> TaskDefinition:
    return TaskDefinition(env_id=env_id, environment="nowhere:Env", actions=(), observables=())
