import numpy as np
from vitac.envs.observable import Observable
from vitac.envs.tasks.definition import ActionComponent, TaskDefinition, append_tables

HEIGHT: Observable[float] = Observable(
    name="height", shape=(1,), unit="mm", meaning="Above the table.", read=lambda scene, _: np.array([scene])
)
TRUTH: Observable[float] = Observable(
    name="truth",
    shape=(2, 3),
    unit="m",
    meaning="Where it is.",
    read=lambda scene, _: np.full((2, 3), scene),
    privileged=True,
)
TASK = TaskDefinition(
    env_id="Test/Task-v1",
    environment="nowhere:Env",
    actions=(ActionComponent(name="lift", scale=2.0, unit="mm", meaning="Upwards."),),
    observables=(TRUTH, HEIGHT),
)


def test_a_policy_sees_nothing_privileged() -> None:
    assert TASK.public_observables == (HEIGHT,)


def test_tables_of_the_docstring_are_the_lists() -> None:
    docstring = append_tables(
        """Lift it.

        More.
        """,
        TASK,
    )
    lines = docstring.splitlines()
    assert lines[:4] == ["Lift it.", "", "More.", ""]
    assert "| 0 | lift | 2 mm | Upwards. |" in lines
    assert "| truth | (2, 3) | float32 | m | Where it is. **Only with `privileged=True`.** |" in lines
    assert "| height | (1,) | float32 | mm | Above the table. |" in lines
