"""Names that people choose: how they are shown and compared, and how names that look alike are refused."""

import re
import unicodedata
from functools import lru_cache
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
_SAME_STROKES: Final = (("vv", "w"),)
"""What Unicode's table lacks."""
_RESERVED_WORDS: Final = frozenset(
    f"{word}{ending}"
    for word in ("organizer", "organiser", "admin", "administrator", "moderator")
    for ending in ("", "s")
)
_RESERVED_NAMES: Final = frozenset(
    {"vitac", "vitac arena", "judge", "jury", "staff", "support", "official", "system", "root"}
)


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
    return any(look_alike(name, one) for one in _RESERVED_NAMES) or any(
        look_alike(word, form) for word in words for one in _RESERVED_WORDS for form in (one, one.title())
    )


def look_alike(one: str, other: str) -> bool:
    """Return whether a reader may take one name for the other.

    They differ at most in letters that look alike (the table of Unicode Technical Standard 39), case, diacritics,
    spaces and punctuation.
    """
    return bool(set(_outlines(one)) & set(_outlines(other)))


@lru_cache(maxsize=16_384)
def _outlines(name: str) -> tuple[str, str]:
    """Return what is drawn: with letters of all cases as one, and with each case for itself."""
    plain = _DIACRITICS.sub("", unicodedata.normalize("NFKD", name))
    latin = "".join(one if one.isascii() else _find_original(one) for one in plain)
    return _strokes(latin.casefold()), f"={_strokes(latin)}"


def _strokes(name: str) -> str:
    """Return a name in the characters that stand for all that look like them, without spaces and punctuation."""
    drawn = _DIACRITICS.sub("", unicodedata.normalize("NFKD", "".join(map(_find_original, name))))
    for strokes, alike in _SAME_STROKES:
        drawn = drawn.replace(strokes, alike)
    return "".join(one for one in drawn if unicodedata.category(one)[0] not in "PZ") or drawn


def _find_original(character: str) -> str:
    """Return the characters that stand for one in Unicode's table, which the library gives in both directions."""
    from confusable_homoglyphs.confusables import confusables_data  # 1 MB, which only a new name needs

    alike: list[str] = [found["c"].strip("\u200e") for found in confusables_data.get(character, ())]
    if len(alike) != 1:  # it stands for others, or nothing looks like it
        return character
    return alike[0] if len(confusables_data.get(alike[0], ())) > 1 else min(alike[0], character)
