"""Collecting demonstrations: the same bytes however it is done."""

from pathlib import Path

import pytest
from vitac.evaluator.submission.sources import submission_digest
from vitac.evaluator.tracks import find_task
from vitac.training.demonstrations.collecting import (
    CollectionRejected,
    DemonstrationKind,
    PolicyStopped,
    collect,
    count_outcomes,
    list_tasks,
    read_demonstrations,
    read_source,
)
from vitac.training.demonstrations.expert import Expert, NoExpert
from vitac.training.streams import StreamRefused, Use, stream

TASK = "lock-opening"


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return collect(TASK, tmp_path_factory.mktemp("one"), successes=10)


def test_collects_until_enough_succeed_and_keeps_what_failed(collected: Path) -> None:
    found = list(read_demonstrations(collected))
    assert sum(each.is_success for each in found) == 10
    assert found[-1].is_success
    assert [each.kind for each in found[:3]] == [
        DemonstrationKind.CLEAN,
        DemonstrationKind.NOISY,
        DemonstrationKind.CLEAN,
    ]
    rows = count_outcomes(collected)
    assert sum(row["episodes"] for row in rows) == len(found)
    assert rows[-1]["successes"] < rows[-1]["episodes"], "who is misled fails"


def test_processes_make_the_same_bytes(collected: Path, tmp_path: Path) -> None:
    assert collect(TASK, tmp_path, successes=10, processes=2).read_bytes() == collected.read_bytes()


def test_what_a_kill_left_is_continued_to_the_same_bytes(collected: Path, tmp_path: Path) -> None:
    whole = collected.read_bytes()
    left = tmp_path / TASK / collected.name
    left.parent.mkdir()
    left.write_bytes(whole[: whole.rindex(b"\n", 0, -1) + 100])
    heard: list[tuple[int, int]] = []
    collect(TASK, tmp_path, successes=10, report=lambda *numbers: heard.append(numbers))
    assert left.read_bytes() == whole
    assert len(heard) == 2, "one episode was lost"


def test_a_policy_plays_in_place_of_the_expert_the_same_bytes_in_any_number_of_processes(
    repository: Path, tmp_path: Path
) -> None:
    policy = repository / "examples" / "lock_opening_trained"
    one, two = (
        collect(TASK, tmp_path / str(processes), successes=3, policy=policy, processes=processes)
        for processes in (1, 2)
    )
    assert one.read_bytes() == two.read_bytes()
    assert read_source(one).policy == submission_digest(policy)
    noisy, own, _ = read_demonstrations(one)
    assert (noisy.kind, own.kind) == (DemonstrationKind.NOISY_POLICY, DemonstrationKind.POLICY)
    assert own.is_success
    with pytest.raises(CollectionRejected, match="another seed, policy or version"):
        collect(TASK, tmp_path / "1", successes=4)


def test_a_policy_that_fails_is_named_with_the_start_where_it_did(tmp_path: Path) -> None:
    (tmp_path / "policy.py").write_text(
        "class Policy:\n    def reset(self, task): pass\n    def act(self, observation): return observation['none']\n"
    )
    (tmp_path / "submission.yaml").write_text("track: track_1\ntasks: [lock-opening]\nname: fails\n")
    with pytest.raises(PolicyStopped, match=r"'rng_seed': \(1000000, 1\).*KeyError"):
        collect(TASK, tmp_path / "out", successes=1, policy=tmp_path, processes=2)


def test_other_starts_go_into_another_folder(collected: Path) -> None:
    with pytest.raises(CollectionRejected, match="another seed"):
        collect(TASK, collected.parents[1], successes=11, seed=1)


def test_starts_are_in_no_official_list(collected: Path) -> None:
    assert read_source(collected).stream == stream(0, Use.COLLECT)
    with pytest.raises(StreamRefused):
        collect(TASK, collected.parents[1], successes=1, seed=-1)


def test_names_the_line_that_is_not_what_was_written(collected: Path, tmp_path: Path) -> None:
    lines = collected.read_bytes().splitlines(keepends=True)
    damaged = tmp_path / TASK / collected.name
    damaged.parent.mkdir()
    for second, problem in ((b"{}\n", ":3 is no demonstration"), (lines[1], ":3 is episode 1, expected one after 1")):
        damaged.write_bytes(b"".join([*lines[:2], second, *lines[3:]]))
        with pytest.raises(CollectionRejected, match=problem):
            list(read_demonstrations(damaged))
    damaged.write_bytes(b"".join([lines[0], *lines[2:]]))
    with pytest.raises(CollectionRejected, match="leaves episodes out"):
        collect(TASK, tmp_path, successes=11)


def test_every_task_with_an_expert_is_listed_but_not_those_that_need_a_sensor() -> None:
    assert {"fusion-robust", "lock-opening", "peg-insertion"} < set(list_tasks())
    assert not {"sensor-design", "pick-cube"} & set(list_tasks())
    with pytest.raises(NoExpert, match="pick-cube has no expert"):
        Expert(find_task("pick-cube")[1])
