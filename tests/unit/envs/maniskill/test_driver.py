"""What stands in for SAPIEN's materials where there is no Vulkan driver."""

import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from types import SimpleNamespace

import pytest
from vitac.envs.maniskill import driver

LEFT_OVER = """
import sys
from functools import cache
import mani_skill.envs, sapien
from vitac.envs.maniskill.driver import replace_materials
real = sapien.render.RenderMaterial
replace_materials()
print([name for name, module in list(sys.modules.items())
       if name.partition(".")[0] in {"sapien", "mani_skill"} and real in vars(module).values()])
"""


class NoDevice:
    def __init__(self) -> None:
        raise RuntimeError("failed to find a rendering device")


@pytest.fixture
def render(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Stands in for the modules that have SAPIEN's material, of a machine without a driver."""
    render = SimpleNamespace(RenderMaterial=NoDevice)
    monkeypatch.setitem(sys.modules, "sapien", SimpleNamespace(render=render))
    for name in driver._WITH_MATERIALS:
        monkeypatch.setitem(sys.modules, name, render)
    monkeypatch.setattr(driver, "has_driver", cache(driver.has_driver.__wrapped__))
    return render


def test_a_material_without_a_driver_takes_a_colour(render: SimpleNamespace) -> None:
    """PlugCharger-v1 and PullCubeTool-v1 give theirs one after making it."""
    driver.replace_materials()
    material = render.RenderMaterial(roughness=0.5)
    material.set_base_color([1, 0, 0, 1])
    assert (material.roughness, material.base_color) == (0.5, [1, 0, 0, 1])


def test_a_missing_driver_stays_missing_after_materials_were_replaced(render: SimpleNamespace) -> None:
    assert not driver.has_driver()
    driver.replace_materials()
    assert render.RenderMaterial().__dict__ == {}
    assert not driver.has_driver()


@pytest.mark.skipif(find_spec("mani_skill") is None, reason="the extra maniskill is not installed")
def test_no_module_of_the_installed_maniskill_keeps_the_real_material() -> None:
    done = subprocess.run([sys.executable, "-c", LEFT_OVER], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
