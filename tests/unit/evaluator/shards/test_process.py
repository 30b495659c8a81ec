import os
import select
import subprocess
import sys
from pathlib import Path

import fake_shard_process
import pytest
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.shards import process as shard_process
from vitac.evaluator.shards.process import ShardOrder, ShardProcessFailed, running_shard
from vitac.evaluator.shards.result import ShardEnd, ShardResult

FAKE = (sys.executable, fake_shard_process.__file__)


@pytest.fixture(autouse=True)
def fake_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shard_process, "COMMAND", FAKE)


def order(behaviour: str, **changes: object) -> ShardOrder:
    fields = {"submission_dir": Path(behaviour), "track": "track_1", "task": "peg-insertion", "shard": 0}
    return ShardOrder.model_validate(fields | {"episodes": (1, 2, 3)} | changes)


def run(behaviour: str, **changes: object) -> tuple[ShardResult, list[EpisodeRecord]]:
    with running_shard(order(behaviour, **changes)) as process:
        records = list(process.records())
        return process.result, records


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_records_and_result_come_from_the_other_process() -> None:
    result, records = run("succeed")
    assert result.end is ShardEnd.COMPLETE
    assert sorted(record.episode for record in records) == [1, 2, 3]
    assert records[0].infos[-1]["end_reason"] == "success"
    assert "end_reason" in records[0].infos[0]


def test_order_is_carried_whole() -> None:
    result, records = run("succeed", shard=2, episodes=(61, 62, 63, 64), skip=(62,))
    assert (result.index, sorted(record.episode for record in records)) == (2, [61, 63, 64])


def test_failing_policy_is_a_result() -> None:
    result, records = run("cannot_load")
    assert (result.end, len(records)) == (ShardEnd.BROKEN, 1)


def test_nothing_printed_can_pass_for_an_answer(capfd: pytest.CaptureFixture[str]) -> None:
    result, records = run("print_much")
    assert (result.end, len(records)) == (ShardEnd.COMPLETE, 3)
    assert "forged" in capfd.readouterr().err


def test_fault_of_the_machine_is_told_by_name() -> None:
    with pytest.raises(ShardProcessFailed, match=r"SandboxFailed.*bwrap is missing"):
        run("break_sandbox")


def test_process_that_ends_early_is_a_fault_of_ours() -> None:
    with pytest.raises(ShardProcessFailed, match="exit code 3 and no result"):
        run("exit_early")


def test_kill_ends_a_policy_that_hangs() -> None:
    with running_shard(order("hang")) as process:
        process.kill()
        with pytest.raises(ShardProcessFailed, match="exit code -9"):
            list(process.records())


def test_leaving_the_block_ends_the_process() -> None:
    with running_shard(order("hang")) as process:
        pid = process.pid
        assert is_alive(pid)
    assert not is_alive(pid)


def test_process_dies_with_its_parent() -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(Path(fake_shard_process.__file__).parent)!r})\n"
        "from vitac.evaluator.shards import process as shard_process\n"
        f"shard_process.COMMAND = {FAKE!r}\n"
        f"order = shard_process.ShardOrder.model_validate_json({order('hang').model_dump_json()!r})\n"
        "process = shard_process.ShardProcess(order)\n"
        "print(process.pid, flush=True)\n"
        "list(process.records())\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = os.pidfd_open(int(parent.stdout.readline()))
        parent.kill()
    ended, _, _ = select.select([child], [], [], 30)
    os.close(child)
    assert ended, "the child outlived its parent"
