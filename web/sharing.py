"""The picture that a link to a submission is shown with elsewhere, and texts that cite it. Called by its pages."""

import io
import unicodedata
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import groupby
from math import ceil
from pathlib import Path

import fontpkg
from PIL import Image, ImageDraw, ImageFont
from vitac.server.errors import ServiceSettingsError
from vitac.server.views.submissions import EpisodeView, SubmissionView

WIDTH, HEIGHT = 1200, 630
"""Size of the picture [px] that sites which show links expect."""
MARGIN = 64
PAPER, INK, QUIET, LINE = "#fcfcfb", "#15191c", "#545e66", "#dde1e2"
ACCENT, BAND, BAD = "#0a6a66", "#b9dedb", "#b0401c"
COLOURS = 64
GRID = (664, 120, WIDTH - MARGIN, HEIGHT - 120)
"""Where the episodes are [px]: left, top, right, bottom."""
LARGEST_CELL = 40


def draw_preview(
    view: SubmissionView, track: str, episodes: Sequence[EpisodeView], font_file: Path | None = None
) -> bytes:
    """Return the picture of a complete submission, PNG: who, what, how well, and each episode as a cell.

    Args:
        view: the submission.
        track: title of its track.
        episodes: how they ended; nothing where single episodes are not shown.
        font_file: for what Noto Sans cannot write.
    """
    picture = Image.new("RGB", (WIDTH, HEIGHT), PAPER)
    draw = ImageDraw.Draw(picture)
    draw.rectangle((0, 0, WIDTH, 12), fill=ACCENT)
    width = (GRID[0] if episodes else WIDTH - MARGIN) - 2 * MARGIN + 24
    _write(draw, 64, f"ViTac Arena · {track}", 28, QUIET, WIDTH - 2 * MARGIN, font_file)
    _write(draw, 140, view.name, 52, INK, width, font_file)
    _write(draw, 214, view.team.name, 36, QUIET, width, font_file)
    _draw_rate(draw, view, width)
    _draw_episodes(draw, episodes)
    written = io.BytesIO()
    picture.quantize(COLOURS).save(written, "PNG", optimize=True)
    return written.getvalue()


def checked_font(font_file: Path | None) -> Path | None:
    """Return a font file that can be read.

    Raises:
        ServiceSettingsError: it is none.
    """
    if font_file is not None:
        try:
            _font(20, font_file)
        except OSError as error:
            raise ServiceSettingsError(f"VITAC_PREVIEW_FONT is {font_file}, expected a font file: {error}") from error
    return font_file


def _draw_rate(draw: ImageDraw.ImageDraw, view: SubmissionView, width: int) -> None:
    played, rank = view.evaluation.played, view.played_rank
    if played is None:
        return
    low, high = played.success_rate_interval
    _write(draw, 292, f"{100 * played.success_rate:.1f} %", 112, ACCENT, width)
    y, end = 448, MARGIN + width

    def across(rate: float) -> float:
        return MARGIN + rate * (end - MARGIN)

    draw.rounded_rectangle((MARGIN, y - 3, end, y + 3), 3, fill=LINE)
    draw.rounded_rectangle((across(low), y - 10, across(high), y + 10), 6, fill=BAND)
    x = across(played.success_rate)
    draw.ellipse((x - 13, y - 13, x + 13, y + 13), fill=ACCENT)
    _write(draw, 484, f"95 % interval {100 * low:.1f} to {100 * high:.1f} %", 28, QUIET, width)
    if rank is not None:
        board = f" in {played.tasks[0].replace('-', ' ')}" if len(played.tasks) == 1 else ""
        _write(draw, 530, f"Rank {rank.rank} of {rank.of}{board}", 28, INK, width)


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
    """Write a line, cut off where it is too wide."""
    files = (_noto_sans(),) if font_file is None else (_noto_sans(), font_file)
    plain = _plain(text)

    def length(of: str) -> float:
        return sum(draw.textlength(run, _font(size, file)) for run, file in _runs(of, files))

    if length(plain) > width:
        fitting = bisect_right(range(len(plain)), width, key=lambda count: ceil(length(f"{plain[:count]}…")))
        plain = f"{plain[: fitting - 1]}…"
    x, baseline = float(MARGIN), y + _font(size, files[0]).getmetrics()[0]
    for run, file in _runs(plain, files):
        draw.text((x, baseline), run, colour, _font(size, file), anchor="ls")
        x += draw.textlength(run, _font(size, file))


def _plain(text: str) -> str:
    """Return text with accents as parts of their letters, and without control and format characters."""
    joined = "".join(" " if character.isspace() else character for character in unicodedata.normalize("NFC", text))
    return "".join(character for character in joined if unicodedata.category(character) not in {"Cc", "Cf", "Cs"})


def _runs(text: str, files: Sequence[Path]) -> Iterator[tuple[str, Path]]:
    """Cut text into parts with a font each: the first that has all of it, else the first that has the character.

    Where none has it, the first font draws a box.
    """
    whole = [file for file in files if all(_can_write(character, file) for character in set(text))]
    if whole:
        yield text, whole[0]
        return

    def choose_font(character: str) -> Path:
        return next((file for file in files if _can_write(character, file)), files[0])

    for file, characters in groupby(text, choose_font):
        yield "".join(characters), file


@cache
def _font(size: int, file: Path) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(file, size)


@cache
def _noto_sans() -> Path:
    """Return the file of a font with Latin, also with accents, Greek and Cyrillic."""
    return Path(fontpkg.path("Noto Sans"))


@lru_cache(maxsize=4096)
def _can_write(character: str, file: Path) -> bool:
    """Return whether the font has a glyph for a character: those that it lacks all look alike."""
    font = _font(20, file)
    return character == " " or bytes(font.getmask(character)) != bytes(font.getmask("\uffff"))


_BIBTEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        **{character: f"\\{character}" for character in "{}%$&#_"},
    }
)
"""How characters are written that mean something to LaTeX."""


@dataclass(frozen=True, kw_only=True)
class Citation:
    """A result as it is cited.

    Attributes:
        plain: one sentence.
        bibtex: an entry of a BibTeX file.
    """

    plain: str
    bibtex: str


def cite(view: SubmissionView, track: str, address: str) -> Citation:
    """Return the texts that cite a complete submission.

    Args:
        view: the submission.
        track: title of its track.
        address: of its page.
    """
    evaluation, year = view.evaluation, view.submitted_at.year
    played = evaluation.played
    rate = f"Success rate {100 * played.success_rate:.1f} % in {', '.join(played.tasks)}, evaluator" if played else ""
    note = f"{rate or 'Evaluator'} {evaluation.evaluator_version}, result hash {evaluation.result_hash}"
    fields = {
        "title": f"{{{_escaped(view.name)}}}",
        "author": f"{{{_escaped(view.team.name)}}}",
        "year": str(year),
        "howpublished": _escaped(f"ViTac Arena, {track}"),
        "note": _escaped(note),
        "url": address,
    }
    lines = [f"  {name:<12} = {{{text}}}" for name, text in fields.items()]
    return Citation(
        plain=f"{view.team.name}. {view.name}. ViTac Arena, {track}, {year}. {note}. {address}",
        bibtex="\n".join([f"@misc{{vitac_{view.id.hex[:12]},", ",\n".join(lines), "}"]),
    )


def _escaped(text: str) -> str:
    return text.translate(_BIBTEX)
