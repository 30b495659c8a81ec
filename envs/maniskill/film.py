"""An episode in pictures, by the camera that its environment has for people; `vitac show` and workers draw them."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .env import ManiSkillEnv, Observation

Picture = NDArray[np.uint8]
NextAction = Callable[[Observation, dict[str, Any]], NDArray[np.float32] | None]

MAX_PICTURES = 100
"""Maximum pictures of an animation; in a longer episode, some env steps are left out."""
ENV_STEP_MS, END_MS = 100, 2500
"""How long a picture of an animation is shown [ms]; an env step of most environments is 50 ms of simulated time."""
_LINE, _MARGIN = 1.9, 0.5
"""Height of a line of text and what is left free beside it, as parts of the font's size."""
_SMALLEST_PX = 12.0
"""Size of the font, however small the picture is."""
_COLUMNS = 80
"""Width of a picture in font sizes: longer titles are cut."""
_PAPER, _INK = (255, 255, 255), (32, 32, 32)


@dataclass(frozen=True, kw_only=True)
class FilmMoment:
    """An episode after its reset or after an env step.

    Attributes:
        env_step: number of the env step; 0 after the reset.
        total_reward: so far.
        end_reason: why the episode has ended; None while it is running.
    """

    env_step: int
    total_reward: float
    end_reason: str | None

    @property
    def sentence(self) -> str:
        """What is written below its picture."""
        ended = "" if self.end_reason is None else f", {self.end_reason.replace('_', ' ')}"
        return f"env step {self.env_step}, reward {self.total_reward:.3g}{ended}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """A moment and its picture, shape [h, w, 3]."""

    moment: FilmMoment
    picture: Picture


def play(env: ManiSkillEnv, *, options: Mapping[str, object], next_action: NextAction) -> Iterator[FilmMoment]:
    """Play an episode until it ends or no action comes.

    Whoever takes a moment finds the environment as it is then.

    Args:
        env: is reset here.
        options: of the reset.
        next_action: gives the action for an observation and the info with it, or None to stop.

    Raises:
        ManiSkillFailed: the environment raised an error.
    """
    observation, info = env.reset(options=options)
    env_step, total_reward = 0, 0.0
    while True:
        yield FilmMoment(env_step=env_step, total_reward=total_reward, end_reason=info["end_reason"])
        action = next_action(observation, info) if info["end_reason"] is None else None
        if action is None:
            return
        observation, reward, _, _, info = env.step(action)
        env_step, total_reward = env_step + 1, total_reward + reward


def shots(env: ManiSkillEnv, moments: Iterator[FilmMoment], is_wanted: Callable[[int], bool]) -> Iterator[Shot]:
    """Draw the moments after some env steps, and the last one.

    Args:
        env: made with `draws`; it is played by taking the moments.
        moments: of `play`.
        is_wanted: whether the moment after an env step is drawn; 0 is the reset.

    Raises:
        ManiSkillFailed: a picture could not be drawn.
    """
    moment, is_drawn = None, False
    for moment in moments:
        is_drawn = is_wanted(moment.env_step)
        if is_drawn:
            yield Shot(moment=moment, picture=env.picture())
    if moment is not None and not is_drawn:
        yield Shot(moment=moment, picture=env.picture())


def select_env_steps(max_steps: int) -> int:
    """Return how many env steps lie between two pictures, so that the longest episode has no more than it may."""
    return -(-max_steps // MAX_PICTURES)


def captioned(shot: Shot, title: str, width_px: int) -> Picture:
    """Return a picture scaled to a width, with a line above and what has happened below; shape [h, width_px, 3]."""
    from PIL import Image, ImageDraw, ImageFont

    height, width, _ = shot.picture.shape
    drawn = Image.fromarray(shot.picture).resize((width_px, round(height * width_px / width)))
    size = max(width_px / _COLUMNS * 1.6, _SMALLEST_PX)
    line, margin = round(size * _LINE), round(size * _MARGIN)
    sheet = Image.new("RGB", (width_px, drawn.height + 2 * line), _PAPER)
    sheet.paste(drawn, (0, line))
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size)
    for text, top in ((title, 0), (shot.moment.sentence, line + drawn.height)):
        draw.text((margin, top + line / 2), text[:_COLUMNS], fill=_INK, font=font, anchor="lm")
    return np.asarray(sheet)
