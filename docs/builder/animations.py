"""Draws an episode of each environment for its page, by `vitac show`; the pictures are kept until the code changes."""

import io
import shutil
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from notebooks import kept_results
from PIL import Image
from sphinx.application import Sphinx
from sphinx.config import Config

KEPT = "generated/animations"
QUALITY = 60
"""Of WebP: with it all animations together have a few hundred kB."""
ENV_STEP_MS, END_MS = 500, 2500


@dataclass(frozen=True, kw_only=True)
class Shown:
    """An episode that stands for its environment.

    Attributes:
        task: whose list has it.
        episode: its number there.
        shows: what is seen, for those who do not see it.
    """

    task: str
    episode: int
    shows: str


SHOWN = {
    "ViTac/PegInsertion-v1": Shown(
        task="peg-insertion",
        episode=40,
        shows="A peg between two gels is moved over its hole and down, and leans on the edge; the gels shear, their "
        "colours show the stress, and the markers of both sensors move",
    ),
    "ViTac/LockOpening-v1": Shown(
        task="lock-opening",
        episode=5,
        shows="A key between two gels is pulled out of its lock until its teeth are below their slots, and lifted; the "
        "gels' colours show the stress, and the markers of both sensors move",
    ),
    "ViTac/FusionInsertion-v1": Shown(
        task="fusion-insertion",
        episode=2,
        shows="A hexagonal peg between two gels is moved over that of two holes which fits it, and inserted; colour "
        "and depth of the camera, and the markers of both sensors, follow",
    ),
}


def setup(app: Sphinx) -> dict[str, Any]:
    """Draw before the pages are written that show the pictures."""
    app.connect("config-inited", _draw)
    return {"parallel_read_safe": True}


def _draw(app: Sphinx, config: Config) -> None:
    from vitac.evaluator.version import evaluator_hash

    kept = Path(app.srcdir) / KEPT
    config.html_static_path = [*config.html_static_path, KEPT]
    draw(kept_results(kept, evaluator_hash()[:16]))


def draw(folder: Path) -> None:
    """Draw what the folder lacks: an animation and a still of each environment's episode.

    Raises:
        VitacError: `vitac show` failed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for env_id in SHOWN:
        if not all(path.exists() for path in files_of(env_id, folder)):
            _draw_episode(env_id, folder)


def files_of(env_id: str, folder: Path) -> tuple[Path, Path]:
    """Return where an environment's animation and still are."""
    task = SHOWN[env_id].task
    return folder / f"{task}.webp", folder / f"{task}-still.webp"


def _draw_episode(env_id: str, folder: Path) -> None:
    from vitac.cli.show.command import command as show

    shown = SHOWN[env_id]
    pictures = folder / shown.task
    shutil.rmtree(pictures, ignore_errors=True)
    with redirect_stdout(io.StringIO()):  # here, since a process of its own would load the simulation again
        show(shown.task, episode=shown.episode, every="env-step", width=640, out=pictures)
    write_animation(sorted(pictures.glob("*.png")), *files_of(env_id, folder))
    shutil.rmtree(pictures)


def write_animation(pictures: list[Path], animation: Path, still: Path) -> None:
    """Write pictures as an animation, and the last of them as a still; the animation last, when all is done."""
    images = [Image.open(picture).convert("RGB") for picture in pictures]
    images[-1].save(still, quality=QUALITY, method=4)
    durations_ms = [ENV_STEP_MS] * (len(images) - 1) + [END_MS]
    images[0].save(
        animation, save_all=True, append_images=images[1:], duration=durations_ms, loop=0, quality=QUALITY, method=4
    )


def element(env_id: str, folder: Path, *, above: str) -> str:
    """Return the HTML of an environment's animation, which stands still for those who prefer less motion.

    Args:
        env_id: id of the environment.
        folder: with the pictures.
        above: path from the page to the site's own folder.
    """
    animation, still = files_of(env_id, folder)
    with Image.open(animation) as image:
        width, height = image.size
    address = f"{above}/_static/{folder.name}"
    return (
        f'<picture><source media="(prefers-reduced-motion: reduce)" srcset="{address}/{still.name}">'
        f'<img src="{address}/{animation.name}" width="{width}" height="{height}" loading="lazy" '
        f'alt="{SHOWN[env_id].shows}."></picture>'
    )
