"""ManiSkill's own PickCube-v1 through sandbox, records and verification; skipped where the extra is not installed.

`./vitac --maniskill test tests/integration/maniskill tests/unit/envs/maniskill` installs it first.
"""

import gc
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from cubes_track import FILE
from submissions import submission_folder
from vitac.envs.maniskill import env as state_module
from vitac.envs.maniskill.definition import ManiSkillSettings
from vitac.envs.maniskill.env import ManiSkillEnv, ManiSkillFailed, ManiSkillMissing, missing_packages
from vitac.envs.maniskill.env import made as made_by_name
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.episode import run_episode
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.evaluation.local import evaluate
from vitac.evaluator.logs.findings import VerificationResult
from vitac.evaluator.logs.log import LogHeader
from vitac.evaluator.logs.verification import verify
from vitac.evaluator.package_sets import FURTHER_SETS_VARIABLE
from vitac.evaluator.tracks import Task, Track, load_track

pytestmark = [
    pytest.mark.skipif(
        bool(missing_packages()),
        reason=f"not installed: {', '.join(missing_packages())} (./vitac --maniskill test ...)",
    ),
    pytest.mark.filterwarnings("ignore:__array_wrap__ must accept:DeprecationWarning"),  # ManiSkill's own
]

TASK = "lift-a-cube"
TRACK_FILE = FILE.replace("pick-cube", TASK).replace("list_seed: 0", "list_seed: 1")

WHAT_THE_TASK_IS_CALLED = """
import numpy as np
import torch

ACTIONS = {
    "tensor": lambda: torch.full((4,), 0.5),
    "tensor-with-gradient": lambda: torch.zeros(4, requires_grad=True),
    "tensor-with-batch": lambda: torch.zeros(1, 4),
    "nan": lambda: np.full(4, np.nan),
    "one": lambda: np.ones(4),
    "seven": lambda: np.full(4, 7.0),
}


class Policy:
    def reset(self, task):
        self.answer = ACTIONS[task]

    def act(self, observation):
        assert type(observation["state"]) is np.ndarray and observation["state"].shape == (42,)
        return self.answer()
"""

LOOKS = """
import numpy as np


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        for name, value in sorted(observation.items()):
            print(name, value.dtype, "x".join(map(str, value.shape)), np.ptp(value.astype(float)) > 0)
        return np.zeros(4)
"""


@pytest.fixture(scope="module")
def track(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Track]:
    """A track that an organizer adds: a file in a folder, and nothing else."""
    folder = tmp_path_factory.mktemp("tracks")
    (folder / "cubes.yaml").write_text(TRACK_FILE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VITAC_TRACKS_DIR", str(folder))
        yield load_track("cubes")


@pytest.fixture(scope="module")
def env(track: Track) -> ManiSkillEnv:
    return made(track.tasks[TASK])


@pytest.fixture(scope="module")
def play(env: ManiSkillEnv, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[Task], EpisodeRecord]]:
    """Plays an episode of a task with the action that the task's name stands for, in one sandbox for all."""
    folder = folder_with(tmp_path_factory.mktemp("policy"), WHAT_THE_TASK_IS_CALLED)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(FURTHER_SETS_VARIABLE, "torch")
        with PolicySession(folder) as session:
            yield lambda task: run_episode(env=env, task=task, episode=task.episodes[0], open_session=lambda: session)


def made(task: Task, max_steps: int = 5) -> ManiSkillEnv:
    return ManiSkillEnv(task.env_id, max_steps=max_steps, settings=dict(task.settings))


def named(track: Track, name: str) -> Task:
    return track.tasks[TASK].model_copy(update={"name": name})


def folder_with(folder: Path, policy: str) -> Path:
    """A submission of one task that the sandbox's user can enter."""
    folder.mkdir(exist_ok=True)
    for path in (folder.parent, folder):
        path.chmod(0o755)
    manifest = {"track": "cubes", "tasks": [TASK], "name": "cubes", "control_modes": {TASK: "pd_ee_delta_pos"}}
    return submission_folder(folder, {"submission.yaml": yaml.safe_dump(manifest), "policy.py": policy})


def test_an_organizers_track_is_evaluated_in_other_processes_and_its_log_verified_in_this_one(
    track: Track, repository: Path, tmp_path: Path
) -> None:
    script = repository / "examples" / "maniskill" / "ManiSkill" / "pick_cube.py"
    policy = "from pick_cube import PickCube\nclass Policy(PickCube):\n    def reset(self, task): pass\n"
    folder = folder_with(tmp_path / "Cubes", policy)
    shutil.copy(script, folder)
    task = track.tasks[TASK]
    found = evaluate(submission_dir=folder, track=track, task=task, episodes=(1, 11), workers=2)
    assert (found.failure, [record.outcome for record in found.records]) == (None, 2 * [EpisodeOutcome.SUCCESS])
    assert found.manifest.task_hash == task.digest()
    header = LogHeader(manifest=found.manifest, team="Bears")
    env, numbers = made(task, task.max_steps), [record.episode for record in found.records]
    verified = verify(env=env, track=track, task=task, header=header, records=found.records, episodes=numbers)
    assert (verified.verdict, verified.score) == (VerificationResult.VERIFIED, found.score)
    pushed = found.records[0].actions.to_array()
    pushed[0] = -pushed[0]
    other = found.records[0].model_copy(update={"actions": found.records[0].actions.from_array(pushed)})
    records = [other, found.records[1]]
    refused = verify(env=env, track=track, task=task, header=header, records=records, episodes=numbers)
    assert (refused.verdict, refused.score) == (VerificationResult.DIVERGED, None)
    assert refused.divergence is not None
    assert (refused.divergence.episode, refused.divergence.env_step) == (1, 1)


def test_tensors_of_torch_are_taken_as_the_arrays_they_hold(
    track: Track, play: Callable[[Task], EpisodeRecord]
) -> None:
    record = play(named(track, "tensor"))
    assert (record.outcome, record.env_steps) == (EpisodeOutcome.STEPS, 5)
    assert (record.actions.to_array() == np.float32(0.5)).all()


@pytest.mark.parametrize(
    ("name", "verdict", "said"),
    [
        ("tensor-with-gradient", VerdictCode.BAD_ACTION_TYPE, "requires grad"),
        ("tensor-with-batch", VerdictCode.BAD_ACTION_SHAPE, "has shape (1, 4), expected (4,)"),
        ("nan", VerdictCode.NON_FINITE_ACTION, "expected finite numbers"),
    ],
)
def test_what_is_no_action_fails_the_episode_by_name(
    track: Track, play: Callable[[Task], EpisodeRecord], name: str, verdict: VerdictCode, said: str
) -> None:
    record = play(named(track, name))
    assert record.failure is not None
    assert (record.outcome, record.failure.code) == (EpisodeOutcome.POLICY_FAILED, verdict)
    assert said in record.failure.message


def test_an_action_outside_the_box_is_kept_as_it_was_given_and_played_as_its_edge(
    track: Track, play: Callable[[Task], EpisodeRecord]
) -> None:
    one, seven = play(named(track, "one")), play(named(track, "seven"))
    assert (seven.actions.to_array() == 7.0).all()
    assert seven.state_hashes == one.state_hashes


def test_an_error_in_the_middle_of_an_episode_is_the_machines_and_the_next_episode_is_as_ever(
    track: Track, env: ManiSkillEnv, play: Callable[[Task], EpisodeRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    real, played = env._env.step, []

    def step(action: Any) -> Any:
        played.append(action)
        if len(played) == 3:
            raise RuntimeError("PhysX is out of memory")
        return real(action)

    before = play(named(track, "one"))
    with monkeypatch.context() as patch:
        patch.setattr(env._env, "step", step)
        with pytest.raises(ManiSkillFailed, match="failed in step at env step 2: RuntimeError: PhysX is out of memory"):
            play(named(track, "one"))
    assert play(named(track, "one")).state_hashes == before.state_hashes


@pytest.mark.filterwarnings("ignore:The 'warn' method is deprecated:DeprecationWarning")  # ManiSkill's own
@pytest.mark.parametrize(
    ("name", "control_mode"),
    [
        ("PickCube-v1", "pd_ee_delta_pos"),
        ("PickCube-v1", "pd_ee_target_delta_pose"),  # a controller that has a state, too
        ("PegInsertionSide-v1", "pd_joint_delta_pos"),  # bodies that ManiSkill merges
        ("RotateValveLevel0-v1", "pd_joint_delta_pos"),  # two articulations
    ],
)
def test_the_state_is_maniskills_own_in_every_bit(name: str, control_mode: str) -> None:
    played = made_by_name(name, ManiSkillSettings(control_mode=control_mode))
    random = np.random.default_rng(0)
    for seed in (1, 2):
        played.reset(seed=seed, options={"reconfigure": True})
        for _ in range(10):
            played.step(random.uniform(-1.0, 1.0, played.single_action_space.shape).astype(np.float32))
            state, own = played.get_state(), type(played).get_state(played).numpy()
            assert (state.shape, state.dtype, state.tobytes()) == (own.shape, own.dtype, own.tobytes())


def test_a_state_that_is_read_otherwise_than_maniskill_does_is_the_machines_failure(
    track: Track, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = made(track.tasks[TASK])
    monkeypatch.setattr(state_module, "_AT_REST", np.ones(6, np.float32))
    with pytest.raises(ManiSkillFailed, match="failed in reset at env step 0: ValueError: expected the state that get"):
        fresh.reset(options=track.tasks[TASK].episodes[0].options)


@pytest.mark.parametrize("mode", ["rgb", "rgbd", "pointcloud"])
def test_pictures_reach_the_policy_as_the_rules_list_them_and_change_no_state(
    track: Track, env: ManiSkillEnv, tmp_path: Path, mode: str
) -> None:
    listed = yaml.safe_load(TRACK_FILE.replace("obs_mode: state", f"obs_mode: {mode}"))["tasks"][TASK]
    task = Task(**listed | {"episode_list": track.tasks[TASK].episode_list})
    try:
        seen = made(task)
    except ManiSkillMissing as missing:
        pytest.skip(str(missing))
    with PolicySession(folder_with(tmp_path / "Cubes", LOOKS)) as session:
        record = run_episode(env=seen, task=task, episode=task.episodes[0], open_session=lambda: session)
    assert (record.failure, record.outcome, record.picture) == (None, EpisodeOutcome.STEPS, None)
    lines = record.output.splitlines()
    tables = sorted(task.observables, key=lambda row: row.name)
    assert [line.rpartition(" ")[0] for line in lines[-len(tables) :]] == [
        f"{row.name} {row.dtype} {'x'.join(map(str, row.shape))}" for row in tables
    ]
    drawn = [line for line in lines if line.startswith(("base_camera_rgb", "base_camera_depth", "pointcloud_"))]
    assert drawn
    assert all(line.endswith("True") for line in drawn), "a picture of one colour shows nothing"
    env.reset(options=task.episodes[0].options)
    hashes = [env.state_hash()]
    for action in record.actions.to_array():
        env.step(action)
        hashes.append(env.state_hash())
    assert tuple(hashes) == record.state_hashes


def test_what_is_loaded_is_kept_from_the_collection_at_each_reset_and_resets_take_no_more_memory(
    env: ManiSkillEnv, track: Track
) -> None:
    assert gc.get_freeze_count() > 100_000
    resident_mib = []
    for _ in range(2):
        for episode in track.tasks[TASK].episodes:
            env.reset(options=episode.options)
        status = Path("/proc/self/status").read_text()
        resident_mib.append(int(status.partition("VmRSS:")[2].split()[0]) / 1024)
    assert resident_mib[1] - resident_mib[0] < 20
