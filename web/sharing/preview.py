"""The picture that a link to a submission is shown with elsewhere. Called by the pages of public submissions."""

from __future__ import annotations

import io
from functools import cache
from typing import TYPE_CHECKING

from PIL import Image, ImageDraw, ImageFont
from vitac.server.errors import SettingsError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from vitac.server.views.submissions import EpisodeView, SubmissionView

WIDTH, HEIGHT = 1200, 630
"""Of the picture [px], as sites that show links expect it."""
MARGIN = 64
PAPER, INK, QUIET, LINE = "#fcfcfb", "#15191c", "#545e66", "#dde1e2"
ACCENT, BAND, BAD = "#0a6a66", "#b9dedb", "#b0401c"
COLOURS = 64
GRID = (664, 120, WIDTH - MARGIN, HEIGHT - 120)
"""Where the episodes are [px]: left, top, right, bottom."""
LARGEST_CELL = 40


def draw_preview(
    found: SubmissionView, track: str, episodes: Sequence[EpisodeView], font_file: Path | None = None
) -> bytes:
    """Return the picture of a complete submission, PNG: who, what, how well, and each episode as a cell.

    Args:
        found: the submission.
        track: title of its track.
        episodes: how they ended; nothing where single episodes are not shown.
        font_file: for names that Pillow's own font cannot write.
    """
    picture = Image.new("RGB", (WIDTH, HEIGHT), PAPER)
    draw = ImageDraw.Draw(picture)
    draw.rectangle((0, 0, WIDTH, 12), fill=ACCENT)
    width = (GRID[0] if episodes else WIDTH - MARGIN) - 2 * MARGIN + 24
    _write(draw, 64, f"ViTac Arena · {track}", 28, QUIET, WIDTH - 2 * MARGIN)
    _write(draw, 140, found.name, 52, INK, width, font_file)
    _write(draw, 214, found.team.name, 36, QUIET, width, font_file)
    _draw_rate(draw, found, width)
    _draw_episodes(draw, episodes)
    written = io.BytesIO()
    picture.quantize(COLOURS).save(written, "PNG", optimize=True)
    return written.getvalue()


def checked_font(font_file: Path | None) -> Path | None:
    """Return a font file that can be read.

    Raises:
        SettingsError: it is none.
    """
    if font_file is not None:
        try:
            _font(20, font_file)
        except OSError as error:
            raise SettingsError(f"VITAC_PREVIEW_FONT is {font_file}, expected a font file: {error}") from error
    return font_file


def _draw_rate(draw: ImageDraw.ImageDraw, found: SubmissionView, width: int) -> None:
    evaluation = found.evaluation
    if evaluation.success_rate is None or evaluation.success_rate_interval is None:
        return
    low, high = evaluation.success_rate_interval
    _write(draw, 292, f"{100 * evaluation.success_rate:.1f} %", 112, ACCENT, width)
    y, end = 448, MARGIN + width

    def across(rate: float) -> float:
        return MARGIN + rate * (end - MARGIN)

    draw.rounded_rectangle((MARGIN, y - 3, end, y + 3), 3, fill=LINE)
    draw.rounded_rectangle((across(low), y - 10, across(high), y + 10), 6, fill=BAND)
    x = across(evaluation.success_rate)
    draw.ellipse((x - 13, y - 13, x + 13, y + 13), fill=ACCENT)
    _write(draw, 484, f"95 % interval {100 * low:.1f} to {100 * high:.1f} %", 28, QUIET, width)
    if found.rank is not None:
        _write(draw, 530, f"Rank {found.rank.rank} of {found.rank.of}", 28, INK, width)


def _draw_episodes(draw: ImageDraw.ImageDraw, episodes: Sequence[EpisodeView]) -> None:
    """Draw successes as discs and the others as squares, row by row, as large as the grid allows."""
    if not episodes:
        return
    left, top, right, bottom = GRID
    size = LARGEST_CELL
    while size > 2 and ((right - left) // size) * ((bottom - top) // size) < len(episodes):
        size -= 1
    columns = (right - left) // size
    for place, end in enumerate(episodes[: columns * ((bottom - top) // size)]):
        x, y = left + place % columns * size, top + place // columns * size
        cell = (x + 1, y + 1, x + size - 2, y + size - 2)
        if end.success:
            draw.ellipse(cell, fill=ACCENT)
        else:
            draw.rectangle(cell, fill=BAD)


def _write(
    draw: ImageDraw.ImageDraw, y: int, text: str, size: int, colour: str, width: int, font_file: Path | None = None
) -> None:
    """Write a line, cut off where it is too wide; left out where no font has all of its characters."""
    able = [file for file in dict.fromkeys((None, font_file)) if _can_write(text, file)]
    if not able:
        return
    font = _font(size, able[0])
    if draw.textlength(text, font) > width:
        while text and draw.textlength(f"{text}…", font) > width:
            text = text[:-1]
        text = f"{text}…"
    draw.text((MARGIN, y), text, colour, font)


@cache
def _font(size: int, file: Path | None) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return a font; without a file Pillow's own."""
    return ImageFont.load_default(size) if file is None else ImageFont.truetype(file, size)


def _can_write(text: str, file: Path | None) -> bool:
    """Return whether the font has a glyph for each character: the ones that it lacks all look alike."""
    font = _font(20, file)
    missing = bytes(font.getmask("\uffff"))
    return all(character == " " or bytes(font.getmask(character)) != missing for character in set(text))
