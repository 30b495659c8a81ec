import os
import shutil
from pathlib import Path

import pytest
from vitac.evaluator.agent.isolation import bubblewrap
from vitac.evaluator.agent.isolation.bubblewrap import Descriptors, UserIsolation
from vitac.evaluator.agent.isolation.packages import Interpreter, find_interpreter
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.verdicts import SandboxFailed

WRITEABLE = ("/tmp", "/dev/shm")
DESCRIPTORS = Descriptors(seccomp=12, passwd=13, info=14)


@pytest.fixture(params=[0, 1000], ids=["root", "user"])
def as_user(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> UserIsolation:
    """Both command lines are looked at, whoever runs the test."""
    monkeypatch.setattr(os, "geteuid", lambda: request.param)
    return bubblewrap.current_user_isolation()


def command(tmp_path: Path, limits: Limits | None = None) -> list[str]:
    return bubblewrap.command(
        program=Path("/usr/bin/bwrap"),
        submission=tmp_path,
        interpreter=find_interpreter(),
        limits=limits or Limits(),
        uid=bubblewrap.choose_uid(),
        descriptors=DESCRIPTORS,
    )


def pairs(arguments: list[str], option: str) -> dict[str, str]:
    """The two values of each use of an option: {second: first}."""
    places = [index for index, argument in enumerate(arguments) if argument == option]
    return {arguments[place + 2]: arguments[place + 1] for place in places}


def test_no_namespace_is_shared(as_user: UserIsolation, tmp_path: Path) -> None:
    arguments = set(command(tmp_path))
    assert {"--unshare-ipc", "--unshare-pid", "--unshare-net", "--unshare-uts", "--clearenv"} <= arguments
    assert {"--die-with-parent", "--new-session", "--as-pid-1"} <= arguments


def test_root_drops_its_uid_and_has_no_user_namespace(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    arguments = command(tmp_path)
    assert "--unshare-user" not in arguments
    assert arguments[arguments.index("--") + 1] == "/usr/bin/setpriv"
    uid = int(arguments[arguments.index("--reuid") + 1])
    assert uid == int(arguments[arguments.index("--regid") + 1]) > 65535
    kept = {arguments[index + 1] for index, argument in enumerate(arguments) if argument == "--cap-add"}
    assert kept == {"CAP_SETUID", "CAP_SETGID"}


def test_user_is_nobody_in_a_namespace_that_makes_no_more(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    arguments = command(tmp_path)
    assert {"--unshare-user", "--disable-userns"} <= set(arguments)
    assert arguments[arguments.index("--uid") + 1] == "65534"
    assert "/usr/bin/setpriv" not in arguments


def test_under_root_each_sandbox_has_a_uid_that_does_not_follow_from_process_ids(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    uids = {bubblewrap.choose_uid() for _ in range(20)}
    assert len(uids) == 20
    assert min(uids) >= 10**9
    assert max(uids) < 2**31
    assert max(uids) - min(uids) > 64 * os.getpid()


def test_only_two_folders_are_writeable_and_both_are_sized(as_user: UserIsolation, tmp_path: Path) -> None:
    arguments = command(tmp_path, Limits(tmp_bytes=111, shm_bytes=222))
    assert "--bind" not in arguments
    assert "--dev-bind" not in arguments
    sizes = {arguments[index + 3]: arguments[index + 1] for index, word in enumerate(arguments) if word == "--size"}
    assert sizes == dict(zip(WRITEABLE, ("111", "222"), strict=True))
    writeable = {arguments[index + 1] for index, word in enumerate(arguments) if word == "--tmpfs"}
    made_read_only = {arguments[index + 1] for index, word in enumerate(arguments) if word == "--remount-ro"}
    assert writeable - made_read_only == set(WRITEABLE)
    assert {"/", "/dev", "/dev/pts"} <= made_read_only


def test_there_is_no_proc_and_no_sys(as_user: UserIsolation, tmp_path: Path) -> None:
    arguments = command(tmp_path)
    assert "--proc" not in arguments
    assert not [argument for argument in arguments if argument.startswith(("/proc", "/sys"))]


def test_submission_is_read_only_at_its_place(as_user: UserIsolation, tmp_path: Path) -> None:
    assert pairs(command(tmp_path), "--ro-bind")["/submission"] == str(tmp_path.resolve())


def test_environment_holds_nothing_of_ours(as_user: UserIsolation, tmp_path: Path) -> None:
    arguments = command(tmp_path)
    names = {arguments[index + 1] for index, argument in enumerate(arguments) if argument == "--setenv"}
    assert names - {"LD_LIBRARY_PATH"} == {
        *("HOME", "LANG", "PATH", "TMPDIR", "PYTHONHASHSEED"),
        *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS"),
    }


def test_limits_of_each_process_are_set(as_user: UserIsolation, tmp_path: Path) -> None:
    arguments = command(tmp_path, Limits(address_space_bytes=10, open_files=20, file_size_bytes=30, start_cpu_s=1.5))
    assert {"--as=10", "--nofile=20", "--fsize=30", "--core=0"} <= set(arguments)
    assert arguments[arguments.index("/submission", arguments.index("-u")) - 2 :][:1] == ["2"]


def test_evaluator_code_is_hidden_where_it_is_installed(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    interpreter = Interpreter(
        executable=Path("/usr/bin/python3"),
        packages=(Path("/opt/vitac/packages/0"),),
        library_folder=None,
        read_only_binds=((tmp_path, Path("/opt/vitac/packages/0")),),
        masked=(Path("/opt/vitac/packages/0/vitac"),),
    )
    arguments = bubblewrap.command(
        program=Path("/usr/bin/bwrap"),
        submission=tmp_path,
        interpreter=interpreter,
        limits=Limits(),
        uid=1,
        descriptors=DESCRIPTORS,
    )
    place = arguments.index("/opt/vitac/packages/0/vitac")
    assert arguments[place - 1 : place + 3] == ["--tmpfs", arguments[place], "--remount-ro", arguments[place]]


def test_named_program_is_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "bwrap"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("VITAC_BWRAP", str(program))
    assert bubblewrap.find_program() == program


def test_named_program_that_is_none_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("VITAC_BWRAP", str(tmp_path / "none"))
    with pytest.raises(SandboxFailed, match="is not a program"):
        bubblewrap.find_program()


def test_missing_bubblewrap_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("VITAC_BWRAP", raising=False)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(SandboxFailed, match=r"apt-get install bubblewrap.*vitac doctor"):
        bubblewrap.find_program()


def test_a_user_of_the_sandbox_has_a_name_and_nothing_more() -> None:
    assert bubblewrap.passwd_file(12345) == b"agent:x:12345:12345:agent:/tmp:/usr/sbin/nologin\n"


def test_a_tool_of_ours_has_no_more_rights_than_a_policy(as_user: UserIsolation, tmp_path: Path) -> None:
    program = tmp_path / "bwrap"
    program.write_text("")
    program.chmod(0o755)
    code, kernels, folder = tmp_path / "code" / "envs", tmp_path / "kernels", tmp_path / "sensor"
    tool = bubblewrap.Tool(module="vitac.tool", code=(code,), kernels=kernels, folder=folder)
    limits = Limits(start_cpu_s=7.5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("VITAC_BWRAP", str(program))
        found = bubblewrap.tool_command(
            tool, interpreter=find_interpreter(), limits=limits, uid=4711, seccomp=8, passwd=9
        )
    own = found[: found.index("--")]
    descriptors = Descriptors(seccomp=8, passwd=9, info=5)
    policy = bubblewrap.command(
        program=program,
        submission=folder,
        interpreter=find_interpreter(),
        limits=limits,
        uid=4711,
        descriptors=descriptors,
    )
    of_policy = policy[: policy.index("--")]
    for option in (
        "--unshare-net",
        "--unshare-pid",
        "--die-with-parent",
        "--clearenv",
        "--new-session",
        "--remount-ro",
    ):
        assert own.count(option) == of_policy.count(option), option
    writeable = [own[place + 1] for place, option in enumerate(own) if option in ("--bind", "--dev-bind")]
    assert writeable == []
    assert own[own.index("--seccomp") + 1] == "8"
    assert {str(code), str(folder.resolve())} <= {own[i + 1] for i, option in enumerate(own) if option == "--ro-bind"}
    assert own[own.index("--ro-bind-try", own.index(str(code))) + 1] == str(kernels), "it may be missing"
    assert "--cpu=8" in found, "whole seconds, rounded up"
    assert found[-4:] == ["-m", "vitac.tool", bubblewrap.INSIDE_SUBMISSION, bubblewrap.INSIDE_KERNELS]
    variables = {own[place + 1]: own[place + 2] for place, option in enumerate(own) if option == "--setenv"}
    assert variables["PYTHONPATH"].startswith(f"{bubblewrap.INSIDE_CODE}:")
    assert not [name for name in variables if name.startswith("VITAC_") and name != "VITAC_CACHE_DIR"]
