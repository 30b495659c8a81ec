import subprocess
import sys
import threading
from pathlib import Path

import pytest
from evaluation_records import make_record
from vitac.evaluator import playback
from vitac.evaluator.playback import MakingBroke, PlaybackFailed, PlaybackOrder, making
from worker_fakes import eventually

ORDER = PlaybackOrder(track="track_1", record=make_record(), folder=Path("/nowhere"))


def answering(monkeypatch: pytest.MonkeyPatch, program: str) -> None:
    """Puts a program in the place of the process."""
    monkeypatch.setattr(playback, "COMMAND", (sys.executable, "-c", program))


def test_progress_comes_until_the_playback_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    answering(
        monkeypatch,
        'import sys, json; order = json.load(sys.stdin); steps = order["record"]["env_steps"]\n'
        'for step in range(steps + 1): print(json.dumps({"env_steps": step}))\n'
        'print(json.dumps({"is_made": True}))',
    )
    with making(ORDER) as running:
        assert list(running.played()) == [0, 1, 2, 3]


def test_a_refusal_is_told_in_its_own_words(monkeypatch: pytest.MonkeyPatch) -> None:
    answering(monkeypatch, 'print(\'{"error": "The state differs."}\')')
    with making(ORDER) as running, pytest.raises(PlaybackFailed, match=r"^The state differs\.$"):
        list(running.played())


@pytest.mark.parametrize(
    ("program", "told"),
    [("raise SystemExit(3)", "exit code 3 and no answer"), ("print('{\"env_st')", "in the middle of an answer")],
)
def test_a_process_that_ends_early_is_no_refusal(monkeypatch: pytest.MonkeyPatch, program: str, told: str) -> None:
    answering(monkeypatch, program)
    with making(ORDER) as running, pytest.raises(MakingBroke, match=told):
        list(running.played())


def test_a_process_that_cannot_be_started_is_no_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(playback, "COMMAND", ("/nowhere/python",))
    with pytest.raises(MakingBroke, match="could not be started"), making(ORDER):
        pytest.fail("it started")


def test_another_thread_can_end_it(monkeypatch: pytest.MonkeyPatch) -> None:
    answering(
        monkeypatch,
        "import sys; sys.stdin.read(); print('{\"env_steps\": 0}', flush=True); sys.stdin = None\n"
        "import signal; signal.pause()",
    )
    with making(ORDER) as running:
        steps = running.played()
        assert next(steps) == 0
        threading.Thread(target=running.kill).start()
        with pytest.raises(MakingBroke, match="exit code -9"):
            next(steps)


def test_it_has_ended_when_the_block_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    answering(monkeypatch, "import signal; signal.pause()")
    with making(ORDER) as running:
        pass
    assert running._process.poll() is not None


STARTER = f"""
import sys, threading
from pathlib import Path
from vitac.evaluator import playback

SLEEPS = "import time; from vitac.evaluator import playback; playback.serve = lambda *_: time.sleep(600); "
playback.COMMAND = (sys.executable, "-c", SLEEPS + "print('{{}}', flush=True); playback.main()")
with playback.making(playback.PlaybackOrder.model_validate_json({ORDER.model_dump_json()!r})) as running:
    running._process.stdout.readline()
    print(running._process.pid, flush=True)
    running._process.stdin.close()
    threading.Event().wait()
"""


def test_it_ends_with_its_worker_also_while_it_says_nothing() -> None:
    with subprocess.Popen([sys.executable, "-c", STARTER], stdout=subprocess.PIPE, text=True) as starter:
        assert starter.stdout is not None
        making_pid = int(starter.stdout.readline())
        eventually(lambda: state(making_pid) == "S")
        starter.kill()
    eventually(lambda: not Path(f"/proc/{making_pid}").exists() or state(making_pid) == "Z", limit_s=20.0)


def state(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][0]
