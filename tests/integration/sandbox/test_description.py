import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from vitac.evaluator.agent import description
from vitac.evaluator.agent.description import describe_sandbox
from vitac.evaluator.agent.isolation.packages import installed_packages
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.agent.verdicts import PolicyFailed, SandboxFailed


def test_the_sandbox_tells_what_a_policy_finds_in_it() -> None:
    found = describe_sandbox()
    assert found.python == ".".join(map(str, sys.version_info[:3]))
    assert set(found.threads.values()) == {"1"}
    assert found.cores >= 1
    assert "openblas" in found.blas
    for name in ("numpy", "pydantic"):
        assert found.packages[name] == version(name)
    assert found.packages.keys() == installed_packages().versions.keys()


def test_a_policy_imports_our_packages_and_no_others_of_the_machine(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    (tmp_path / "policy.py").write_text(
        "import sys\n\nclass Policy:\n"
        "    def reset(self, task): print(*sys.path, sep='\\n')\n"
        "    def act(self, o): return [0]"
    )
    with PolicySession(tmp_path) as session, session.episode(task="t", action_shape=(1,)) as policy:
        policy.act({"value": np.zeros(1, np.float32)})
        folders = policy.output.split()
    assert [folder for folder in folders if "packages" in folder] == [
        "/submission/site-packages",
        "/opt/vitac/packages/0",
    ]


@pytest.mark.parametrize("name", ["pytest", "fastapi", "vitac", "pip", "IPython"])
def test_what_is_installed_beside_the_evaluator_cannot_be_imported(tmp_path: Path, name: str) -> None:
    tmp_path.chmod(0o755)
    (tmp_path / "policy.py").write_text(f"import {name}")
    with pytest.raises(PolicyFailed, match="ModuleNotFoundError"), PolicySession(tmp_path):
        pass


@pytest.mark.parametrize("folder", ["/usr/lib/python3/dist-packages", "/opt/vitac/python/lib/python3.11/site-packages"])
def test_packages_of_the_machines_pythons_cannot_be_reached_by_their_path(tmp_path: Path, folder: str) -> None:
    tmp_path.chmod(0o755)
    (tmp_path / "policy.py").write_text(
        "import os\n\nclass Policy:\n"
        f"    def reset(self, task): print(os.listdir({folder!r}) if os.path.exists({folder!r}) else [])\n"
        "    def act(self, o): return [0]"
    )
    with PolicySession(tmp_path) as session, session.episode(task="t", action_shape=(1,)) as policy:
        policy.act({"value": np.zeros(1, np.float32)})
        assert policy.output == "[]\n"


def test_a_sandbox_that_tells_nonsense_is_a_fault_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(description, "_POLICY", "raise ValueError")
    with pytest.raises(SandboxFailed, match="could not be described"):
        describe_sandbox()
