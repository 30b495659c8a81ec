"""Sets of locked packages that policies may see; tracks declare them, sandboxes show them, workers compare them.

The versions stand in `package_sets.yaml`.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Final

from vitac.errors import VitacError

from .strict_model import StrictModel, read_yaml

FURTHER_SETS_VARIABLE: Final = "VITAC_POLICY_PACKAGES"
"""Names sets that policies of every track see here, with commas between them, such as `torch`."""
_LOCKED: Final = Path(__file__).with_name("package_sets.yaml")


class PackageSet(StrEnum):
    """What policies may see together."""

    BASE = "base"
    """What the evaluator itself needs; every policy sees it."""
    TORCH = "torch"
    """torch, and what it needs."""
    SB3 = "sb3"
    """Stable-Baselines3, of which models of the 2025 challenge are made; it needs torch."""


class UnknownPackageSet(VitacError):
    """VITAC_POLICY_PACKAGES names a set that does not exist; the message lists those that do."""


class _LockedSets(StrictModel):
    """Versions by package, for each set; more than one where the version of Python decides."""

    base: dict[str, tuple[str, ...]]
    torch: dict[str, tuple[str, ...]]
    sb3: dict[str, tuple[str, ...]]


def shown_sets(declared: Iterable[PackageSet] = ()) -> tuple[PackageSet, ...]:
    """Return the sets that a policy sees here: the base, those that its track declares, and those of the variable.

    Raises:
        UnknownPackageSet: the variable names another one.
    """
    named = [name.strip() for name in os.environ.get(FURTHER_SETS_VARIABLE, "").split(",") if name.strip()]
    for name in named:
        if name not in set(PackageSet):
            raise UnknownPackageSet(f"{FURTHER_SETS_VARIABLE} names {name!r}, expected {', '.join(PackageSet)}.")
    wanted = {PackageSet.BASE, *declared, *map(PackageSet, named)}
    return tuple(each for each in PackageSet if each in wanted)


def digest_of_packages(versions: Mapping[str, str]) -> str:
    """Return the SHA-256 [hex] of a list of packages."""
    return hashlib.sha256(json.dumps(dict(versions), sort_keys=True).encode()).hexdigest()


def package_differences(sets: Iterable[PackageSet], versions: Mapping[str, str]) -> tuple[str, ...]:
    """Return what differs from the locked versions, a phrase for each package; nothing where all is as locked.

    The build of a version (`2.13.0+cpu`) does not count.
    """
    differences = []
    for name, expected in locked_versions(sets).items():
        version = versions.get(name, "not installed")
        if version.partition("+")[0] not in expected:
            differences.append(f"{name} is {version}, expected {' or '.join(expected)}")
    return tuple(differences)


def locked_versions(sets: Iterable[PackageSet]) -> dict[str, tuple[str, ...]]:
    """Return the versions that are locked, by package; more than one where the version of Python decides."""
    locked = _read_locked()
    return {name: versions for each in sets for name, versions in getattr(locked, each).items()}


@cache
def _read_locked() -> _LockedSets:
    return read_yaml(_LockedSets, _LOCKED)
