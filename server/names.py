"""Names that people choose: how they are shown and compared, and how names that look alike are refused."""

import re
import unicodedata
from typing import Final

from .errors import ProblemCode, ServiceError

_INVISIBLE: Final = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0\U0001d159\U000e0100-\U000e01ef]"
)
"""Letters, marks and symbols that draw nothing. Controls, direction marks and spaces are no printable characters."""
_LATIN_OF: Final = str.maketrans(
    "АВЕЅІЈКМНОРСТУХѴԚԜаеорсухѕіјһԁԛԝѵӏүк"
    "ΑΒΕΖΗΙΚΜΝΟΡΤΥΧαικνορυχϲϳ"
    "ՕՍօսհոզյց"  # Armenian
    "ᎪᏴᏟᎬᎻᎫᏦᏞᎷᏢᏒᏚᎢᏙᎳᏃ"  # Cherokee
    "ıɑɡʏɩ",
    "ABESIJKMHOPCTYXVQWaeopcyxsijhdqwvlykABEZHIKMNOPTYXaikvopuxcjOUouhnqjgABCEHJKLMPRSTVWZiagYi",
)
"""Letters that look like a Latin one (out of Unicode Technical Standard 39, confusables.txt)."""
_SAME_STROKES: Final = (("0", "O"), ("1", "l"), ("I", "l"), ("|", "l"), ("rn", "m"), ("vv", "w"))


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
    return shown


def key(name: str, *, max_length: int) -> str:
    """Return what is equal for names that differ in case, spaces and compatibility forms only.

    A NUL counts as a space: PostgreSQL takes none, and no name has one.
    """
    folded = unicodedata.normalize("NFKC", name.replace("\0", " ")).casefold()
    return re.sub(r"\s+", " ", folded).strip()[:max_length]


def look_alike(one: str, other: str) -> bool:
    """Return whether a reader may take one name for the other: by letters of other scripts, or by strokes."""
    return bool(set(_outlines(one)) & set(_outlines(other)))


def _outlines(name: str) -> tuple[str, str]:
    """Return the name in Latin letters without its case, and with its case but without strokes that look the same."""
    latin = re.sub(r"\s", "", unicodedata.normalize("NFKC", name).translate(_LATIN_OF))
    strokes = latin
    for drawn, alike in _SAME_STROKES:
        strokes = strokes.replace(drawn, alike)
    return latin.casefold(), f"={strokes}"
