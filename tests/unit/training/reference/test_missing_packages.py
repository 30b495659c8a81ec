"""The challenge's method where its packages are missing."""

import sys
from importlib import import_module

import pytest
from vitac.errors import VitacError

MODULE = "vitac.training.reference.td3"


@pytest.mark.parametrize("package", ["torch", "stable_baselines3"])
def test_a_missing_package_is_named_with_how_to_install_it(monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    monkeypatch.delitem(sys.modules, MODULE, raising=False)
    if package != "torch":
        monkeypatch.setitem(sys.modules, "torch", sys)  # whatever is installed here
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(VitacError, match=rf"needs {package}, which is not installed.*pip install .*torch"):
        import_module(MODULE)
