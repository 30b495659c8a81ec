import sys

import pytest
from packaging.requirements import Requirement
from vitac.envs import extras
from vitac.envs.extras import install_command


@pytest.mark.parametrize(("extra", "package"), [("vision", "sapien"), ("show", "pillow"), ("maniskill", "mani-skill")])
def test_the_command_installs_the_packages_of_the_extra_into_this_python(extra: str, package: str) -> None:
    interpreter, *pip = install_command(extra).split()
    assert (interpreter, pip[:3]) == (sys.executable, ["-m", "pip", "install"])
    names = [Requirement(word.strip("'")).name for word in pip[3:]]
    assert package in names
    assert "pytest" not in names


def test_an_environment_of_uv_has_no_pip_and_a_path_may_have_spaces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    monkeypatch.setattr(sys, "executable", "/a home/bin/python")
    command = install_command("show")
    assert command.startswith("uv pip install --python '/a home/bin/python' ")
    assert "'pillow>=13'" in command
    assert "-m pip" not in command
