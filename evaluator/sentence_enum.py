"""Closed sets whose members say in a sentence what they mean to whoever reads them on a page or in a terminal."""

from enum import StrEnum
from typing import Self


class SentenceEnum(StrEnum):
    """Members are texts, which are stored and sent, each with its sentence: `MEMBER = "value", "Sentence."`.

    Attributes:
        sentence: what the member means, and what to do about it where something went wrong.
    """

    sentence: str

    def __new__(cls, value: str, sentence: str = "") -> Self:
        """Return a member. Only a look-up by value, `Members("value")`, leaves its sentence out."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.sentence = sentence
        return member
