"""Shards whose episodes are played several at once, on a stand-in for the GPU; the last test has real sandboxes."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cubes_track import FILE
from evaluation_fakes import FakeSession, cannot_load, fail
from evaluation_records import make_failure
from fake_pick_cube import in_place_of_maniskill
from fake_scenes import FakeScenes, in_place_of_the_gpu
from numpy.typing import NDArray
from submissions import submission_folder
from vitac.envs.maniskill.env import ManiSkillEnv, ManiSkillFailed
from vitac.evaluator.agent.limits import GIB, MIB, Limits
from vitac.evaluator.agent.verdicts import SandboxFailed
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.logs.findings import VerificationResult
from vitac.evaluator.logs.log import LogHeader
from vitac.evaluator.logs.verification import verify
from vitac.evaluator.scoring.score import breaking_failure
from vitac.evaluator.shards.batch import MachineTooSmall, run_batches
from vitac.evaluator.shards.execution import execute
from vitac.evaluator.shards.order import OrderedShard, ShardEnd, ShardMessage, ShardOrder, ShardResult
from vitac.evaluator.shards.policy import Preparation
from vitac.evaluator.strict_model import parse_yaml
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Track
from vitac.evaluator.tracks.definition import cut
from vitac.evaluator.version import evaluator_hash

FILE_ON_GPU = FILE.replace("obs_mode: state", "obs_mode: state, sim_backend: physx_cuda, batch_size: 4")
TRACK = parse_yaml(Track, FILE_ON_GPU, "cubes.yaml")
TASK = TRACK.tasks["pick-cube"]
FIRST = cut(TASK)[0]
MANIFEST = "track: cubes\ntasks: [pick-cube]\nname: cubes\ncontrol_modes: {pick-cube: pd_ee_delta_pos}\n"
POLICY = """
class Policy:
    def reset(self, task):
        self.env_step = 0

    def act(self, observation):
        self.env_step += 1
        assert observation["state"][4] == self.env_step - 1, "an observation of its own env step"
        return [1.0 if self.env_step == 3 else 0.5, 0.0, 0.0, 0.0]
"""


def solve(_: int, step: int) -> NDArray[np.float32]:
    return np.array([1.0 if step == 3 else 0.5, 0, 0, 0], np.float32)


class Sessions:
    """Gives each scene a loaded policy of its own."""

    def __init__(self, answer: Any = solve) -> None:
        self.answer = answer
        self.limits: list[Limits] = []
        self.loaded: list[FakeSession] = []

    @contextmanager
    def load(self, _folder: Path, limits: Limits) -> Iterator[FakeSession]:
        session = FakeSession(self.answer, plays=("pick-cube", (4,)))
        self.limits.append(limits)
        self.loaded.append(session)
        with session.load():
            yield session


@pytest.fixture(scope="module", autouse=True)
def cubes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The track beside ours, as an organizer adds it."""
    folder = tmp_path_factory.mktemp("tracks")
    (folder / "cubes.yaml").write_text(FILE_ON_GPU)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VITAC_TRACKS_DIR", str(folder))
        evaluator_hash.cache_clear()  # it covers these files, too
        yield
    evaluator_hash.cache_clear()


@pytest.fixture(autouse=True)
def simulations(monkeypatch: pytest.MonkeyPatch) -> list[FakeScenes]:
    made = in_place_of_the_gpu(monkeypatch)
    real = FakeScenes.__init__

    def with_four_numbers(self: FakeScenes, size: int) -> None:
        real(self, size)
        self.single_action_space.shape = (4,)

    monkeypatch.setattr(FakeScenes, "__init__", with_four_numbers)
    return made


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for path in (tmp_path.parent, tmp_path):
        path.chmod(0o755)
    return submission_folder(tmp_path / "Cubes", {"submission.yaml": MANIFEST, "policy.py": POLICY})


def order(folder: Path, **changes: Any) -> ShardOrder:
    fields = {"limits": Limits(memory_bytes=256 * MIB)} | changes  # for machines with little memory, too
    return ShardOrder(
        kind=SubmissionKind.MODEL, submission=folder, track="cubes", task="pick-cube", shard=0, **fields
    )  # fmt: skip


def run(order: ShardOrder, load: Any) -> tuple[ShardResult, dict[int, EpisodeRecord]]:
    records: list[EpisodeRecord] = []
    busy = threading.Lock()

    def note(record: EpisodeRecord) -> None:
        assert busy.acquire(blocking=False), "records come one at a time"
        records.append(record)
        busy.release()

    ordered = OrderedShard(order=order, track=TRACK, task=TASK, shard=FIRST)
    result = run_batches(ordered, note, load_policy=load)
    assert len({record.episode for record in records}) == len(records)
    return result, {record.episode: record for record in records}


def test_all_episodes_of_a_shard_are_played_with_one_policy_for_each_scene(
    folder: Path, simulations: list[FakeScenes]
) -> None:
    sessions = Sessions()
    result, records = run(order(folder), sessions.load)
    assert (result.index, result.end, result.isolation) == (0, ShardEnd.COMPLETE, FakeSession.isolation)
    assert sorted(records) == list(range(1, 11))
    assert {(record.outcome, record.env_steps) for record in records.values()} == {(EpisodeOutcome.SUCCESS, 3)}
    assert len({record.state_hashes[0] for record in records.values()}) == 10
    assert len(sessions.loaded) == 4
    assert sorted(session.started for session in sessions.loaded) == [2, 2, 3, 3]
    (simulation,) = simulations
    assert (simulation.size, len(simulation.built), len(simulation.commands)) == (4, 3, 9)


def test_which_scene_plays_which_episodes_is_not_the_lists_order(folder: Path, simulations: list[FakeScenes]) -> None:
    """A policy knows its user's id, which is another one in each scene."""
    for _ in range(3):
        run(order(folder), Sessions().load)
    assert len({str(simulation.built) for simulation in simulations}) > 1


def test_a_resumed_shard_plays_what_is_missing_from_the_same_starts(
    folder: Path, simulations: list[FakeScenes]
) -> None:
    _, whole = run(order(folder), Sessions().load)
    _, rest = run(order(folder, skip=(1, 2, 3, 4, 5, 6, 7, 8)), Sessions().load)
    assert {number: record.state_hashes for number, record in rest.items()} == {
        number: whole[number].state_hashes for number in (9, 10)
    }
    sessions = Sessions()
    result, records = run(order(folder, skip=tuple(range(1, 11))), sessions.load)
    assert (result.end, records, sessions.loaded) == (ShardEnd.COMPLETE, {}, [])
    assert {simulation.size for simulation in simulations} == {4}, "the class of an evaluation stays"


def test_a_failed_policy_costs_its_episode_and_the_others_go_on(folder: Path) -> None:
    sessions = Sessions(lambda started, step: fail() if started == 3 else solve(started, step))
    result, records = run(order(folder), sessions.load)
    failed = [record for record in records.values() if record.failure]
    assert (result.end, len(records), len(failed)) == (ShardEnd.COMPLETE, 10, 2)


@pytest.mark.parametrize(("skipped", "most"), [(0, 6), (6, 4)], ids=["whole shard", "as many left as scenes"])
def test_failures_of_all_scenes_count_together(folder: Path, skipped: int, most: int) -> None:
    sessions = Sessions(lambda *_: fail())
    result, records = run(order(folder, skip=tuple(range(1, 1 + skipped))), sessions.load)
    assert result.end is ShardEnd.BROKEN
    assert 4 <= len(records) <= most, "those that wait for a start when the third fails still play"
    assert all(record.failure for record in records.values())


def test_failures_before_a_shard_was_resumed_count_in_all_scenes(folder: Path) -> None:
    failing = iter([True])
    sessions = Sessions(lambda started, step: fail() if next(failing, False) else solve(started, step))
    before = order(folder, skip=(1, 2), earlier_failures=(make_failure(),) * 2)
    result, records = run(before, sessions.load)
    assert (result.end, len(records)) == (ShardEnd.BROKEN, 4), "no scene starts another episode"
    assert sum(bool(record.failure) for record in records.values()) == 1


def test_a_policy_that_cannot_be_loaded_or_failed_before_ends_the_shard(folder: Path) -> None:
    result, records = run(order(folder), cannot_load)
    assert (result.end, len(records), result.isolation) == (ShardEnd.BROKEN, 4, None)
    assert breaking_failure([FIRST], records.values()) is not None
    before = order(folder, skip=(1, 2, 3), earlier_failures=(make_failure(),) * 3)
    sessions = Sessions()
    result, records = run(before, sessions.load)
    assert (result.end, records, sessions.loaded) == (ShardEnd.BROKEN, {}, [])


@pytest.mark.parametrize(("cores", "sharing"), [(1, 4), (3, 2), (4, 1), (64, 1)])
def test_limits_by_the_clock_are_for_the_policies_that_share_a_core(
    folder: Path, monkeypatch: pytest.MonkeyPatch, cores: int, sharing: int
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(cores)))
    alone, sessions = order(folder).limits, Sessions()
    run(order(folder), sessions.load)
    assert len(sessions.limits) == 4
    (each,) = set(sessions.limits)
    by_the_clock = {"start_wall_s", "action_wall_s", "shard_wall_s"}
    assert asdict(each) == {
        name: value * sharing if name in by_the_clock else value for name, value in asdict(alone).items()
    }
    run(order(folder, skip=tuple(range(1, 10))), sessions.load)
    assert sessions.limits[-1] == alone, "one episode is left, and one policy"


@pytest.mark.parametrize(
    ("machine_gib", "group_gib", "what"),
    [
        (11, None, "this machine has"),
        (11, 2**33, "this machine has"),
        (64, 11, r"the control group \(of a container, say\) allows"),
    ],
)
def test_more_policies_than_there_is_memory_for_are_refused_before_anything_is_loaded(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    simulations: list[FakeScenes],
    machine_gib: int,
    group_gib: int | None,
    what: str,
) -> None:
    monkeypatch.setattr("os.sysconf", {"SC_PAGE_SIZE": 4096, "SC_PHYS_PAGES": machine_gib * GIB // 4096}.__getitem__)
    limit = None if group_gib is None else group_gib * GIB
    monkeypatch.setattr("vitac.evaluator.shards.batch.memory_limit_bytes", lambda: limit)
    sessions = Sessions()
    told = rf"4 policies at once may use 12\.0 GiB of memory, {what} 11\.0 GiB; take a smaller batch_size"
    with pytest.raises(MachineTooSmall, match=told):
        run(order(folder, limits=Limits()), sessions.load)
    assert (sessions.loaded, simulations) == ([], [])
    result, _ = run(order(folder, limits=Limits(), skip=(1, 2, 3, 4, 5, 6, 7)), sessions.load)
    assert result.end is ShardEnd.COMPLETE, "there is memory for the three that are left"


def test_a_fault_of_a_sandbox_or_of_the_simulation_is_not_the_teams(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> Any:
        raise SandboxFailed("no user namespaces")

    with pytest.raises(SandboxFailed, match="no user namespaces"):
        run(order(folder), broken)
    monkeypatch.setattr(FakeScenes, "get_state", lambda self: 1 / 0)
    with pytest.raises(ManiSkillFailed, match="failed in reset at env step 0: ZeroDivisionError"):
        run(order(folder), Sessions().load)


@pytest.mark.parametrize(
    ("solves", "result"), [(True, VerificationResult.WITHIN_TOLERANCE), (False, VerificationResult.DIVERGED)]
)
def test_a_log_of_batches_is_played_again_one_by_one_and_its_ends_decide(
    folder: Path, monkeypatch: pytest.MonkeyPatch, solves: bool, result: VerificationResult
) -> None:
    alone = in_place_of_maniskill(monkeypatch)
    alone.single_action_space.shape, alone.solves = (4,), solves
    played, records = run(order(folder), Sessions().load)
    header = LogHeader(manifest=played.manifest, team="Bears")
    env = ManiSkillEnv(TASK.env_id, max_steps=TASK.max_steps, settings=dict(TASK.settings))
    verified = verify(
        env=env, track=TRACK, task=TASK, header=header, records=list(records.values()), episodes=FIRST.numbers
    )
    assert verified.verdict is result
    assert verified.manifest == played.manifest
    assert ("does not repeat to the last bit; all outcomes are equal" in verified.reason) == solves


def test_an_order_for_a_task_with_batches_is_played_so_each_policy_in_a_sandbox_of_its_own(
    folder: Path, tmp_path: Path, simulations: list[FakeScenes]
) -> None:
    """With real sandboxes in four threads, as a worker's process of a shard has them."""
    answers = tmp_path / "answers"
    with answers.open("w") as answer, Preparation() as preparation:
        execute(order(folder, episodes=(1, 2, 3, 4, 5)), answer, preparation)
    *messages, last = map(ShardMessage.model_validate_json, answers.read_text().splitlines())
    assert (last.error, last.result and last.result.end) == (None, ShardEnd.COMPLETE)
    records = [message.record for message in messages if message.record]
    assert sorted(record.episode for record in records) == [1, 2, 3, 4, 5]
    assert {(record.failure, record.outcome) for record in records} == {(None, EpisodeOutcome.SUCCESS)}
    assert [simulation.size for simulation in simulations] == [4]
