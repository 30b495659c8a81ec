"""What this machine has for ManiSkill: a GPU for physics, a Vulkan driver for pictures, and how to do without one.

SAPIEN needs the driver to make a material, and ManiSkill makes materials also where it draws nothing.
"""

from functools import cache
from importlib import import_module
from typing import Any, Final

_WITH_MATERIALS: Final = (
    "sapien.pysapien.render",
    "sapien.render",
    "sapien.wrapper.renderer",
    "sapien.wrapper.urdf_loader",
    "mani_skill.utils.building._mjcf_loader",
)
"""Modules that have SAPIEN's class `RenderMaterial` under its name, in the versions of the catalogue."""


def has_cuda() -> bool:
    """Return whether torch finds a GPU to run physics on."""
    import torch

    return bool(torch.cuda.is_available())


@cache
def has_driver() -> bool:
    """Return whether SAPIEN finds a Vulkan driver; cached, as `replace_materials` replaces the class that is tried."""
    import sapien

    try:
        sapien.render.RenderMaterial()
    except RuntimeError:
        return False
    return True


class UndrawnMaterial:
    """A material that is never drawn; it only stores its values."""

    def __init__(self, **values: Any) -> None:
        self.__dict__.update(values)

    def set_base_color(self, value: Any) -> None:
        """Keep a colour."""
        self.base_color = value


def replace_materials() -> None:
    """Make SAPIEN and ManiSkill use `UndrawnMaterial`, which needs no driver, in this process from now on."""
    for name in _WITH_MATERIALS:
        vars(import_module(name))["RenderMaterial"] = UndrawnMaterial
