import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.limiter import ConcurrencyLimiter, SignInLimiters, WindowLimiter, client_key

HOLDER = (
    "import sys, time; from pathlib import Path; from vitac.server.limiter import ConcurrencyLimiter, SignInLimiters\n"
    "with ConcurrencyLimiter(Path(sys.argv[1]), 1).one('a', 'things'): print('held', flush=True); time.sleep(600)"
)


def test_window_lets_so_many_through_per_key_and_opens_again(tmp_path: Path) -> None:
    now = [1000.0]
    limiter = WindowLimiter(tmp_path, limit=2, window_s=10.0, clock=lambda: now[0])
    limiter.note("a", "things")
    now[0] = 1004.0
    limiter.note("a", "things")
    limiter.note("b", "things")
    with pytest.raises(ServiceError) as refused:
        limiter.note("a", "things")
    assert (refused.value.code, refused.value.extras["retry_after_s"]) == (ProblemCode.TOO_MANY_REQUESTS, 6)
    now[0] = 1010.0
    limiter.note("a", "things")


def test_window_counts_for_all_processes_together(tmp_path: Path) -> None:
    one, other = (WindowLimiter(tmp_path / "folder", limit=1, window_s=3600.0) for _ in range(2))
    one.note("a", "things")
    with pytest.raises(ServiceError):
        other.note("a", "things")


def test_window_lets_so_many_through_of_many_at_once(tmp_path: Path) -> None:
    let_through = []

    def note() -> None:
        limiter = WindowLimiter(tmp_path, limit=5, window_s=3600.0)
        for _ in range(5):
            try:
                limiter.note("a", "things")
            except ServiceError:
                continue
            let_through.append(1)

    threads = [threading.Thread(target=note) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(let_through) == 5


def test_window_forgets_keys_without_recent_events(tmp_path: Path) -> None:
    now = [1000.0]
    limiter = WindowLimiter(tmp_path, limit=1, window_s=1.0, clock=lambda: now[0])
    for number in range(100):
        limiter.note(str(number), "things")
    now[0] = 1002.0
    limiter.note("new", "things")
    assert len(list(tmp_path.iterdir())) == 1


def test_window_survives_a_clock_that_was_set_back(tmp_path: Path) -> None:
    now = [1000.0]
    limiter = WindowLimiter(tmp_path, limit=1, window_s=10.0, clock=lambda: now[0])
    limiter.note("a", "things")
    now[0] = 500.0
    limiter.note("a", "things")


def test_concurrency_counts_what_runs_and_frees_it_after_errors(tmp_path: Path) -> None:
    limiter = ConcurrencyLimiter(tmp_path / "things", 1)
    with (
        limiter.one("a", "things"),
        limiter.one("b", "things"),
        pytest.raises(ServiceError, match="At most 1 things are possible"),
        limiter.one("a", "things"),
    ):
        pass
    with pytest.raises(ZeroDivisionError), limiter.one("a", "things"):
        _ = 1 / 0
    with limiter.one("a", "things"):
        pass


def test_concurrency_has_room_for_the_limit_and_no_more(tmp_path: Path) -> None:
    limiter = ConcurrencyLimiter(tmp_path / "things", 3)
    with limiter.one("a", "things"), limiter.one("a", "things"), limiter.one("a", "things"):
        with pytest.raises(ServiceError), limiter.one("a", "things"):
            pass
        with limiter.one("b", "things"):
            pass


def test_concurrency_counts_other_processes_until_they_are_killed(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "things"
    limiter = ConcurrencyLimiter(path, 1)
    with subprocess.Popen([sys.executable, "-c", HOLDER, str(path)], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(ServiceError), limiter.one("a", "things"):
            pass
        os.kill(holder.pid, signal.SIGKILL)
    with limiter.one("a", "things"):
        pass


@pytest.mark.parametrize(
    ("host", "key"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2::1", "2001:db8:1:2::/64"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("testclient", "testclient"),
        (None, "unknown"),
    ],
)
def test_a_client_cannot_change_its_key_within_its_own_network(host: str | None, key: str) -> None:
    assert client_key(host) == key


def test_who_guesses_a_password_is_refused_and_locks_nobody_out(tmp_path: Path) -> None:
    limiters = SignInLimiters(
        of_address=WindowLimiter(tmp_path / "addresses", limit=4, window_s=60.0),
        of_member=WindowLimiter(tmp_path / "members", limit=2, window_s=60.0),
        at_once=ConcurrencyLimiter(tmp_path / "passwords", 1),
    )
    assert [limiters.note(address, "ann") for address in ("here", "here")] == [0.0, 0.0]
    with pytest.raises(ServiceError, match="2 sign-in attempts as one member from one address"):
        limiters.note("here", "ann")
    assert limiters.note("elsewhere", "ann") > 0, "a member who is attacked is slowed down, not locked out"
    assert limiters.note("here", "ann", device="known") == 0.0
    assert limiters.note("here", "bob") == 0.0
    with pytest.raises(ServiceError, match="4 sign-in attempts from one address"):
        limiters.note("here", "cat")
    with limiters.place("here"), limiters.place("elsewhere"), limiters.place("here", device="known"):
        place = limiters.place("here")
        with pytest.raises(ServiceError, match="At most 1 passwords of one address"):
            place.__enter__()
