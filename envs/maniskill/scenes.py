"""Draws each scene once for the pages: `python -m vitac.envs.maniskill.scenes FOLDER [ID ...]`, with a Vulkan driver.

Every environment is drawn in a process of its own; one that cannot be drawn, or whose picture shows nothing, has none.
"""

import argparse
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import VitacError
from ..tasks.options import RNG_SEED
from .catalogue import catalogue
from .definition import PREFIX
from .env import ManiSkillEnv

WIDTH, HEIGHT = 480, 360
"""Size of a picture [px]."""
_LEAST_CONTRAST = 8.0
"""Standard deviation of the brightness [of 255] of a picture that shows something."""
_TIME_LIMIT_S = 300.0


class NothingDrawn(VitacError):
    """A picture shows nothing, as of a scene that was not drawn; it is not kept."""


def file_name(env_id: str) -> str:
    """Return the name of the picture of an environment, by ManiSkill's id."""
    return f"scene-{env_id}.jpg"


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the named environments, or all that can be tasks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("ids", nargs="*")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.one:
        write(_drawn(chosen.ids[0]), chosen.folder / file_name(chosen.ids[0]))
        return
    for env_id in chosen.ids or catalogue().environments:
        command = [sys.executable, "-P", "-m", __spec__.name, str(chosen.folder), env_id, "--one"]
        done = subprocess.run(  # noqa: S603 - our own interpreter and module
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=_TIME_LIMIT_S
        )
        sys.stderr.write(f"{env_id}: {'drawn' if done.returncode == 0 else done.stderr.strip().splitlines()[-1]}\n")


def write(picture: NDArray[np.uint8], file: Path) -> None:
    """Write a picture, shape [h, w, 3], cut and scaled to the size of all.

    Raises:
        NothingDrawn: it is of one colour, or nearly.
    """
    from PIL import Image, ImageOps

    contrast = float(picture.mean(axis=2).std())
    if contrast < _LEAST_CONTRAST:
        raise NothingDrawn(f"{file.name} has a contrast of {contrast:.1f}, expected at least {_LEAST_CONTRAST}.")
    ImageOps.fit(Image.fromarray(picture), (WIDTH, HEIGHT)).save(file, quality=70, optimize=True)


def _drawn(env_id: str) -> NDArray[np.uint8]:
    mode = next(iter(catalogue().environments[env_id].control_modes))
    env = ManiSkillEnv(PREFIX + env_id, max_steps=1, settings={"control_mode": mode}, draws=True)
    env.reset(options={RNG_SEED: 0})
    return env.picture()


if __name__ == "__main__":
    main()
