"""Names that people choose: how they are shown and compared, and how names that look alike are refused."""

import re
import unicodedata
from collections.abc import Iterable
from functools import lru_cache
from itertools import pairwise
from typing import Final

from .errors import ProblemCode, ServiceError

_INVISIBLE: Final = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0\U0001d159\U000e0100-\U000e01ef]"
)
"""Letters, marks and symbols that draw nothing. Controls, direction marks and spaces are no printable characters."""
MARKS_IN_A_ROW: Final = 3
"""Nonspacing marks on one letter; scripts that are written with marks need no more."""
_DIACRITICS: Final = re.compile("[\u0300-\u036f\u1ab0-\u1aff\u1dc0-\u1dff\u20d0-\u20ff\ufe20-\ufe2f]")
"""Marks that belong to no script of their own."""
_LATIN_FORM: Final = re.compile("LATIN (CAPITAL|SMALL|LETTER SMALL CAPITAL)(?: LETTER)? ([A-Z])(?: WITH .*)?")
"""Character names of Latin letters with a stroke, hook or tail, and of small capitals."""
_SAME_STROKES: Final = (("vv", "w"),)
"""What Unicode's table lacks."""
_I_BESIDE_CAPITALS: Final = re.compile("(?<![a-z])I(?![a-z])")
"""Beside small letters it may be read as an l."""
_RESERVED_STEMS: Final = (
    *("admin", "sysadmin", "superadmin", "moderator"),
    *("organizer", "organiser", "organizing", "organising"),
)
"""No word of a name begins with one."""
_SERVICE: Final = ("vitac arena",)
"""Part of no name."""
_RESERVED_NAMES: Final = ("system", "root")
_TITLES: Final = ("vitac", "judge", "judges", "jury", "staff", "support", "official", "officials", "committee")
"""A name has further words besides these, numbers and the next ones."""
_FILLING_WORDS: Final = ("the", "of", "team", "member", "members", "arena")


def clean(name: str, *, what: str, min_length: int, max_length: int) -> str:
    """Return a name as it is shown: compatibility forms composed (NFKC), single spaces.

    Raises:
        ServiceError: too short or long, or with characters that do not print or draw nothing.
    """
    shown = " ".join(unicodedata.normalize("NFKC", name).split())
    if not min_length <= len(shown) <= max_length or not shown.isprintable() or _INVISIBLE.search(shown):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"{what} has {min_length} to {max_length} visible characters in one line; got {name[:80]!r}.",
        )
    if _has_stacked_marks(shown):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"{what} has at most {MARKS_IN_A_ROW} different marks on a letter; got {name[:80]!r}.",
        )
    return shown


def _has_stacked_marks(shown: str) -> bool:
    """Return whether a letter carries more marks than any script writes (Unicode Technical Standard 39, 5.4)."""
    kinds = "".join("m" if unicodedata.category(one) in {"Mn", "Me"} else "-" for one in shown)
    twice = any(one == other and kind == "m" for one, other, kind in zip(shown, shown[1:], kinds, strict=False))
    return twice or "m" * (MARKS_IN_A_ROW + 1) in kinds or any(unicodedata.category(one) == "Me" for one in shown)


def key(name: str, *, max_length: int) -> str:
    """Return what is equal for names that differ in case, spaces and compatibility forms only.

    A NUL counts as a space: PostgreSQL takes none, and no name has one.
    """
    folded = unicodedata.normalize("NFKC", name.replace("\0", " ")).casefold()
    return re.sub(r"\s+", " ", folded).strip()[:max_length]


def is_reserved(name: str) -> bool:
    """Return whether readers would take a name for that of the service or of those who run it."""
    words = [word for word in re.split(r"[\W_]+", name) if word]
    stems = tuple(form for stem in _RESERVED_STEMS for form in _find_readings(stem))
    if any(form.startswith(stems) for word in (name, *words) for form in _find_readings(word)):
        return True
    if any(_matches_any(part, _SERVICE) for part in (*words, *map("".join, pairwise(words)))):
        return True
    if _matches_any(name, _RESERVED_NAMES + _TITLES):
        return True
    named = [word for word in words if not word.isdigit() and not _matches_any(word, _FILLING_WORDS)]
    return bool(named) and all(_matches_any(word, _TITLES) for word in named)


def _matches_any(text: str, words: Iterable[str]) -> bool:
    return any(_find_readings(text) & _find_readings(word) for word in words)


def _find_readings(text: str) -> set[str]:
    """Return what somebody may read who expects a certain word: case and dots of letters do not count."""
    return {outline.removeprefix("=").casefold().replace("i", "l") for outline in _outlines(text)}


def mixes_scripts(name: str) -> bool:
    """Return whether a word has letters of Latin and Cyrillic; Unicode's table lacks some that look alike."""
    words = ({unicodedata.name(one, "").partition(" ")[0] for one in word} for word in re.split(r"[\W_]+", name))
    return any({"LATIN", "CYRILLIC"} <= scripts for scripts in words)


def look_alike(one: str, other: str) -> bool:
    """Return whether a reader may take one name for the other.

    They differ at most in letters that look alike (the table of Unicode Technical Standard 39), case, diacritics,
    spaces, punctuation, and signs such as `~` and `+`.
    """
    return bool(set(_outlines(one)) & set(_outlines(other)))


@lru_cache(maxsize=16_384)
def _outlines(name: str) -> tuple[str, str, str]:
    """Return what is drawn: with letters of all cases as one, with each case for itself, and each drawn case as one."""
    plain = _DIACRITICS.sub("", unicodedata.normalize("NFKD", name))
    latin = "".join(one if one.isascii() else _find_original(one) for one in plain)
    drawn = _strokes(_I_BESIDE_CAPITALS.sub("i", latin)).casefold()
    return _strokes(latin.casefold()), f"={_strokes(latin)}", _strokes(drawn)


def _strokes(name: str) -> str:
    """Return a name in the characters that stand for all that look like them, without spaces and punctuation."""
    drawn = _DIACRITICS.sub("", unicodedata.normalize("NFKD", "".join(map(_find_original, name))))
    for strokes, alike in _SAME_STROKES:
        drawn = drawn.replace(strokes, alike)
    return "".join(one for one in drawn if not _separates(unicodedata.category(one))) or drawn


def _separates(category: str) -> bool:
    return category[0] in "PZ" or category in {"Sk", "Sm"}


def _find_original(character: str) -> str:
    """Return the characters that stand for one in Unicode's table, which the library gives in both directions."""
    from confusable_homoglyphs.confusables import confusables_data  # 1 MB, which only a new name needs

    form = None if character.isascii() else _LATIN_FORM.fullmatch(unicodedata.name(character, ""))
    if form is not None:
        return form[2].lower() if form[1] == "SMALL" else form[2]
    alike: list[str] = [candidate["c"].strip("\u200e") for candidate in confusables_data.get(character, ())]
    if len(alike) != 1:  # it stands for others, or nothing looks like it
        return character
    return alike[0] if len(confusables_data.get(alike[0], ())) > 1 else min(alike[0], character)


TEXT_LENGTH = 4000


def clean_text(text: str, *, what: str) -> str:
    """Return a text as it is stored: plain, without controls and characters that draw nothing.

    Raises:
        ServiceError: it is empty or too long, or has such characters.
    """
    lines = [line.rstrip() for line in text.replace("\r\n", "\n").strip().split("\n")]
    kept = "\n".join(lines)
    if not 2 <= len(kept) <= TEXT_LENGTH or any(not line.replace("\t", "").isprintable() for line in lines):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"{what} has 2 to {TEXT_LENGTH} printable characters; got {len(kept)}: {kept[:60]!r}.",
        )
    return kept
