from pathlib import Path

import pytest
from vitac.evaluator.agent.isolation import packages
from vitac.evaluator.agent.isolation.packages import INSIDE_PACKAGES, find_packages
from vitac.evaluator.package_sets import PackageSet

BASE = (PackageSet.BASE,)


def install(folder: Path, name: str, version: str, *files: str) -> None:
    """Put a distribution into a folder of packages, as an installer does."""
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir()
    listed = [*files, f"{info.name}/METADATA", f"{info.name}/RECORD"]
    for path in listed:
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).touch()
    rows = [*(f"{path},sha256=x,1" for path in listed), "../../../bin/program,sha256=x,1"]
    (info / "RECORD").write_text("\n".join(rows) + "\n")


def shown(folder: Path) -> list[str]:
    binds = find_packages(BASE, (folder,)).binds
    assert all(inside == INSIDE_PACKAGES / "0" / outside.relative_to(folder) for outside, inside in binds)
    return [outside.relative_to(folder).as_posix() for outside, _ in binds]


@pytest.fixture(autouse=True)
def locked(monkeypatch: pytest.MonkeyPatch) -> None:
    locked = {"numpy": ("2.4.6",), "typing-extensions": ("4.16.0",), "parts-one": ("1",)}
    monkeypatch.setattr(packages, "locked_versions", lambda _: locked)


def test_packages_outside_the_set_are_not_mounted(tmp_path: Path) -> None:
    install(tmp_path, "numpy", "2.4.6", "numpy/__init__.py", "numpy.libs/blas.so")
    install(tmp_path, "ipython", "9.18.1", "IPython/__init__.py")
    (tmp_path / "left_behind.py").touch()
    assert shown(tmp_path) == ["numpy", "numpy-2.4.6.dist-info", "numpy.libs"]
    assert find_packages(BASE, (tmp_path,)).versions == {"numpy": "2.4.6"}


def test_a_folder_that_distributions_share_is_mounted_in_parts(tmp_path: Path) -> None:
    install(tmp_path, "parts-one", "1", "parts/one/a.py", "parts/one/b.py", "__pycache__/single.pyc", "single.py")
    install(tmp_path, "parts-two", "1", "parts/two/a.py", "__pycache__/other.pyc", "other.py")
    assert shown(tmp_path) == ["__pycache__/single.pyc", "parts/one", "parts_one-1.dist-info", "single.py"]


def test_a_start_file_of_a_package_is_not_mounted(tmp_path: Path) -> None:
    install(tmp_path, "numpy", "2.4.6", "numpy/__init__.py", "numpy.pth")
    assert "numpy.pth" not in shown(tmp_path)


def test_a_package_without_a_list_of_its_files_is_not_there(tmp_path: Path) -> None:
    install(tmp_path, "numpy", "2.4.6", "numpy/__init__.py")
    (tmp_path / "numpy-2.4.6.dist-info" / "RECORD").unlink()
    assert find_packages(BASE, (tmp_path,)).versions == {}


def test_another_installed_version_is_found_at_once(tmp_path: Path) -> None:
    install(tmp_path, "typing-extensions", "4.16.0", "typing_extensions.py")
    assert find_packages(BASE, (tmp_path,)).versions == {"typing-extensions": "4.16.0"}
    (tmp_path / "typing_extensions-4.16.0.dist-info").rename(tmp_path / "typing_extensions-4.17.0.dist-info")
    assert find_packages(BASE, (tmp_path,)).versions == {"typing-extensions": "4.17.0"}
