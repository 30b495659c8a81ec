import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from shared_simulation import SharedProcesses
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.regression import Coefficients
from vitac.evaluator.shards import process as shard_process
from vitac.evaluator.shards.host_process import HostProcess, ShardProcessFailed
from vitac.evaluator.shards.order import OnCalibration, ShardEnd, ShardOrder, ShardResult
from vitac.evaluator.shards.process import ShardProcess, ShardProcesses
from vitac.evaluator.tracks import load_track
from worker_fakes import eventually

pytestmark = pytest.mark.usefixtures("fake_command")


def order(behaviour: str, **changes: object) -> ShardOrder:
    fields = {"kind": "model", "submission": Path(behaviour), "track": "track_1", "task": "peg-insertion", "shard": 0}
    return ShardOrder.model_validate(fields | {"episodes": (1, 2, 3)} | changes)


@pytest.fixture
def processes(loaded_simulation: SharedProcesses) -> Iterator[ShardProcesses]:
    """Processes forked by the host of the test before, if that has left it alive: loading one takes most of a test."""
    with loaded_simulation:
        yield loaded_simulation


def run(processes: ShardProcesses, behaviour: str, **changes: object) -> tuple[ShardResult, list[EpisodeRecord]]:
    with processes.running_shard(order(behaviour, **changes)) as process:
        records = list(process.records())
        return process.result, records


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_records_and_result_come_from_the_other_process(processes: ShardProcesses) -> None:
    result, records = run(processes, "succeed")
    assert result.end is ShardEnd.COMPLETE
    assert sorted(record.episode for record in records) == [1, 2, 3]
    assert records[0].infos[-1]["end_reason"] == "success"
    assert "end_reason" in records[0].infos[0]


def test_order_is_carried_whole(processes: ShardProcesses) -> None:
    result, records = run(processes, "succeed", shard=2, episodes=(55, 56, 57, 58), skip=(56,))
    assert (result.index, sorted(record.episode for record in records)) == (2, [55, 57, 58])


def test_failing_policy_is_a_result(processes: ShardProcesses) -> None:
    result, records = run(processes, "cannot_load")
    assert (result.end, len(records)) == (ShardEnd.BROKEN, 1)


def test_nothing_printed_can_pass_for_an_answer(capfd: pytest.CaptureFixture[str]) -> None:
    with ShardProcesses() as processes:  # whose host writes where this test reads
        result, records = run(processes, "print_much")
    assert (result.end, len(records)) == (ShardEnd.COMPLETE, 3)
    assert "forged" in capfd.readouterr().err


def test_fault_of_the_machine_is_told_by_name(processes: ShardProcesses) -> None:
    with pytest.raises(ShardProcessFailed, match=r"SandboxFailed.*bwrap is missing"):
        run(processes, "break_sandbox")


def test_process_that_ends_early_is_a_fault_of_ours(processes: ShardProcesses) -> None:
    with pytest.raises(ShardProcessFailed, match="exit code 3 and no result"):
        run(processes, "exit_early")


def test_kill_ends_a_policy_that_hangs(processes: ShardProcesses) -> None:
    with processes.running_shard(order("hang")) as process:
        assert is_alive(process.pid)
        process.kill()
        with pytest.raises(ShardProcessFailed, match="exit code -9"):
            list(process.records())


def test_kill_before_the_process_is_forked_keeps_it_from_running(processes: ShardProcesses) -> None:
    with processes.running_shard(order("hang")) as process:
        process.kill()
        with pytest.raises(ShardProcessFailed):
            list(process.records())


def test_one_loaded_process_forks_all_shards(processes: ShardProcesses) -> None:
    parents = set()
    for _ in range(2):
        with processes.running_shard(order("hang")) as one, processes.running_shard(order("hang")) as other:
            assert one.pid != other.pid
            parents |= {parent_of(one.pid), parent_of(other.pid)}
    assert len(parents) == 1
    assert parents != {os.getpid()}


def test_shards_of_one_submission_share_a_process_and_its_loaded_policy(processes: ShardProcesses) -> None:
    pids, played = [], []
    for shard, episodes in ((0, (1, 2)), (1, (28, 29, 30)), (2, (55,))):
        with processes.running_shard(order("succeed", shard=shard, episodes=episodes)) as process:
            pids.append(process.pid)
            played += sorted(record.episode for record in process.records())
            assert process.result.index == shard
    assert len(set(pids)) == 1
    assert played == [1, 2, 28, 29, 30, 55]


@pytest.mark.parametrize(
    "changes", [{"submission": Path("other")}, {"assets_dir": Path("meshes")}, {"task": "lock-opening"}]
)
def test_orders_that_need_another_preparation_do_not_share_one(changes: dict[str, object]) -> None:
    assert order("succeed", **changes).preparation() != order("succeed").preparation()
    assert order("succeed", shard=3, skip=(1,), episodes=(81, 82)).preparation() == order("succeed").preparation()


@pytest.mark.parametrize(
    ("changes", "shares"),
    [
        ({}, True),
        ({"track": "maniskill", "task": "pick-cube"}, False),
        ({"track": "maniskill", "task": "push-t", "kind": "log"}, False),
        ({"track": "gone"}, True),
        ({"task": "gone"}, True),
    ],
)
def test_shards_of_maniskill_share_nothing_so_that_what_one_leaves_in_memory_ends_with_its_process(
    changes: dict[str, object], shares: bool
) -> None:
    first, second = (order("x", shard=shard, episodes=(shard + 1,), **changes).preparation() for shard in (0, 1))
    assert (first == second) is shares


def test_shards_of_sealed_lists_share_a_process_and_each_plays_the_list_of_its_own_secret(
    processes: ShardProcesses, tmp_path: Path
) -> None:
    """Workers write the secret to a new file for each shard."""
    pids: list[int] = []
    played = [load_track("track_1").tasks["peg-insertion"].episodes[0].offset]
    for name in ("1a", "2b", "2b"):
        secret = tmp_path / f"{len(pids)} {name}"
        secret.write_text(name * 32)
        with processes.running_shard(order("succeed", episodes=(1,), secret=secret)) as process:
            pids.append(process.pid)
            played += [record.initial_offset for record in process.records()]
    assert len(set(pids)) == 1
    public, first, second, second_again = played
    assert second == second_again
    assert len({public, first, second}) == 3


def test_process_of_another_submission_that_waits_is_ended(processes: ShardProcesses) -> None:
    with processes.running_shard(order("succeed")) as process:
        first = process.pid
        list(process.records())
    assert is_alive(first)
    with processes.running_shard(order("fail")) as process:
        assert process.pid != first
        assert not is_alive(first)
        assert len(list(process.records())) == 3


def test_process_that_waits_in_vain_ends_by_itself(processes: ShardProcesses, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shard_process, "IDLE_KEPT_S", 0.05)
    with processes.running_shard(order("succeed")) as process:
        ended = os.pidfd_open(process.pid)
        list(process.records())
    assert select.select([ended], [], [], 30)[0]
    os.close(ended)
    with processes.running_shard(order("succeed")) as process:
        assert len(list(process.records())) == 3


def test_process_that_does_not_end_by_itself_is_killed(
    processes: ShardProcesses, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shard_process, "CLOSING_LIMIT_S", 0.05)
    with processes.running_shard(order("succeed")) as process:
        stuck = process.pid
        list(process.records())
    os.kill(stuck, signal.SIGSTOP)
    with processes.running_shard(order("fail")) as process:
        assert not is_alive(stuck)


def test_shard_that_is_over_cannot_be_killed_with_the_process_of_the_next_one(processes: ShardProcesses) -> None:
    with processes.running_shard(order("succeed")) as over:
        list(over.records())
    with processes.running_shard(order("succeed", shard=1, episodes=(28,))) as process:
        over.kill()
        assert len(list(process.records())) == 1


def test_process_of_a_shard_that_was_not_read_to_its_end_is_not_used_again(processes: ShardProcesses) -> None:
    with processes.running_shard(order("succeed")) as process:
        first = process.pid
        next(process.records())
    assert not is_alive(first)
    with processes.running_shard(order("succeed")) as process:
        assert process.pid != first


def test_process_that_dies_while_it_waits_costs_no_shard(processes: ShardProcesses) -> None:
    with processes.running_shard(order("succeed")) as process:
        waiting = os.pidfd_open(process.pid)
        list(process.records())
    signal.pidfd_send_signal(waiting, signal.SIGKILL)
    assert select.select([waiting], [], [], 30)[0]
    os.close(waiting)
    with processes.running_shard(order("succeed")) as process:
        assert len(list(process.records())) == 3


def test_prepared_process_forks_the_first_shard() -> None:
    with ShardProcesses() as processes:
        processes.prepare()
        processes.prepare()
        assert processes._newest is not None
        with processes.running_shard(order("succeed")) as process:
            assert parent_of(process.pid) == processes._newest._process.pid
            assert len(list(process.records())) == 3


def test_shard_after_the_death_of_the_loaded_process_gets_a_new_one(processes: ShardProcesses) -> None:
    with processes.running_shard(order("hang")) as process:
        os.kill(parent_of(process.pid), signal.SIGKILL)
        with pytest.raises(ShardProcessFailed, match="exit code unknown"):
            list(process.records())
    with processes.running_shard(order("succeed")) as process:
        assert len(list(process.records())) == 3


def test_host_that_hangs_is_replaced_for_the_next_shard(processes: ShardProcesses) -> None:
    with processes.running_shard(order("hang")) as process:
        host = parent_of(process.pid)
        os.kill(host, signal.SIGSTOP)
        with processes.running_shard(order("succeed")) as stuck:
            stuck.kill()
            with pytest.raises(ShardProcessFailed, match="was not started"):
                list(stuck.records())
        with processes.running_shard(order("succeed")) as other:
            assert parent_of(other.pid) != host
            assert len(list(other.records())) == 3
        assert is_alive(process.pid)
    assert not is_alive(host)


def test_order_that_a_killed_host_has_not_read_is_a_fault_of_ours(processes: ShardProcesses) -> None:
    with processes.running_shard(order("hang")) as process:
        host = parent_of(process.pid)
        os.kill(host, signal.SIGSTOP)
        with processes.running_shard(order("succeed")) as unread:
            os.kill(host, signal.SIGKILL)
            with pytest.raises(ShardProcessFailed, match="was not started"):
                list(unread.records())


def test_shard_killed_in_the_middle_of_a_line_is_a_fault_of_ours(processes: ShardProcesses) -> None:
    with processes.running_shard(order("cut_off")) as process, pytest.raises(ShardProcessFailed, match="exit code -9"):
        list(process.records())


def test_order_without_sense_leaves_other_shards_alone(processes: ShardProcesses) -> None:
    with processes.running_shard(order("hang")) as process:
        wrong = order("succeed").model_copy(update={"shard": -1})
        with processes.running_shard(wrong) as refused, pytest.raises(ShardProcessFailed):
            list(refused.records())
        assert is_alive(process.pid)


def of_sensor(sensor: Path, task: str = "sensor-standard", shard: int = 0) -> ShardOrder:
    changes = {"track": "track_3", "task": task, "sensor": sensor, "shard": shard, "episodes": None}
    return order("succeed", **changes)


def test_while_a_sensor_is_calibrated_other_shards_run_and_its_own_wait(
    processes: ShardProcesses, tmp_path: Path
) -> None:
    """The shards of both runs of a sensor, and one of another sensor, which is calibrated at the same time."""
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    with ExitStack() as stack:
        waiting = [
            stack.enter_context(processes.running_shard(given))
            for given in (of_sensor(first), of_sensor(first, "sensor-blind"), of_sensor(second))
        ]
        with processes.running_shard(order("succeed")) as other:
            assert len(list(other.records())) == 3
        eventually((first / "begun").exists)
        eventually((second / "begun").exists)
        (first / "starts").write_text("1")
        played: list[tuple[int, int]] = []
        assert [starts_of(process, lambda *how_far: played.append(how_far)) for process in waiting[:2]] == [1, 1]
        assert played == [(1, 2)], "the first of both says how far their calibration is"
        assert sockets_of(waiting[0].pid) == sockets_of(waiting[1].pid) == 1
        (second / "starts").write_text("2")
        assert starts_of(waiting[2]) == 2
    (first / "begun").unlink()
    with processes.running_shard(order("succeed")), processes.running_shard(of_sensor(first, shard=1)) as later:
        assert starts_of(later) == 1
    assert not (first / "begun").exists()


def test_a_sensor_whose_coefficients_come_with_the_order_is_not_calibrated(
    processes: ShardProcesses, tmp_path: Path
) -> None:
    known = Coefficients(mesh_hash="0" * 64, starts=5, regressions=())
    with processes.running_shard(of_sensor(tmp_path).model_copy(update={"coefficients": known})) as process:
        assert starts_of(process) == 5
    assert not (tmp_path / "begun").exists()


def test_a_shard_that_is_ended_while_it_waits_for_its_calibration_leaves_the_host_to_the_others(
    processes: ShardProcesses, tmp_path: Path
) -> None:
    with processes.running_shard(order("succeed")) as process:
        host = parent_of(process.pid)
        list(process.records())
    with processes.running_shard(of_sensor(tmp_path)):
        eventually((tmp_path / "begun").exists)
    with processes.running_shard(order("fail")) as process:
        assert parent_of(process.pid) == host


def sockets_of(pid: int) -> int:
    """Each shard has its own only: another one's would hide that other's end from whoever waits for it."""
    links = [str(path.readlink()) for path in Path(f"/proc/{pid}/fd").iterdir()]
    return sum(link.startswith("socket:") for link in links)


def starts_of(process: ShardProcess, on_calibration: OnCalibration = lambda *_: None) -> int | None:
    """Of the calibration that a shard found in its process."""
    assert list(process.records(on_calibration)) == []
    coefficients = process.result.coefficients
    return None if coefficients is None else coefficients.starts


def test_shards_of_a_sensor_whose_calibration_failed_are_left_to_themselves(
    processes: ShardProcesses, tmp_path: Path
) -> None:
    (tmp_path / "starts").write_text("not a number")
    for shard in (0, 1):
        with processes.running_shard(of_sensor(tmp_path, shard=shard)) as process:
            assert starts_of(process) is None
    with processes.running_shard(order("succeed")) as other:
        assert len(list(other.records())) == 3


def test_leaving_the_block_of_all_ends_every_process() -> None:
    with ShardProcesses() as processes, processes.running_shard(order("hang")) as process:
        pids = [process.pid, parent_of(process.pid)]
    assert not any(map(is_alive, pids))


def test_leaving_the_block_ends_the_process(processes: ShardProcesses) -> None:
    with processes.running_shard(order("hang")) as process:
        pid = process.pid
        assert is_alive(pid)
    assert not is_alive(pid)


def test_process_dies_with_its_parent(fake_command: tuple[str, str]) -> None:
    code = (
        "from vitac.evaluator.shards import host_process, process as shard_process\n"
        "from vitac.evaluator.shards.order import ShardOrder\n"
        f"host_process.COMMAND = {fake_command!r}\n"
        f"order = ShardOrder.model_validate_json({order('hang').model_dump_json()!r})\n"
        "with shard_process.ShardProcesses() as processes, processes.running_shard(order) as process:\n"
        "    print(process.pid, flush=True)\n"
        "    list(process.records())\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = os.pidfd_open(int(parent.stdout.readline()))
        parent.kill()
    ended, _, _ = select.select([child], [], [], 30)
    os.close(child)
    assert ended, "the child outlived its parent"


def test_a_host_that_was_started_before_forks_the_first_shards(fake_command: tuple[str, str]) -> None:
    host = HostProcess(loads_all=True)
    with ShardProcesses(host) as processes, processes.running_shard(order("succeed")) as process:
        assert process.host is host
        assert len(list(process.records())) == 3
    assert not host.is_alive()
