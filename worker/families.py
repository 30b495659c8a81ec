"""Families of environments that this machine can run: reported to the service, which gives the worker their shards."""

from vitac.envs.maniskill.abilities import abilities
from vitac.envs.tasks.definition import Family


def families_here() -> tuple[Family, ...]:
    """Return the families that have here what they need."""
    found = abilities()
    able = {
        Family.TACTILE: True,
        Family.MANISKILL: found.physics,
        Family.MANISKILL_PICTURES: found.physics and found.pictures,
        Family.MANISKILL_CUDA: found.physics and found.cuda and found.pictures,
    }
    return tuple(family for family in Family if able.get(family))
