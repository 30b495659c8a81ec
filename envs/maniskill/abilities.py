"""What ManiSkill can do on this machine, asked of SAPIEN and torch in a process of its own.

Run as `python -m vitac.envs.maniskill.abilities`: loading both takes seconds, starts threads, and may end the process.
"""

import json
import subprocess
import sys
import warnings
from dataclasses import asdict, dataclass
from functools import cache

from .driver import has_cuda, has_driver
from .env import missing_packages

_TIME_LIMIT_S = 120.0


@dataclass(frozen=True, kw_only=True)
class Abilities:
    """What an environment may need.

    Attributes:
        physics: the packages are installed and can be loaded.
        pictures: there is a Vulkan driver.
        cuda: there is a GPU that torch can use.
    """

    physics: bool = False
    pictures: bool = False
    cuda: bool = False


@cache
def abilities() -> Abilities:
    """Return what ManiSkill can do here; nothing where the packages are missing or cannot be loaded."""
    if missing_packages():
        return Abilities()
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter and module
            [sys.executable, "-P", "-m", __spec__.name],
            stdin=subprocess.DEVNULL, capture_output=True, text=True, check=True, timeout=_TIME_LIMIT_S,
        )  # fmt: skip
        return Abilities(**json.loads(done.stdout.splitlines()[-1]))
    except (subprocess.SubprocessError, IndexError, TypeError, ValueError):  # the last three: not what `_found` says
        return Abilities()


def _found() -> Abilities:
    import mani_skill  # noqa: F401 - whether it can be loaded

    return Abilities(physics=True, pictures=has_driver(), cuda=has_cuda())


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    sys.stdout.write("\n" + json.dumps(asdict(_found())))
