import signal
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest
from vitac.evaluator.agent.isolation import cgroup
from vitac.evaluator.agent.isolation.cgroup import ControlGroup, MemoryIsolation
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.verdicts import SandboxFailed

LIMITS = Limits(memory_bytes=1000, processes=10)


def v2_tree(root: Path, *, controllers: str = "memory pids") -> Path:
    """A version 2 hierarchy in ordinary folders; files appear in a new group as the kernel would make them."""
    own = root / "user.slice" / "own"
    own.mkdir(parents=True)
    (root / "cgroup.controllers").write_text("cpu memory pids\n")
    (own / "cgroup.subtree_control").write_text(controllers)
    return own


def membership(folder: Path, text: str) -> Path:
    file = folder / "membership"
    file.write_text(text)
    return file


def group_with(folder: Path, kind: MemoryIsolation, files: dict[str, str]) -> ControlGroup:
    for name, text in files.items():
        (folder / name).write_text(text)
    return ControlGroup(isolation=kind, memory=folder, pids=folder, cpu=folder)


def test_version_2_is_used_where_it_is_delegated(tmp_path: Path) -> None:
    own = v2_tree(tmp_path)
    group = cgroup.create(LIMITS, root=tmp_path, membership=membership(tmp_path, "0::/user.slice/own\n"))
    assert group is not None
    assert group.isolation is MemoryIsolation.CGROUP_V2
    assert group.memory.parent == own
    assert group.folders == (group.memory,)
    group.remove()
    assert not group.memory.exists()


def test_siblings_are_made_where_the_parent_delegates(tmp_path: Path) -> None:
    """An evaluator that was moved into a leaf of its own makes groups beside that leaf."""
    own = v2_tree(tmp_path)
    leaf = own / "leaf"
    leaf.mkdir()
    group = cgroup.create(LIMITS, root=tmp_path, membership=membership(tmp_path, "0::/user.slice/own/leaf\n"))
    assert group is not None
    assert group.memory.parent == own


def test_version_1_has_a_folder_for_each_controller(tmp_path: Path) -> None:
    for controller in ("memory", "pids", "cpuacct"):
        (tmp_path / controller / "mine").mkdir(parents=True)
    text = "4:memory:/mine\n3:cpu,cpuacct:/mine\n2:pids:/mine\n0::/\n"
    group = cgroup.create(LIMITS, root=tmp_path, membership=membership(tmp_path, text))
    assert group is not None
    assert group.isolation is MemoryIsolation.CGROUP_V1
    assert [folder.parent.parent.name for folder in group.folders] == ["memory", "pids", "cpuacct"]


def test_there_is_none_where_nothing_is_delegated(tmp_path: Path) -> None:
    v2_tree(tmp_path, controllers="cpu")
    (tmp_path / "user.slice" / "own" / "cgroup.subtree_control").unlink()
    assert cgroup.create(LIMITS, root=tmp_path, membership=membership(tmp_path, "0::/user.slice/own\n")) is None


@pytest.mark.parametrize(
    ("files", "groups", "limit"),
    [
        ({"memory.max": "max"}, "0::/", None),
        ({"memory.max": "5000"}, "0::/", 5000),
        ({"a/b/memory.max": "max", "a/memory.max": "7000"}, "0::/a/b", 7000),
        ({"a/b/memory.max": "3000", "a/memory.max": "7000"}, "0::/a/b", 3000),
        ({"a/b/memory.max": "9000", "a/memory.max": "7000"}, "0::/a/b", 7000),
        ({"other/memory.max": "1"}, "0::/a/b", None),
        ({"memory.max": "5000"}, "0::/../../docker/4711", 5000),
        ({"memory/mine/memory.limit_in_bytes": "4000"}, "4:memory:/mine\n2:pids:/mine\n0::/", 4000),
        ({"memory/memory.limit_in_bytes": "4000"}, "4:memory:/docker/4711\n0::/", 4000),
        ({"memory/memory.limit_in_bytes": "9223372036854771712"}, "4:memory:/", 2**63 - 4096),
        ({"memory/memory.limit_in_bytes": "4000", "memory.max": "2000"}, "4:memory:/\n0::/", 2000),
        ({}, "", None),
    ],
)
def test_the_smallest_memory_limit_up_to_the_root_holds(
    tmp_path: Path, files: dict[str, str], groups: str, limit: int | None
) -> None:
    """As the kernel keeps it: a group cannot use more than any group around it may."""
    root = tmp_path / "cgroup"
    for name, content in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(content + "\n")
    assert cgroup.memory_limit_bytes(root=root, membership=membership(tmp_path, groups)) == limit


def test_the_memory_limit_of_this_process_can_be_read() -> None:
    limit = cgroup.memory_limit_bytes()
    assert limit is None or limit > 0


def test_limits_are_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    v2_tree(tmp_path)
    plain_mkdir = Path.mkdir

    def mkdir_as_the_kernel(self: Path, *args: object, **options: object) -> None:
        plain_mkdir(self)
        for name in ("memory.max", "memory.swap.max", "pids.max"):
            (self / name).touch()

    monkeypatch.setattr(Path, "mkdir", mkdir_as_the_kernel)
    group = cgroup.create(LIMITS, root=tmp_path, membership=membership(tmp_path, "0::/user.slice/own\n"))
    assert group is not None
    assert (group.memory / "memory.max").read_text() == "1000"
    assert (group.memory / "memory.swap.max").read_text() == "0"
    assert (group.pids / "pids.max").read_text() == str(10 + 3)


def test_reads_counters_of_version_2(tmp_path: Path) -> None:
    files = {
        "memory.events": "low 0\noom 3\noom_kill 2\n",
        "pids.events": "max 7\n",
        "cpu.stat": "usage_usec 1500000\n",
    }
    group = group_with(tmp_path, MemoryIsolation.CGROUP_V2, files)
    assert (group.out_of_memory_kills(), group.refused_forks(), group.cpu_s()) == (2, 7, 1.5)


def test_reads_counters_of_version_1(tmp_path: Path) -> None:
    files = {
        "memory.oom_control": "oom_kill_disable 0\noom_kill 4\n",
        "pids.events": "max 1\n",
        "cpuacct.usage": "2000000000",
    }
    group = group_with(tmp_path, MemoryIsolation.CGROUP_V1, files)
    assert (group.out_of_memory_kills(), group.refused_forks(), group.cpu_s()) == (4, 1, 2.0)


def test_counters_are_read_anew_and_closed_with_the_group(tmp_path: Path) -> None:
    folder = tmp_path / "group"
    folder.mkdir()
    group = group_with(folder, MemoryIsolation.CGROUP_V2, {"cpu.stat": "usage_usec 1000000\n"})
    assert group.cpu_s() == 1.0
    (folder / "cpu.stat").write_text("usage_usec 2500000\nuser_usec 1\n")
    assert group.cpu_s() == 2.5
    assert open_below(folder) == {"cpu.stat"}
    (folder / "cpu.stat").unlink()
    group.remove()
    assert open_below(folder) == set()
    with pytest.raises(FileNotFoundError):  # none is read from a file that the kernel has taken away
        group.cpu_s()


def open_below(folder: Path) -> set[str]:
    """Names of the files in a folder that this process has open, removed ones too."""
    targets = []
    for link in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):  # that of this very iteration
            targets.append(Path(str(link.readlink()).removesuffix(" (deleted)")))
    return {target.name for target in targets if target.parent == folder}


def test_groups_of_dead_evaluators_are_swept(tmp_path: Path) -> None:
    for name in ("vitac-4194305-1", "vitac-1-1", "other", "vitac-odd"):
        (tmp_path / name).mkdir()
    cgroup.sweep(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other", "vitac-1-1", "vitac-odd"]


def test_a_group_in_use_cannot_be_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cgroup, "_REMOVE_DEADLINE_S", 0.0)
    (tmp_path / "busy" / "child").mkdir(parents=True)
    folder = tmp_path / "busy"
    with pytest.raises(SandboxFailed, match="still runs"):
        ControlGroup(isolation=MemoryIsolation.CGROUP_V2, memory=folder, pids=folder, cpu=folder).remove()


def test_what_still_runs_in_a_dead_evaluators_group_is_killed(tmp_path: Path) -> None:
    group = tmp_path / "vitac-4194305-1"
    group.mkdir()
    with subprocess.Popen(["sleep", "600"]) as left:
        (group / "cgroup.procs").write_text(f"0\n{left.pid}\n")
        cgroup.sweep(tmp_path)
        assert left.wait(timeout=60) == -signal.SIGKILL
