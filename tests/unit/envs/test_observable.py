"""What an observable says of itself with another gel, and that the tasks' own agree with what they give."""

from dataclasses import replace

import numpy as np
import pytest
from vitac.envs.observable import BackProjection, Observable
from vitac.envs.tasks.definition import TaskDefinition
from vitac.envs.tasks.registry import task_definitions
from vitac.envs.vision import observables as rig

GRID: Observable[object] = Observable(
    name="nodes", shape=(2, 49, 3), unit="m", meaning="Where they are.", read=lambda *_: np.zeros(3), node_axis=1
)
EVERY = [
    (definition.env_id, observable)
    for definition in task_definitions().values()
    for observable in definition.observables
]


@pytest.mark.parametrize(("axis", "shape"), [(0, (7, 49, 3)), (1, (2, 7, 3)), (2, (2, 49, 7))])
def test_another_gel_changes_the_axis_of_its_nodes_only(axis: int, shape: tuple[int, ...]) -> None:
    changed = replace(GRID, node_axis=axis).with_nodes(7)
    assert changed.shape == shape
    assert replace(changed, shape=GRID.shape, node_axis=1) == GRID


def test_what_does_not_depend_on_the_gel_stays() -> None:
    fixed = replace(GRID, node_axis=None)
    assert fixed.with_nodes(7) is fixed


@pytest.mark.parametrize(("env_id", "observable"), EVERY, ids=[f"{env_id} {row.name}" for env_id, row in EVERY])
def test_observables_of_tasks_can_stand_in_a_table(env_id: str, observable: Observable[object]) -> None:
    assert observable.name.isidentifier()
    assert observable.unit
    assert observable.meaning == observable.meaning.strip() != ""
    assert all(length > 0 for length in observable.shape)
    assert np.dtype(observable.dtype).kind in "fiu"
    assert observable.node_axis is None or 0 <= observable.node_axis < len(observable.shape)


@pytest.mark.parametrize("definition", task_definitions().values(), ids=task_definitions())
def test_names_of_a_task_are_unique_and_no_truth_is_public(definition: TaskDefinition) -> None:
    names = [observable.name for observable in definition.observables]
    assert len(set(names)) == len(names)
    assert not any(observable.privileged for observable in definition.public_observables)


def test_the_cloud_of_the_rig_follows_from_its_depth_picture() -> None:
    cloud = rig.POINT_CLOUD
    assert isinstance(cloud.computed_from, BackProjection)
    assert cloud.computed_from.depth == rig.DEPTH_PICTURE.name
    assert cloud.shape == (*rig.DEPTH_PICTURE.shape, 3)
    assert len(cloud.computed_from.intrinsics) == 4


def test_pictures_are_what_cameras_see_and_truths_are_not_public() -> None:
    assert rig.RGB_PICTURE.picture
    assert rig.DEPTH_PICTURE.picture
    assert rig.SEGMENTATION.privileged
    assert not rig.RGB_PICTURE.privileged
