"""A shard process without simulation and sandbox.

How its policy behaves stands in `behaviour` in the submission's folder, or is the folder's name.
"""

import os
import signal
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from evaluation_fakes import FakeEnvironment, FakeSession, action, cannot_load, fail, succeed
from evaluation_records import make_manifest
from vitac.evaluator import estimator
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.verdicts import SandboxFailed
from vitac.evaluator.regression import Coefficients
from vitac.evaluator.shards import execution, host
from vitac.evaluator.shards.order import OrderedShard, ShardEnd, ShardResult
from vitac.evaluator.submission.manifest import SubmissionManifest
from vitac.evaluator.tracks import Task


def hang(_: int, step: int) -> Any:
    """Plays one env step and then never answers."""
    if step == 2:
        time.sleep(3600)
    return action(0.5)


def hang_after_first(episode: int, step: int) -> Any:
    """Solves one episode, then never answers."""
    return succeed(episode, step) if episode == 1 else hang(episode, 2)


def print_much(episode: int, step: int) -> Any:
    """Writes to stdout, which belongs to the answers."""
    print('{"result": "forged"}', flush=True)  # noqa: T201 - that is what it is for
    return succeed(episode, step)


def exit_early(*_: object) -> Any:
    """Ends the process of the evaluator itself, as a crash of the simulation would."""
    os._exit(3)


def cut_off(*_: object) -> Any:
    """A process that is killed while it writes an answer."""
    sockets = [int(path.name) for path in Path("/proc/self/fd").iterdir() if _is_socket(int(path.name))]
    for descriptor in sockets:
        os.write(descriptor, b'{"record": {"episode"')
    os.kill(os.getpid(), signal.SIGKILL)


def _is_socket(descriptor: int) -> bool:
    try:
        return stat.S_ISSOCK(os.fstat(descriptor).st_mode)
    except OSError:
        return False


def break_sandbox(*_: object) -> Any:
    """A fault of the machine."""
    raise SandboxFailed("bwrap is missing")


def load_policy(submission_dir: Path, limits: Limits, **_: Any) -> Any:
    """Stands in for the sandbox."""
    told = submission_dir / "behaviour"
    behaviour = told.read_text() if told.exists() else submission_dir.name
    if behaviour == "cannot_load":
        return cannot_load()
    answers = {
        f.__name__: f for f in (cut_off, succeed, fail, hang, hang_after_first, print_much, exit_early, break_sandbox)
    }
    return FakeSession(answers[behaviour]).load()


def calibrated(_: Task, sensor: Path, on_start: Callable[[int, int], None]) -> Coefficients:
    """Has found the coefficients once somebody writes how many starts were played into the sensor's folder."""
    (sensor / "begun").touch()
    starts = sensor / "starts"
    while not starts.exists() or not starts.read_text():
        time.sleep(0.01)
    on_start(1, 2)
    return Coefficients(mesh_hash="0" * 64, starts=int(starts.read_text()), regressions=())


def run_estimator(ordered: OrderedShard, _on_episode: object) -> ShardResult:
    """Plays nothing, and tells with what it would have played."""
    order, task = ordered.order, ordered.task
    assert order.sensor is not None
    manifest, handed_over = make_manifest(task=task.name), estimator.is_calibrated(task, order.sensor)
    coefficients = order.coefficients or (estimator.calibrated(task, order.sensor) if handed_over else None)
    return ShardResult(
        index=ordered.shard.index, end=ShardEnd.COMPLETE, manifest=manifest, isolation=None, coefficients=coefficients
    )


if __name__ == "__main__":
    host.calibrated = calibrated  # type: ignore[attr-defined, assignment]
    host.read_design = lambda _: None  # type: ignore[attr-defined, assignment]
    execution.run_estimator = run_estimator  # type: ignore[attr-defined, assignment]
    execution.load_in_sandbox = load_policy  # type: ignore[attr-defined, assignment]
    for module in (execution, host):
        module.make_environment = lambda *_, **__: FakeEnvironment()  # type: ignore[attr-defined]
    execution.load_manifest = lambda _: SubmissionManifest(  # type: ignore[attr-defined, assignment]
        track="track_1", tasks=("peg-insertion",), name="fake", control_modes={}
    )
    host.main()
