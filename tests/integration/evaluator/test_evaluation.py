"""Evaluations with the real environment in the real sandbox; a few episodes each."""

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from vitac.errors import VitacError
from vitac.evaluator.agent.isolation import packages
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode
from vitac.evaluator.episodes.episode import make_environment, resimulate
from vitac.evaluator.episodes.records import EpisodeOutcome, result_hash
from vitac.evaluator.evaluation.local import LocalEvaluation, evaluate
from vitac.evaluator.logs.findings import VerificationResult
from vitac.evaluator.logs.log import LogHeader
from vitac.evaluator.logs.verification import verify
from vitac.evaluator.sensors.made import read_design
from vitac.evaluator.shards.order import ShardOrder
from vitac.evaluator.shards.process import ShardProcesses
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import find_task
from vitac.evaluator.tracks.sealed import new_secret, sealed_track

TRACK, TASK = find_task("peg-insertion")

NOTHING = """
import numpy as np
class Policy:
    def reset(self, task): pass
    def act(self, observation): return np.zeros(3, np.float32)
"""

DRIFT = """
import numpy as np
class Policy:
    def reset(self, task): self.step = 0
    def act(self, observation):
        self.step += 1
        flow = observation["marker_flow"]
        push = np.float32(0.1) * np.sign(flow[0, 1, :, 1].mean() - flow[0, 0, :, 1].mean())
        return np.array([push, -push, 0.05 * self.step], np.float32)
"""

LOOKS_FOR_THE_FILE = """
import os, sys
import numpy as np
class Policy:
    def reset(self, task): pass
    def act(self, observation):
        for folder in ("/", "/tmp", os.getcwd(), os.path.dirname("SEALED")):
            if os.path.isdir(folder) and "secret" in os.listdir(folder):
                raise RuntimeError("found")
        if os.path.exists("SEALED") or any("SEALED" in text for text in (*sys.argv, *os.environ.values())):
            raise RuntimeError("found")
        return np.zeros(3, np.float32)
"""

COUNTS_RESETS = DRIFT.replace(
    "def reset(self, task): self.step = 0",
    "resets = 0\n    def reset(self, task):\n        Policy.resets += 1\n        self.step = Policy.resets - 1",
)

BROKEN_AT_THIRD_STEP = DRIFT.replace(
    "self.step += 1", "self.step += 1\n        if self.step == 3: raise RuntimeError('third')"
)


def drifting(parent: Path) -> Path:
    folder = parent / "Track_1"
    folder.mkdir()
    parent.chmod(0o755)
    folder.chmod(0o755)
    (folder / "submission.yaml").write_text("{track: track_1, tasks: [peg-insertion], name: test}")
    (folder / "policy.py").write_text(DRIFT)
    return folder


@pytest.fixture
def submission(tmp_path: Path) -> Path:
    return drifting(tmp_path)


@pytest.fixture(scope="module")
def drifted(tmp_path_factory: pytest.TempPathFactory) -> LocalEvaluation:
    """An evaluation of the submission as it is, which loads the simulation itself, for all tests that look at one."""
    return run(drifting(tmp_path_factory.mktemp("drifted")))


def run(submission: Path, **options: Any) -> LocalEvaluation:
    return evaluate(submission_dir=submission, track=TRACK, task=TASK, **({"episodes": (1, 2, 31)} | options))


def test_hash_is_the_same_for_workers_order_and_resume(submission: Path, drifted: LocalEvaluation) -> None:
    one, two = drifted, run(submission, workers=2)
    assert one.result_hash == two.result_hash
    order = ShardOrder(
        kind=SubmissionKind.MODEL,
        submission=submission,
        track="track_1",
        task="peg-insertion",
        shard=0,
        episodes=(1, 2),
        skip=(1,),
        episode_period_s=0.125,
    )
    of_another = order.model_copy(update={"evaluator_version": "1+another"})
    with ShardProcesses() as processes:
        with processes.running_shard(order) as process:
            resumed = [one.records[0], *process.records(), one.records[2]]
            assert result_hash(process.result.manifest, resumed) == one.result_hash
            assert process.result.isolation is not None
            assert process.result.isolation.episode_period_s == 0.125
        with (
            processes.running_shard(of_another) as process,
            pytest.raises(VitacError, match="Expected evaluator 1\\+another, got 1"),
        ):
            list(process.records())


@pytest.mark.usefixtures("shared_simulation")
def test_a_sealed_list_is_played_from_its_secret_which_no_policy_can_find(
    submission: Path, tmp_path: Path, drifted: LocalEvaluation
) -> None:
    path = tmp_path / "secret"
    secret = new_secret(path)
    (submission / "policy.py").write_text(LOOKS_FOR_THE_FILE.replace("SEALED", str(path)))
    sealed = sealed_track(TRACK, secret)
    task = sealed.tasks[TASK.name]
    found = evaluate(submission_dir=submission, track=sealed, task=task, secret=path, episodes=(1, 2))
    assert found.failure is None
    assert [record.initial_offset for record in found.records] == [episode.offset for episode in task.episodes[:2]]
    assert found.manifest.list_seed == task.episode_list.list_seed
    assert found.manifest.task_hash == task.digest()
    first = {record.state_hashes[0] for record in found.records}
    assert first.isdisjoint(record.state_hashes[0] for record in drifted.records)


@pytest.mark.usefixtures("shared_simulation")
def test_policy_that_counts_resets_scores_like_its_honest_twin(submission: Path, drifted: LocalEvaluation) -> None:
    (submission / "policy.py").write_text(COUNTS_RESETS)
    counting = run(submission)
    assert [record.record_digest() for record in counting.records] == [
        record.record_digest() for record in drifted.records
    ]


def test_records_hold_what_the_policy_did_and_how_it_was_isolated(drifted: LocalEvaluation) -> None:
    record = drifted.records[0]
    assert drifted.isolation is not None
    assert record.outcome in (EpisodeOutcome.TACTILE, EpisodeOutcome.STEPS, EpisodeOutcome.SUCCESS)
    assert record.actions.to_array()[0, 2].item() == pytest.approx(0.05)
    assert set(record.infos[0]) >= {
        "steps",
        "surface_diff_m",
        "peg_relative_z_mm",
        "relative_motion_mm_deg",
        "end_reason",
    }
    assert record.timings.physics_s > 0
    assert record.timings.policy_s > 0


def test_recorded_actions_give_the_recorded_states_in_a_used_environment(drifted: LocalEvaluation) -> None:
    record = drifted.records[1]
    env = make_environment(TASK)
    resimulate(env, TASK.episodes[30], record.actions.to_array())
    played = resimulate(env, TASK.episodes[record.episode - 1], record.actions.to_array())
    assert played.state_hashes == record.state_hashes
    assert (played.infos, played.outcome) == (record.infos, record.outcome)


def test_log_of_an_evaluation_is_verified(drifted: LocalEvaluation) -> None:
    verification = verify(
        env=make_environment(TASK),
        track=TRACK,
        task=TASK,
        header=LogHeader(manifest=drifted.manifest),
        records=drifted.records,
        episodes=(1, 2, 31),
    )
    assert verification.verdict is VerificationResult.VERIFIED
    assert verification.score == drifted.score
    assert result_hash(verification.manifest, verification.records) == drifted.result_hash


@pytest.mark.usefixtures("shared_simulation")
def test_policy_that_fails_in_every_episode_ends_the_evaluation(submission: Path) -> None:
    (submission / "policy.py").write_text(BROKEN_AT_THIRD_STEP)
    evaluation = run(submission, episodes=(1, 2, 3, 4, 5))
    assert evaluation.failure is not None
    assert (evaluation.failure.code, evaluation.score, len(evaluation.records)) == (VerdictCode.CRASHED, None, 3)
    assert "RuntimeError: third" in evaluation.failure.output_tail
    assert {record.env_steps for record in evaluation.records} == {2}


@pytest.mark.usefixtures("shared_simulation")
def test_policy_that_cannot_be_imported_ends_the_evaluation_at_once(submission: Path) -> None:
    (submission / "policy.py").write_text("import a_module_that_nobody_has")
    evaluation = run(submission)
    assert evaluation.failure is not None
    assert evaluation.failure.code is VerdictCode.IMPORT_ERROR
    assert "a_module_that_nobody_has" in evaluation.failure.output_tail


@pytest.mark.usefixtures("shared_simulation")
def test_nothing_privileged_reaches_a_policy(submission: Path) -> None:
    keys = "\n        assert set(observation) == {'marker_flow', 'relative_motion'}, set(observation)\n"
    (submission / "policy.py").write_text(NOTHING.replace("observation): ", f"observation):{keys}        "))
    evaluation = run(submission, episodes=(1,))
    assert evaluation.failure is None
    assert evaluation.records[0].failure is None


@pytest.mark.usefixtures("shared_simulation")
def test_lock_opening_is_evaluated_and_its_log_verified(submission: Path, repository: Path) -> None:
    track, task = find_task("lock-opening")
    (submission / "submission.yaml").write_text("{track: track_1, tasks: [lock-opening], name: test}")
    example = repository / "examples" / "lock_opening_heuristic" / "Track_1" / "policy.py"
    (submission / "policy.py").write_text(example.read_text())
    evaluation = evaluate(submission_dir=submission, track=track, task=task, episodes=(1, 160))
    assert [record.outcome for record in evaluation.records] == [EpisodeOutcome.SUCCESS] * 2
    verification = verify(
        env=make_environment(task),
        track=track,
        task=task,
        header=LogHeader(manifest=evaluation.manifest),
        records=evaluation.records,
        episodes=(1, 160),
    )
    assert (verification.verdict, verification.score) == (VerificationResult.VERIFIED, evaluation.score)


@pytest.mark.slow
@pytest.mark.usefixtures("shared_simulation")
def test_sensor_of_a_team_is_played_in_every_shard_with_its_own_mesh_hash(
    submission: Path, repository: Path, drifted: LocalEvaluation
) -> None:
    dome = repository / "examples" / "track_3_dome" / "Track_3"
    first = run(submission, episodes=(1, 28), sensor=dome)
    again = run(submission, episodes=(1, 28), sensor=dome, workers=2)
    assert first.failure is None
    assert [record.episode for record in first.records] == [1, 28]
    assert first.result_hash == again.result_hash
    assert first.manifest.mesh_hash != drifted.manifest.mesh_hash
    assert first.manifest.mesh_hash == make_environment(TASK, sensor=read_design(dome)).mesh_hash()


@pytest.mark.usefixtures("shared_simulation")
def test_a_package_installed_beside_the_evaluator_is_not_there_for_policies_and_changes_no_hash(
    submission: Path, tmp_path: Path, drifted: LocalEvaluation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the documentation's packages are, which a service installs."""
    site = tmp_path / "site"
    info = site / "ipython-9.18.1.dist-info"
    info.mkdir(parents=True)
    (site / "IPython").mkdir()
    (site / "IPython" / "__init__.py").touch()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: ipython\nVersion: 9.18.1\n")
    (info / "RECORD").write_text("IPython/__init__.py,,\nipython-9.18.1.dist-info/METADATA,,\n")
    folders = packages.package_folders()
    monkeypatch.setattr(packages, "package_folders", lambda: (*folders, site))
    monkeypatch.setattr(sys, "path", [*sys.path, str(site)])
    assert find_spec("IPython") is not None
    assert "ipython" not in packages.installed_packages().versions
    with pytest.raises(PolicyFailed, match="ModuleNotFoundError"):
        import_in_sandbox(tmp_path, "IPython")
    import_in_sandbox(tmp_path, "numpy")
    again = run(submission)
    assert (again.result_hash, again.score) == (drifted.result_hash, drifted.score)


def import_in_sandbox(parent: Path, name: str) -> None:
    folder = parent / name
    folder.mkdir(mode=0o755)
    (folder / "policy.py").write_text(f"import {name}\n\nclass Policy: pass\n")
    with PolicySession(folder):
        pass
