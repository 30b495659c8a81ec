import sys
import sysconfig
from pathlib import Path

import pytest
from vitac.evaluator.agent.isolation import packages

from .test_packages import install


def python_at(prefix: Path, monkeypatch: pytest.MonkeyPatch, folder: Path) -> packages.Interpreter:
    monkeypatch.setattr(sys, "base_prefix", str(prefix))
    monkeypatch.setattr(sys, "_base_executable", str(prefix / "bin" / "python3"), raising=False)
    monkeypatch.setattr(sysconfig, "get_path", lambda key: str(folder))
    return packages.find_interpreter()


def test_python_outside_usr_is_bound_to_a_neutral_place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    install(tmp_path, "numpy", "2.4.6", "numpy/__init__.py")
    found = python_at(tmp_path / "home" / "python", monkeypatch, tmp_path)
    assert found.executable == Path("/opt/vitac/python/bin/python3")
    assert found.library_folder == Path("/opt/vitac/python/lib")
    assert (tmp_path / "home" / "python", Path("/opt/vitac/python")) in found.read_only_binds
    inside = [found.executable, *found.packages, *found.masked, *(inside for _, inside in found.read_only_binds)]
    assert not [path for path in inside if path.is_relative_to(tmp_path)]


def test_python_below_usr_stays_where_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    install(tmp_path, "numpy", "2.4.6", "numpy/__init__.py")
    found = python_at(Path("/usr"), monkeypatch, tmp_path)
    assert found.executable.is_relative_to("/usr")
    assert found.library_folder is None
    assert [outside.name for outside, _ in found.read_only_binds] == ["numpy", "numpy-2.4.6.dist-info"]


def test_packages_installed_for_the_python_itself_are_masked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    prefix = tmp_path / "python"
    (prefix / "lib" / "python3.11" / "site-packages" / "torch").mkdir(parents=True)
    found = python_at(prefix, monkeypatch, prefix / "lib" / "python3.11" / "site-packages")
    assert Path("/opt/vitac/python/lib/python3.11/site-packages") in found.masked
