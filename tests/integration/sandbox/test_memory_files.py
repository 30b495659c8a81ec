"""What policies see of the system lies in memory: no name, no page and no number tells what was done before."""

import os
from pathlib import Path

import numpy as np
import pytest
from submissions import submission_folder
from vitac.evaluator.agent.isolation.memory_files import FileIsolation, memory_folder
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.agent.verdicts import SandboxFailed

OBSERVATION = {"x": np.zeros(1, dtype=np.float32)}
POLICY = """
import os, subprocess, time
from statistics import median

SALT = "{salt}"
NAMES = 150
GROUPS = 12
PLACES = ("/usr/lib", "/opt/vitac/packages/0", "/submission")


def middle(names):
    found = []
    for name in names:
        begun = time.perf_counter_ns()
        os.access(name, 0)
        found.append(time.perf_counter_ns() - begun)
    return median(found)


def count_cold(place):
    # Groups of names that nobody has looked up yet answer slower the first time where the kernel remembers names.
    cold = 0
    for group in range(GROUPS):
        names = [f"{{place}}/{{SALT}}{{group}}_{{number}}" for number in range(NAMES)]
        first = middle(names)
        cold += first > 1.8 * min(middle(names), middle(names))
    return cold


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        cold = max(count_cold(place) for place in PLACES)
        numbers = [os.stat(path).st_ino for path in ("/submission/policy.py", "/usr/bin/env", "/opt/vitac/agent.py")]
        ran = subprocess.run(["/usr/bin/env", "true"]).returncode == 0
        return [float(cold > GROUPS // 2), *map(float, numbers), float(ran)]
"""


def play(folder: Path, episodes: int) -> list[tuple[float, ...]]:
    with PolicySession(folder) as session:
        assert session.isolation.files is FileIsolation.MEMORY
        found = []
        for _ in range(episodes):
            with session.episode(task="any", action_shape=(5,)) as policy:
                found.append(tuple(policy.act(OBSERVATION).tolist()))
        return found


@pytest.mark.slow
def test_no_name_and_no_number_of_a_file_tells_of_earlier_episodes_and_sandboxes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VITAC_SANDBOX_FILES", "memory")
    folder = submission_folder(tmp_path / "mine", {"policy.py": POLICY.format(salt=os.urandom(6).hex())})
    found = [*play(folder, 4), *play(folder, 2)]
    other = submission_folder(tmp_path / "others", {"policy.py": POLICY.format(salt=os.urandom(6).hex())})
    play(other, 1)
    found += play(folder, 1)
    assert len(set(found)) == 1, "an episode saw something else than the one before it"
    assert (found[0][0], found[0][-1]) == (0.0, 1.0), "nothing is cold, and programs run"


def test_a_folder_that_is_not_in_memory_is_refused_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VITAC_SANDBOX_FILES", "memory")
    monkeypatch.setenv("VITAC_MEMORY_DIR", "/proc")
    folder = submission_folder(tmp_path / "mine", {"policy.py": POLICY.format(salt="")})
    with pytest.raises(SandboxFailed, match=r"/proc is on proc; name a folder on a tmpfs .* VITAC_MEMORY_DIR"):
        play(folder, 1)
    monkeypatch.setenv("VITAC_MEMORY_DIR", str(tmp_path / "missing"))
    with pytest.raises(SandboxFailed, match="is on nothing"):
        memory_folder()
    monkeypatch.setenv("VITAC_SANDBOX_FILES", "tape")
    with pytest.raises(SandboxFailed, match="Expected VITAC_SANDBOX_FILES to be memory or disk, got 'tape'"):
        play(folder, 1)
