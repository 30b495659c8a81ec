from pathlib import Path

import pytest
from vitac.evaluator.agent.isolation.gpu import find_gpu
from vitac.evaluator.agent.verdicts import SandboxFailed

CACHE = """412 libs found in cache `/etc/ld.so.cache'
\tlibnvidia-ml.so.1 (libc6,x86-64) => /usr/lib/libnvidia-ml.so.1
\tlibcudart.so.12 (libc6,x86-64) => /usr/local/cuda/lib64/libcudart.so.12
\tlibcuda.so.1 (libc6,x86-64) => /usr/lib/libcuda.so.1
\tlibcuda.so.1 (libc6) => /usr/lib32/libcuda.so.1
\tlibc.so.6 (libc6,x86-64) => /usr/lib/libc.so.6
"""


def nodes(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).symlink_to("/dev/zero")
    return folder


def test_finds_the_nodes_and_the_drivers_own_libraries_of_64_bits(tmp_path: Path) -> None:
    gpu = find_gpu(nodes(tmp_path, "nvidia0", "nvidia1", "nvidiactl", "nvidia-uvm", "nvidia-caps", "tty"), CACHE)
    assert [node.name for node in gpu.devices] == ["nvidia-uvm", "nvidia0", "nvidia1", "nvidiactl"]
    assert list(gpu.libraries) == ["libnvidia-ml.so.1", "libcuda.so.1"]
    assert gpu.libraries["libcuda.so.1"] == Path("/usr/lib/libcuda.so.1").resolve()


@pytest.mark.parametrize(
    ("names", "cache", "missing"),
    [((), CACHE, "nvidia0"), (("nvidiactl",), CACHE, "nvidia0"), (("nvidia0",), "", "libcuda.so.1")],
)
def test_says_what_a_machine_lacks(tmp_path: Path, names: tuple[str, ...], cache: str, missing: str) -> None:
    with pytest.raises(SandboxFailed, match=rf"`needs: gpu`, but this machine has no \S*{missing}.*vitac worker --gpu"):
        find_gpu(nodes(tmp_path, *names), cache)
