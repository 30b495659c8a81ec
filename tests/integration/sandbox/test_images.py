"""Container images play in the sandbox: of a Python of their own, and of a program in C."""

import errno
import json
import os
import shutil
import subprocess
import sysconfig
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from images import (
    POLICY_FILE,
    Pack,
    as_is,
    config_bytes,
    docker_archive,
    gzipped,
    layer,
    oci_layout,
    python_layers,
    zstd,
)
from submissions import submission_folder
from vitac.cli.main import main
from vitac.evaluator.agent.isolation.gpu import find_gpu
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.agent.verdicts import PolicyFailed, SandboxFailed, VerdictCode
from vitac.evaluator.isolation_kinds import IsolationKind
from vitac.evaluator.submission.image import load_program, unpack_image

EXAMPLES = Path(__file__).parents[3] / "examples"
EPISODES = os.environ.get("VITAC_IMAGE_EPISODES", "1:3")
MANIFEST = (EXAMPLES / "image_in_python/submission.yaml").read_bytes()
PLAY = (EXAMPLES / "image_in_python/play.py").read_bytes()


def python_image(folder: Path, play: bytes, prefix: str = "usr/local", make: object = None, pack: Pack = as_is) -> Path:
    """Return an image that runs a program in a Python below a prefix."""
    own = layer({"app/play.py": play, "app/vitac_policy.py": POLICY_FILE, "submission.yaml": MANIFEST})
    layers = [*python_layers(prefix), own]
    # Debian's Python looks for packages elsewhere.
    packages = f"/{prefix}/lib/{Path(sysconfig.get_path('stdlib')).name}/site-packages"
    variables = [f"PATH=/{prefix}/bin", f"LD_LIBRARY_PATH=/{prefix}/lib", f"PYTHONPATH={packages}"]
    config = config_bytes(layers, ["python3", "play.py"], Env=variables)
    return saved(folder, (oci_layout if make == "oci" else docker_archive)(layers, config, pack))


def c_image(folder: Path) -> Path:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler (cc)")
    program = folder / "policy"
    source = EXAMPLES / "image_in_c"
    command = [compiler, "-O2", "-static", "-Wall", "-Werror", "-o", str(program), str(source / "policy.c"), "-lm"]
    subprocess.run(command, check=True)
    layers = [layer({"policy": program, "submission.yaml": source / "submission.yaml"})]
    return saved(folder, docker_archive(layers, config_bytes(layers, ["/policy"], WorkingDir="")))


def saved(folder: Path, data: bytes) -> Path:
    tar = folder / "image.tar"
    tar.write_bytes(data)
    return tar


def result_hash(submission: Path, report: Path) -> str:
    with pytest.raises(SystemExit) as caught:
        main(["evaluate", str(submission), "--episodes", EPISODES, "--workers", "1", "--json", str(report)])
    assert caught.value.code in {None, 0}
    found: Mapping[str, str] = json.loads(report.read_text())
    return found["result_hash"]


@pytest.mark.slow
@pytest.mark.usefixtures("shared_simulation")
def test_an_image_plays_as_the_same_policy_in_an_archive_does(tmp_path: Path) -> None:
    stand_in = "def serve(policy): ...\n"
    archive = submission_folder(
        tmp_path / "archive",
        {
            "submission.yaml": MANIFEST + b"entry_point: play:Policy\n",
            "play.py": PLAY.replace(b"class Policy:", b"class Policy:\n    def reset(self, task): ...\n"),
            "vitac_policy.py": stand_in,
        },
    )
    report = tmp_path / "report.json"
    expected = result_hash(archive, report)
    assert result_hash(python_image(tmp_path, PLAY, pack=gzipped), report) == expected
    assert result_hash(python_image(tmp_path, PLAY, "opt/conda/envs/policy", "oci", zstd), report) == expected
    assert result_hash(c_image(tmp_path), report) == expected


PROBE = b"""
import ctypes, json, os, subprocess, sys
from vitac_policy import serve

def refused(call, *arguments):
    try:
        call(*arguments)
    except OSError as error:
        return error.strerror
    return "allowed"

def open_disk():
    os.mknod("/tmp/disk", 0o60600, 2048)
    try:
        open("/tmp/disk", "rb").close()
    finally:
        os.unlink("/tmp/disk")

class Policy:
    def act(self, observation):
        libc = ctypes.CDLL(None, use_errno=True)
        print(json.dumps({
            "top": sorted(os.listdir("/")), "left": os.listdir("/tmp") + os.listdir("/dev/shm"), "pid": os.getpid(),
            "ours": os.path.exists("/opt/vitac"), "image": os.path.exists("/image"), "uid": os.getuid() == 0,
            "chroot": refused(os.chroot, "/tmp"), "write": refused(open, "/app/new", "w"),
            "disk": refused(open_disk), "setuid": refused(os.setuid, 0),
            "proc": os.listdir("/proc"), "fds": [fd for fd in range(64) if refused(os.fstat, fd) == "allowed"],
            "unshare": libc.unshare(0x10000000),
            "said": subprocess.check_output([sys.executable, "-c", "print(1+1)"]).decode(),
        }), flush=True)
        open("/tmp/left", "w").close()
        open("/dev/shm/left", "w").close()
        return [0.0]

serve(Policy())
"""


@pytest.mark.parametrize("kind", [IsolationKind.NAMESPACES, pytest.param(IsolationKind.VM, marks=pytest.mark.slow)])
def test_an_image_sees_nothing_but_its_own_files_and_each_episode_begins_anew(
    image_folder: Path, kind: IsolationKind
) -> None:
    if kind is IsolationKind.VM and (shutil.which("runsc") is None or os.geteuid() != 0):
        pytest.skip("isolation vm needs gVisor (runsc) and a control group")
    (image_folder / "root/app/play.py").write_bytes(PROBE)
    outputs = []
    with PolicySession(image_folder, image=load_program(image_folder), kind=kind) as session:
        for _ in range(2):
            with session.episode(task="probe", action_shape=(1,)) as policy:
                policy.act({"value": np.zeros(1, np.float32)})
                outputs.append(json.loads(policy.output))
        assert session.isolation.episodes == "fresh-process"
    assert outputs[0] == outputs[1]
    found = outputs[0]
    assert set(found["top"]) <= {"app", "dev", "lib", "lib64", "proc", "submission.yaml", "sys", "tmp", "usr"}
    assert (found["left"], found["ours"], found["image"], found["uid"], found["proc"]) == ([], False, False, False, [])
    assert found["fds"] == [0, 1, 2, 3]
    assert found["chroot"] == "Operation not permitted"
    # The user namespace of somebody who is not root has no user 0 that one could become.
    assert found["setuid"] == ("Operation not permitted" if os.geteuid() == 0 else "Invalid argument")
    assert found["disk"] != "allowed"
    assert found["write"] in {"Read-only file system", "Permission denied"}
    assert (found["unshare"], found["said"]) == (-1, "2\n")


@pytest.mark.parametrize(
    ("command", "process", "part"),
    [
        (["/missing"], {}, "exit code 127"),
        (["/app/notes"], {}, "exit code 127"),
        (["/policy"], {"WorkingDir": "/nowhere"}, "exit code 127"),
    ],
)
def test_a_command_that_cannot_run_is_named(
    tmp_path: Path, command: list[str], process: dict[str, str], part: str
) -> None:
    layers = [layer({"app/notes": b"no program", "submission.yaml": MANIFEST})]
    folder = unpack_image(
        saved(tmp_path, docker_archive(layers, config_bytes(layers, command, **process))), tmp_path / "unpacked"
    )
    with pytest.raises(PolicyFailed, match=part) as caught, PolicySession(folder, image=load_program(folder)):
        pass
    assert caught.value.verdict is VerdictCode.CRASHED
    assert f"The image's command '{command[0]}' cannot be run" in caught.value.output_tail


@pytest.mark.parametrize(
    ("line", "code", "part"),
    [
        (b"raise RuntimeError('no luck')", VerdictCode.CRASHED, "RuntimeError: no luck"),
        (b"return [float('nan')] * 3", VerdictCode.NON_FINITE_ACTION, "nan"),
        (b"return [0.0]", VerdictCode.BAD_ACTION_SHAPE, r"shape \(1,\), expected \(3,\)"),
        (b"os._exit(0)", VerdictCode.CRASHED, "exit code 0"),
        (b"os.write(3, b'junk' * 8)", VerdictCode.PROTOCOL_VIOLATION, "starts with"),
    ],
)
def test_a_failing_image_gets_the_verdict_of_any_policy(
    image_folder: Path, line: bytes, code: VerdictCode, part: str
) -> None:
    (image_folder / "root/app/play.py").write_bytes(
        b"import os\nfrom vitac_policy import serve\nclass Policy:\n    def act(self, observation):\n        "
        + line
        + b"\nserve(Policy())\n"
    )
    with (
        pytest.raises(PolicyFailed, match=part) as caught,
        PolicySession(image_folder, image=load_program(image_folder)) as session,
        session.episode(task="fail", action_shape=(3,)) as policy,
    ):
        policy.act({"value": np.zeros(1, np.float32)})
    assert caught.value.verdict is code


GPU_PROBE = b"""
import ctypes, fcntl, json, os
from vitac_policy import serve

def errno_of(call, *arguments):
    try:
        call(*arguments)
    except OSError as error:
        return error.errno

class Policy:
    def act(self, observation):
        print(json.dumps({
            "path": os.environ["LD_LIBRARY_PATH"].split(":")[0], "library": open("/dev/gpu/libcuda.so.1").read(),
            "node": open("/dev/nvidia0", "rb").read(4).hex(), "asked": errno_of(fcntl.ioctl, open("/dev/zero"), 0x4601),
            "left": sorted(os.listdir("/dev/gpu")), "pipe": ctypes.CDLL(None).pipe2((ctypes.c_int * 2)(), 0),
        }), flush=True)
        return [0.0]

serve(Policy())
"""


def test_an_image_that_needs_a_gpu_gets_nodes_and_driver_and_may_ask_it(image_folder: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    for node in ("nvidia0", "nvidiactl"):
        (tmp_path / node).symlink_to("/dev/zero")
    (tmp_path / "driver").write_text("the driver")
    gpu = find_gpu(tmp_path, f"\tlibcuda.so.1 (libc6,x86-64) => {tmp_path}/driver\n")
    (image_folder / "root/app/play.py").write_bytes(GPU_PROBE)
    program = replace(load_program(image_folder), gpu=gpu)
    with (
        PolicySession(image_folder, image=program) as session,
        session.episode(task="gpu", action_shape=(1,)) as policy,
    ):
        policy.act({"value": np.zeros(1, np.float32)})
        found = json.loads(policy.output)
    assert found == {
        "path": "/dev/gpu", "library": "the driver", "node": "00000000", "asked": errno.ENOTTY,
        "left": ["libcuda.so.1"], "pipe": 0,
    }  # fmt: skip


def test_cuda_begins_in_an_image_that_needs_a_gpu(image_folder: Path) -> None:
    try:
        gpu = find_gpu()
    except SandboxFailed as error:
        pytest.skip(str(error))
    (image_folder / "root/app/play.py").write_bytes(
        b"import ctypes\nfrom vitac_policy import serve\nclass Policy:\n    def act(self, observation):\n"
        b"        return [float(ctypes.CDLL('libcuda.so.1').cuInit(0))]\nserve(Policy())\n"
    )
    program = replace(load_program(image_folder), gpu=gpu)
    with (
        PolicySession(image_folder, image=program) as session,
        session.episode(task="gpu", action_shape=(1,)) as policy,
    ):
        assert policy.act({"value": np.zeros(1, np.float32)})[0] == 0.0


@pytest.fixture(scope="module")
def image_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("image")
    folder.chmod(0o755)
    folder.parent.chmod(0o755)
    return unpack_image(python_image(folder, PLAY), folder / "unpacked")
