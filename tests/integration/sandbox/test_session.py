"""What a session promises to those who play episodes with it, on this machine's own isolation."""

import ctypes
import os
import resource
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from submissions import submission_folder
from vitac.evaluator.agent.isolation import cgroup
from vitac.evaluator.agent.isolation.cgroup import MemoryIsolation
from vitac.evaluator.agent.isolation.process_tree import descendants
from vitac.evaluator.agent.limits import MIB, Limits, StartTimes
from vitac.evaluator.agent.session import EpisodeIsolation, EpisodePolicy, PolicySession
from vitac.evaluator.agent.verdicts import PolicyFailed, SandboxFailed, VerdictCode
from worker_fakes import eventually

Make = Callable[..., Path]
OBSERVATION = {"x": np.arange(3, dtype=np.float32)}


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Make a submission out of the body of `act`, after code at the top of the module."""

    def make_submission(act: str, top: str = "", reset: str = "pass", name: str = "Track_1") -> Path:
        lines = [
            textwrap.dedent(top),
            "class Policy:",
            "    def reset(self, task):",
            textwrap.indent(textwrap.dedent(reset), " " * 8),
            "    def act(self, observation):",
            textwrap.indent(textwrap.dedent(act), " " * 8),
        ]
        return submission_folder(tmp_path / name, {"policy.py": "\n".join(lines)})

    return make_submission


def loaded_pid(session: PolicySession) -> int:
    """The process that holds the loaded policy, from outside."""
    assert session._loaded_process is not None
    return session._loaded_process.outside_pid


def act_once(session: PolicySession) -> list[float]:
    with session.episode(task="peg-insertion", action_shape=(3,)) as policy:
        return policy.act(OBSERVATION).tolist()  # type: ignore[no-any-return]


def play_one(folder: Path, **options: object) -> list[float]:
    with PolicySession(folder, **options) as session:  # type: ignore[arg-type]
        return act_once(session)


def test_policy_gets_the_observation_and_the_task(make: Make) -> None:
    folder = make("return observation['x'] + (self.task == 'peg-insertion')", reset="self.task = task")
    assert play_one(folder) == [1, 2, 3]


def test_collections_in_an_episode_leave_what_was_loaded_alone(make: Make) -> None:
    top = "import gc\nloaded = []\nloaded.append(loaded)"
    act = """
        in_sight = any(each is loaded for each in gc.get_objects())
        return [float(gc.get_freeze_count() > 1000), float(in_sight), float(gc.isenabled())]
    """
    assert play_one(make(act, top=top)) == [1, 0, 1]


def test_an_episode_begins_on_one_core_and_may_use_others(make: Make) -> None:
    act = """
        before = len(os.sched_getaffinity(0))
        os.sched_setaffinity(0, range(1024))
        return [cores, before, len(os.sched_getaffinity(0))]
    """
    cores = len(os.sched_getaffinity(0))
    assert play_one(make(act, top="import os\ncores = len(os.sched_getaffinity(0))")) == [cores, 1, cores]


def test_a_policy_says_what_it_believes_only_when_it_is_asked(make: Make) -> None:
    told = make("self.seen = observation['x']\nreturn [0, 0, 0]") / "policy.py"
    with PolicySession(told.parent) as session, session.episode(task="t", action_shape=(3,)) as policy:
        policy.act(OBSERVATION)
        assert policy.belief(3) is None, "it has no such method"
    told.write_text(told.read_text() + "\n    def belief(self):\n        return self.seen + 0.5\n")
    with PolicySession(told.parent) as session, session.episode(task="t", action_shape=(3,)) as policy:
        policy.act(OBSERVATION)
        believed = policy.belief(3)
        assert believed is not None
        assert believed.tolist() == [0.5, 1.5, 2.5]
        assert policy.act(OBSERVATION).tolist() == [0, 0, 0], "the episode goes on"
        with pytest.raises(PolicyFailed, match=r"Belief has shape \(3,\), expected \(4,\)"):
            policy.belief(4)
    told.write_text(told.read_text().replace("return self.seen + 0.5", "raise ValueError('unsure')"))
    with PolicySession(told.parent) as session, session.episode(task="t", action_shape=(3,)) as policy:
        policy.act(OBSERVATION)
        with pytest.raises(PolicyFailed, match=r"belief\(\) raised ValueError: unsure"):
            policy.belief(3)
        assert policy.act(OBSERVATION).tolist() == [0, 0, 0], "the episode goes on here, too"


@pytest.mark.parametrize("ends_with", ["return [0.0, 0.0, 0.0]", "raise ValueError('unsure')"])
def test_what_a_belief_costs_is_counted_for_no_limit(make: Make, ends_with: str) -> None:
    slow = make("return [0, 0, 0]") / "policy.py"
    busy = "while time.process_time() < begin + 0.4: pass"
    belief = f"        import time\n        begin = time.process_time()\n        {busy}\n        {ends_with}\n"
    slow.write_text(f"{slow.read_text()}\n    def belief(self):\n{belief}")
    with PolicySession(slow.parent) as session, session.episode(task="t", action_shape=(3,)) as policy:
        policy.act(OBSERVATION)
        before_s = policy.cpu_s
        with suppress(PolicyFailed):
            policy.belief(3)
        policy.act(OBSERVATION)
        assert policy.cpu_s - before_s < 0.4, "what the belief takes"


def test_observation_belongs_to_the_policy(make: Make) -> None:
    assert play_one(make("observation['x'] += 1\nreturn observation['x']")) == [1, 2, 3]


def test_observations_of_megabytes_pass(make: Make) -> None:
    picture = np.random.default_rng(1).integers(0, 255, (480, 640, 3, 2), dtype=np.uint8)
    folder = make("picture = observation['picture']\nreturn [picture.sum(), picture[5, 6, 1, 0], picture.ndim]")
    with (
        PolicySession(folder) as session,
        session.episode(task="peg-insertion", action_shape=(3,)) as policy,
    ):
        answer = policy.act({"picture": picture}).tolist()
    assert answer == [np.float32(picture.sum()), picture[5, 6, 1, 0], 4]


def test_entry_point_may_be_another_module_and_class(make: Make) -> None:
    folder = make("return [1, 2, 3]")
    (folder / "deep").mkdir()
    (folder / "deep" / "other.py").write_text("from policy import Policy as Base\nclass Mine(Base):\n    pass\n")
    assert play_one(folder, entry_point="deep.other:Mine") == [1, 2, 3]


def test_time_of_policy_and_channel_is_told_apart(make: Make) -> None:
    folder = make(
        "end = time.process_time() + 0.1\nwhile time.process_time() < end: pass\nreturn [0, 0, 0]", "import time"
    )
    with PolicySession(folder) as session, session.episode(task="t", action_shape=(3,)) as policy:
        policy.act(OBSERVATION)
        assert policy.cpu_s >= 0.1
        assert policy.channel_s > 0


def test_time_between_questions_counts_as_well(make: Make) -> None:
    """While the evaluator computes the next env step, a process that the policy has left computes on."""
    folder = make("return [0, 0, 0]", "import os", reset="if os.fork() == 0:\n    while True: pass")
    with (
        PolicySession(folder, limits=Limits(episode_cpu_s=0.2)) as session,
        session.episode(task="t", action_shape=(3,)) as policy,
        pytest.raises(PolicyFailed) as caught,
    ):
        act_slowly_until(policy, cpu_s=10)
    assert caught.value.verdict is VerdictCode.CPU_TIME


BUSY = "end = time.process_time() + 0.1\nwhile time.process_time() < end: pass\n"


@pytest.mark.parametrize(
    ("top", "act", "limits"),
    [
        ("", BUSY, Limits(shard_cpu_s=0.35)),
        ("", "time.sleep(0.1)\n", Limits(shard_wall_s=0.35)),
        (BUSY, "open('/tmp/left', 'w')\n", Limits(shard_cpu_s=0.35)),
    ],
    ids=["computing", "sleeping", "loading again and again"],
)
def test_time_of_all_episodes_together_is_limited(make: Make, top: str, act: str, limits: Limits) -> None:
    folder = make(f"{act}return [0, 0, 0]", f"import os, time\n{top}")
    with PolicySession(folder, limits=limits) as session, pytest.raises(PolicyFailed) as caught:
        act_in_episodes(session, 10)
    assert caught.value.verdict is VerdictCode.SHARD_TIME


def test_each_shard_has_that_time_for_itself(make: Make) -> None:
    folder = make(f"{BUSY}return [0, 0, 0]", "import os, time")
    with PolicySession(folder) as session:
        episode_s = max(measure_episode_s(session) for _ in range(3))
    with PolicySession(folder, limits=Limits(shard_cpu_s=4 * episode_s)) as session:
        for _ in range(3):
            session.begin_shard()
            act_in_episodes(session, 2)
        assert session.starts == 1
        with pytest.raises(PolicyFailed, match="of the shard together used more"):
            act_in_episodes(session, 40)


def measure_episode_s(session: PolicySession) -> float:
    """Return what an episode takes on this machine [s of CPU time], which busy cores make longer."""
    with session.episode(task="t", action_shape=(3,)) as policy:
        policy.act(OBSERVATION)
        return policy.cpu_s


def act_in_episodes(session: PolicySession, count: int) -> None:
    for _ in range(count):
        act_once(session)


def act_slowly_until(policy: EpisodePolicy, *, cpu_s: float) -> None:
    while policy.cpu_s < cpu_s:
        policy.act(OBSERVATION)
        time.sleep(0.01)


def test_hash_seed_is_fixed(make: Make) -> None:
    folder = make("return [hash('a') % 100003, hash(b'b') % 100003, 0]")
    assert play_one(folder) == play_one(folder)


def test_one_thread_is_asked_for(make: Make) -> None:
    folder = make(
        "return [float(os.environ[name + '_NUM_THREADS']) for name in ('OMP', 'OPENBLAS', 'MKL')]", "import os"
    )
    assert play_one(folder) == [1, 1, 1]


def test_loading_happens_once_for_all_episodes(make: Make) -> None:
    with PolicySession(make("return [0, 0, 0]")) as session:
        for _ in range(5):
            act_once(session)
        assert session.starts == 1


def test_a_policy_that_leaves_files_is_loaded_anew(make: Make) -> None:
    with PolicySession(make("open('/tmp/left', 'x')\nreturn [0, 0, 0]")) as session:
        for _ in range(2):
            assert act_once(session) == [0, 0, 0]
        assert session.starts == 2


def test_an_episodes_processes_end_with_it_also_where_no_other_episode_follows(make: Make) -> None:
    folder = make("return [os.posix_spawn('/bin/sleep', ['sleep', '1000'], {}), 0, 0]", top="import os")
    with PolicySession(folder) as session:
        first = act_once(session)
        assert session._sandbox is not None
        pids = {session._sandbox.first_pid, loaded_pid(session)}
        eventually(lambda: set(descendants(session._sandbox.first_pid)) <= pids)  # type: ignore[union-attr]
        assert act_once(session) == first, "also the child's id is the same"
        assert session.starts == 1


def test_a_session_may_end_before_it_has_cleared_up_after_an_episode(make: Make) -> None:
    with PolicySession(make("open('/tmp/left', 'w').close()\nreturn [0, 0, 0]")) as session:
        act_once(session)
        assert session.starts == 1, "what it left is found before the next episode"
    with session:
        assert act_once(session) == [0, 0, 0]
        assert session.starts == 2


def test_a_loaded_policy_that_dies_with_its_episode_is_loaded_anew(make: Make) -> None:
    with PolicySession(make("return [1, 2, 3]")) as session:
        with session.episode(task="t", action_shape=(3,)) as policy:
            assert policy.act(OBSERVATION).tolist() == [1, 2, 3]
            os.kill(loaded_pid(session), signal.SIGKILL)
        assert act_once(session) == [1, 2, 3]
        assert session.starts == 2


def test_a_failed_episode_leaves_the_next_as_it_is(make: Make) -> None:
    folder = make("self.n = getattr(self, 'n', 0) + 1\nif self.n == 2: raise ValueError\nreturn [self.n, 0, 0]")
    with PolicySession(folder) as session:
        for _ in range(2):
            first_actions: list[list[float]] = []
            with pytest.raises(PolicyFailed):
                act_into(first_actions, session, times=2)
            assert first_actions == [[1, 0, 0]]
        assert session.starts == 1


def act_into(actions: list[list[float]], session: PolicySession, *, times: int) -> None:
    with session.episode(task="t", action_shape=(3,)) as policy:
        for _ in range(times):
            actions.append(policy.act(OBSERVATION).tolist())


def test_an_episode_may_be_left_at_any_point(make: Make) -> None:
    class Stop(Exception):
        pass

    with PolicySession(make("return [0, 0, 0]")) as session:
        with pytest.raises(Stop), session.episode(task="t", action_shape=(3,)):
            raise Stop
        assert act_once(session) == [0, 0, 0]


def test_lazily_read_weights_work_in_every_episode(make: Make) -> None:
    """An open npz shares its position among all copies of the policy."""
    top = "import numpy as np, pathlib\nWEIGHTS = np.load(pathlib.Path(__file__).parent / 'w.npz')"
    folder = make("return [WEIGHTS['a'][1], WEIGHTS['b'][2], 0]", top)
    np.savez(folder / "w.npz", a=np.arange(1000.0), b=np.arange(1000.0))
    with PolicySession(folder) as session:
        assert [act_once(session) for _ in range(3)] == [[1, 2, 0]] * 3
        assert session.starts == 1


def test_mapped_weights_work(make: Make) -> None:
    top = "import numpy as np, pathlib\nWEIGHTS = np.load(pathlib.Path(__file__).parent / 'w.npy', mmap_mode='r')"
    folder = make("return WEIGHTS[:3]", top)
    np.save(folder / "w.npy", np.arange(1000.0))
    with PolicySession(folder) as session:
        assert [act_once(session) for _ in range(2)] == [[0, 1, 2]] * 2


def test_each_episode_waits_for_its_start_time(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr(StartTimes, "wait", lambda times: waits.append(times.period_s))
    with PolicySession(make("return [0, 0, 0]"), episode_period_s=0.25) as session:
        act_in_episodes(session, 2)
        assert session.isolation.episode_period_s == 0.25
    assert waits == [0.25, 0.25]


def test_times_of_temporary_folders_are_zero_so_that_every_change_shows(make: Make) -> None:
    folder = make("return [os.stat('/tmp').st_mtime_ns, os.stat('/dev/shm').st_mtime_ns, 0]", "import os")
    assert play_one(folder) == [0, 0, 0]


def test_pipes_of_python_work_without_those_of_the_kernel(make: Make) -> None:
    act = """
    here, there = multiprocessing.Pipe(duplex=False)
    there.send(5)
    read, write = os.pipe()
    os.write(write, b"abc")
    os.close(write)
    return [here.recv(), len(os.read(read, 10)), len(os.read(read, 10)) + os.get_inheritable(read)]
    """
    assert play_one(make(act, "import multiprocessing, os")) == [5, 3, 0]


def test_event_loops_and_pools_work_without_sockets(make: Make) -> None:
    top = """
import asyncio, multiprocessing
from concurrent.futures import ProcessPoolExecutor

async def add(number):
    await asyncio.sleep(0.001)
    return number + await asyncio.to_thread(int, number)

async def add_all():
    program = await asyncio.create_subprocess_exec("/usr/bin/echo", "hello", stdout=asyncio.subprocess.PIPE)
    said, _ = await program.communicate()
    return sum(await asyncio.gather(*map(add, range(4)))), len(said)

def refusal():
    try:
        multiprocessing.Pipe()
    except OSError as error:
        return "of one direction" in str(error)
"""
    act = """
    with ProcessPoolExecutor(2) as pool:
        squares = sum(pool.map(abs, [-1, -2]))
    return [*asyncio.run(add_all()), squares + 10 * refusal()]
    """
    assert play_one(make(act, top)) == [12, 6, 13]


def test_threads_and_locks_work_in_a_copy(make: Make) -> None:
    top = "import threading\nLOCK = threading.RLock()\nLOCK.acquire()\nthreading.Thread(target=int).start()"
    act = """
    answers = []
    with LOCK:
        threads = [threading.Thread(target=answers.append, args=(n,)) for n in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return sorted(answers)
    """
    assert play_one(make(act, top)) == [0, 1, 2]


def test_child_processes_work(make: Make) -> None:
    act = "import subprocess\nreturn [len(subprocess.run(['echo', 'hello'], capture_output=True).stdout), 0, 0]"
    assert play_one(make(act)) == [6, 0, 0]


def test_fresh_processes_answer_the_same(make: Make) -> None:
    folder = make("self.n = getattr(self, 'n', 0) + 1\nreturn [self.n, 0, 0]")
    with PolicySession(folder, episode_isolation=EpisodeIsolation.FRESH_PROCESS) as session:
        assert [act_once(session) for _ in range(3)] == [[1, 0, 0]] * 3
        assert session.starts == 3
        assert session.isolation.episodes is EpisodeIsolation.FRESH_PROCESS


@pytest.mark.parametrize(
    "act", ["os._exit(3)", "os.close(3)\nos.close(4)\nos.close(5)\ntime.sleep(60)", "time.sleep(60)"]
)
def test_fresh_processes_meet_verdicts_as_well(act: str, make: Make) -> None:
    folder = make(act, "import os, time")
    limits = Limits(action_wall_s=1.0)
    with PolicySession(folder, limits=limits, episode_isolation=EpisodeIsolation.FRESH_PROCESS) as session:
        for _ in range(2):
            with pytest.raises(PolicyFailed) as caught:
                act_once(session)
            assert caught.value.verdict in {VerdictCode.CRASHED, VerdictCode.PROTOCOL_VIOLATION, VerdictCode.WALL_TIME}


def test_failure_tells_the_team_what_was_printed(make: Make) -> None:
    folder = make("print('step one')\nraise ValueError('no idea')")
    with PolicySession(folder) as session, pytest.raises(PolicyFailed, match="no idea") as caught:
        act_once(session)
    assert "step one" in caught.value.output_tail
    assert "policy.py" in caught.value.output_tail


def test_output_of_an_episode_is_there_while_it_runs_and_safe_to_print(make: Make) -> None:
    folder = make("print('seen', observation['x'].shape, '\\x1b[2J')\nreturn [0, 0, 0]")
    with PolicySession(folder) as session:
        for _ in range(2):
            with session.episode(task="peg-insertion", action_shape=(3,)) as policy:
                policy.act(OBSERVATION)
                assert policy.output == "seen (3,) \N{REPLACEMENT CHARACTER}[2J\n"


def test_output_of_one_episode_is_not_shown_for_the_next(make: Make) -> None:
    act = "if self.again: raise ValueError\nprint('secret of the first')\nreturn [0, 0, 0]"
    folder = make(act, reset="self.again = task == 'again'")
    with PolicySession(folder) as session:
        act_once(session)
        with pytest.raises(PolicyFailed) as caught, session.episode(task="again", action_shape=(3,)) as policy:
            policy.act(OBSERVATION)
    assert "secret of the first" not in caught.value.output_tail


def test_two_sessions_do_not_meet(make: Make) -> None:
    first = make("return [0, 0, 0]", reset="open('/tmp/meet', 'w').close()", name="first")
    second = make("return [os.path.exists('/tmp/meet'), len(os.listdir('/tmp')), 0]", "import os", name="second")
    with (
        PolicySession(first) as one,
        PolicySession(second) as two,
        one.episode(task="t", action_shape=(3,)) as policy,
    ):
        policy.act(OBSERVATION)
        assert act_once(two) == [0, 0, 0]


def test_memory_of_many_processes_is_capped_without_control_groups(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cgroup, "create", lambda limits: None)
    act = """
    for _ in range(8):
        if os.fork() == 0:
            kept = bytearray(os.urandom(1 << 20)) * 60
            time.sleep(60)
    time.sleep(60)
    """
    with PolicySession(make(act, "import os, time"), limits=Limits(memory_bytes=300 * MIB)) as session:
        assert session.isolation.memory is MemoryIsolation.WATCHDOG
        with pytest.raises(PolicyFailed) as caught:
            act_once(session)
    assert caught.value.verdict is VerdictCode.OUT_OF_MEMORY


def test_time_of_children_that_have_ended_counts_without_control_groups(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cgroup, "create", lambda limits: None)
    act = """
    while True:
        child = os.fork()
        if child == 0:
            start = time.process_time()
            while time.process_time() - start < 0.05: pass
            os._exit(0)
        os.waitpid(child, 0)
    """
    limits = Limits(action_cpu_s=1.0, action_wall_s=60.0)
    with PolicySession(make(act, "import os, time"), limits=limits) as session:
        with pytest.raises(PolicyFailed) as caught:
            act_once(session)
        assert caught.value.verdict is VerdictCode.CPU_TIME


def test_too_many_processes_are_named_without_control_groups(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cgroup, "create", lambda limits: None)
    folder = make("while True:\n    if os.fork() == 0: time.sleep(60)", "import os, time")
    with PolicySession(folder) as session, pytest.raises(PolicyFailed) as caught:
        act_once(session)
    assert caught.value.verdict is VerdictCode.TOO_MANY_PROCESSES


def test_nothing_runs_without_bubblewrap(make: Make, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("VITAC_BWRAP", str(tmp_path / "none"))
    with pytest.raises(SandboxFailed, match="install bubblewrap"), PolicySession(make("return [0, 0, 0]")):
        pass


def test_a_bubblewrap_that_fails_is_our_fault(make: Make, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "bwrap"
    program.write_text("#!/bin/sh\necho bwrap: No permissions to create new namespace >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("VITAC_BWRAP", str(program))
    with (
        pytest.raises(SandboxFailed, match=r"No permissions to create new namespace.*vitac doctor"),
        PolicySession(make("return [0, 0, 0]")),
    ):
        pass


def name_of(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text().rstrip()
    except (FileNotFoundError, ProcessLookupError):  # it has just ended
        return ""


def test_a_sandbox_that_is_killed_while_the_policy_loads_is_not_the_policys_fault(make: Make) -> None:
    folder = make("return observation['x']", top="import time\ntime.sleep(20)")

    def kill_bubblewrap() -> None:
        while not (found := [pid for pid in descendants(os.getpid()) if name_of(pid) == "bwrap"]):
            time.sleep(0.01)
        time.sleep(0.5)
        os.kill(min(found), signal.SIGKILL)

    killer = threading.Thread(target=kill_bubblewrap)
    killer.start()
    with pytest.raises(SandboxFailed, match="by something outside it"):
        play_one(folder)
    killer.join()


@pytest.mark.skipif(os.geteuid() != 0, reason="only under root does the policy run as another user")
def test_a_folder_that_only_root_can_enter_is_refused(make: Make) -> None:
    folder = make("return [0, 0, 0]")
    folder.chmod(0o700)
    with pytest.raises(SandboxFailed, match="another user"), PolicySession(folder):
        pass


def test_isolation_is_told(make: Make) -> None:
    session = PolicySession(make("return [0, 0, 0]"))
    with pytest.raises(SandboxFailed, match="never started"):
        _ = session.isolation
    with session:
        assert session.isolation.user == ("root" if os.geteuid() == 0 else "user-namespace")


def test_nothing_stays_when_a_session_ends(make: Make) -> None:
    before = children_of(os.getpid())
    with PolicySession(make("if os.fork() == 0: time.sleep(60)\nreturn [0, 0, 0]", "import os, time")) as session:
        act_once(session)
    assert children_of(os.getpid()) <= before


def test_no_zombie_is_left_to_whoever_collects_orphans(make: Make) -> None:
    """As process 1 of a container, or below a subreaper, that may be nobody; RLIMIT_NPROC counts zombies."""
    before = children_of(os.getpid())
    collect_orphans(True)
    try:
        play_one(make("return [0, 0, 0]"))
        assert children_of(os.getpid()) <= before
    finally:
        collect_orphans(False)


def test_nothing_stays_when_the_evaluator_is_killed(make: Make) -> None:
    folder = make("return [0, 0, 0]", "import subprocess\nsubprocess.Popen(['sleep', '1234.5'])")
    code = (
        "import sys, time; from pathlib import Path; from vitac.evaluator.agent.session import PolicySession\n"
        "with PolicySession(Path(sys.argv[1])) as session, session.episode(task='t', action_shape=(3,)):\n"
        "    print(session._sandbox.first_pid, flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(folder)], stdout=subprocess.PIPE) as evaluator:
        assert evaluator.stdout is not None
        first_pid = int(evaluator.stdout.readline())
        assert Path(f"/proc/{first_pid}").exists()
        evaluator.send_signal(signal.SIGKILL)
    eventually(lambda: not Path(f"/proc/{first_pid}").exists())


@pytest.mark.slow
def test_two_hundred_seventy_episodes_lose_little(make: Make, record_property: Callable[[str, object], None]) -> None:
    """A bound so wide that only a lost order of magnitude breaks it; the figure itself is recorded."""
    observation = {
        "marker_flow": np.zeros((2, 2, 128, 2), dtype=np.float32),
        "relative_motion": np.zeros(4, dtype=np.float32),
    }
    started = time.perf_counter()
    with PolicySession(make("return [0, 0, 0]")) as session:
        for _ in range(270):
            with session.episode(task="t", action_shape=(3,)) as policy:
                play_steps(policy, observation)
        assert session.starts == 1
    record_property("seconds", time.perf_counter() - started)


def play_steps(policy: EpisodePolicy, observation: dict[str, NDArray[np.float32]]) -> None:
    for _ in range(8):
        policy.act(observation)


def collect_orphans(wanted: bool) -> None:
    """Make this process the parent of orphans below it, or no longer so."""
    assert ctypes.CDLL(None).prctl(36, int(wanted), 0, 0, 0) == 0


def children_of(pid: int) -> set[str]:
    return {child for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()}


def test_process_ids_repeat_on_this_machine(make: Make) -> None:
    """Where the kernel does not allow it, episodes still work, and the result says so."""
    with PolicySession(make("return [os.getpid(), os.getppid(), 0]", "import os")) as session:
        seen = [act_once(session) for _ in range(3)]
        assert (len({tuple(pids) for pids in seen}) == 1) is session.isolation.process_ids_repeat
        assert session.isolation.process_ids_repeat is can_set_process_ids()


OPEN_DESCRIPTORS = """
import os, sys
def is_open(descriptor):
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True
def last_open():
    return max(filter(is_open, range(1024)))
"""


def test_numbers_of_descriptors_do_not_say_what_the_evaluator_has_open(make: Make) -> None:
    folder = make("return [last_open(), os.open('/dev/null', os.O_RDONLY), len(str(sys.orig_argv))]", OPEN_DESCRIPTORS)
    played = []
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with ExitStack() as opened:
        opened.callback(resource.setrlimit, resource.RLIMIT_NOFILE, (soft, hard))
        resource.setrlimit(resource.RLIMIT_NOFILE, (4096, hard))
        for count in (0, 1100):
            for _ in range(count):
                opened.enter_context(Path(os.devnull).open())
            played.append(play_one(folder))
    assert played[0] == played[1] == [3, 4, played[0][2]]


def can_set_process_ids() -> bool:
    try:
        with Path("/proc/sys/kernel/ns_last_pid").open("w"):
            return True
    except OSError:
        return False


HIDES_ITS_OUTPUT = """
import os, socket
for descriptor in range(3, 1024):
    try:
        copy = os.dup(descriptor)
    except OSError:
        continue
    with socket.socket(fileno=copy) as found:
        for _ in range(200):
            try:
                socket.send_fds(found, [b"x"], [1], socket.MSG_DONTWAIT)
            except OSError:
                break
"""


def test_descriptors_on_their_way_to_us_do_not_keep_a_sandbox_alive(make: Make) -> None:
    with pytest.raises(PolicyFailed) as caught:
        play_one(make("return observation['x']", top=HIDES_ITS_OUTPUT))
    assert caught.value.verdict is VerdictCode.PROTOCOL_VIOLATION


DEEP = """
import os
home, depth = os.getcwd(), 20
os.chdir("/tmp")
for _ in range(depth):
    os.mkdir("y" * 255)
    os.chdir("y" * 255)
"""
REMOVED = """
kept = os.open(".", os.O_RDONLY)
for _ in range(depth):
    os.chdir("..")
    os.rmdir("y" * 255)
"""


@pytest.mark.parametrize("more", ["", REMOVED], ids=["deep folders", "a descriptor of a deep folder"])
def test_names_too_long_for_a_path_are_the_policys_fault(make: Make, more: str) -> None:
    with pytest.raises(PolicyFailed) as caught:
        play_one(make("return observation['x']", top=f"{DEEP}{more}\nos.chdir(home)"))
    assert caught.value.verdict is VerdictCode.SHARED_STATE


def test_the_next_shard_pays_for_the_loading_as_well(make: Make) -> None:
    folder = make("return [0, 0, 0]", f"import os, time\n{4 * BUSY}")
    with PolicySession(folder, limits=Limits(shard_cpu_s=0.3)) as session:
        session.begin_shard()
        with pytest.raises(PolicyFailed) as caught:
            act_once(session)
    assert caught.value.verdict is VerdictCode.SHARD_TIME
