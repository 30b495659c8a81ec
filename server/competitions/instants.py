"""Moments as people write them in a competition's file, with what is wrong with one in words."""

import re
from calendar import month_name, monthrange
from datetime import UTC, datetime, timedelta
from typing import Annotated

from pydantic import AfterValidator, AwareDatetime, BeforeValidator

EXAMPLE = "2025-02-01T00:00:00Z"
_ZONE_NAMES = {"utc": "Z", "gmt": "Z", "zulu": "Z"}
_MOMENT = re.compile(
    r"(?P<year>[0-9]{4})-(?P<month>[0-9]{1,2})-(?P<day>[0-9]{1,2})"
    r"(?:(?:[Tt]|\s+)(?P<hour>[0-9]{1,2}):(?P<minute>[0-9]{2})(?::(?P<second>[0-9]{2})(?P<part>\.[0-9]+)?)?"
    r"\s*(?P<zone>[Zz]|[+-][0-9]{1,2}(?::?[0-9]{2})?)?)?"
)
_REMEDIES = (
    (re.compile(r"[^ -~]"), "write it with plain characters: digits, -, : and +"),
    (re.compile(r"(?i)[0-9\s.][ap]\.?m\b"), "write the hours from 00 to 23, without AM or PM"),
    (
        re.compile(r"(?i)[0-9]\s?(?:[a-z]{3,5}|[a-z]+/[a-z_]+)(?:[+-][0-9:]+)?$"),
        "write the zone as Z for UTC or as +01:00",
    ),
    (
        re.compile(r"^[0-9]{1,4}[./_][0-9]{1,2}[./_][0-9]{1,4}|^[0-9]{1,2}-[0-9]{1,2}-[0-9]{4}"),
        "write the date as YYYY-MM-DD",
    ),
    (re.compile(r"^[0-9]{4}-[0-9]{1,2}-[0-9]{1,2}.*[0-9]"), "write the time as HH:MM:SS, after a T"),
)
"""What is often written, and what to write in its place."""


def read_instant(value: object) -> datetime:
    """Return the moment that somebody wrote, with its time zone.

    Raises:
        ValueError: it is none; the message says what is wrong with it and what to write.
    """
    if isinstance(value, datetime):
        return _in_zone(value)
    if not isinstance(value, str):
        raise _refusal(
            "write a whole date with its time and zone" if value is not None else "write one after the colon"
        )
    text = " ".join(value.split())
    parts = _MOMENT.fullmatch(text)
    if parts is None:
        named, _, zone = text.rpartition(" ")
        if zone.lower() in _ZONE_NAMES and (known := _MOMENT.fullmatch(f"{named}Z")):
            raise _refusal(f"write {_format(known)}")
        remedy = next((remedy for pattern, remedy in _REMEDIES if pattern.search(text)), "write it in this form")
        raise _refusal(remedy)
    return _in_zone(_read(parts))


def _read(parts: re.Match[str]) -> datetime:
    year, month, day = (int(parts[name]) for name in ("year", "month", "day"))
    if not 1900 <= year <= 9998:
        raise _refusal("years go from 1900 to 9998")
    if not 1 <= month <= 12:
        raise _refusal(f"there is no month {month}; write YYYY-MM-DD")
    if not 1 <= day <= monthrange(year, month)[1]:
        raise _refusal(f"{month_name[month]} {year} has {monthrange(year, month)[1]} days; write one of them")
    if parts["hour"] is None:
        raise _refusal(f"it has no time and zone; write {_format(parts)} for the first moment of the day in UTC")
    hour, minute, second = (int(parts[name] or 0) for name in ("hour", "minute", "second"))
    if (hour, minute, second) == (24, 0, 0):
        after = datetime(year, month, day, tzinfo=UTC) + timedelta(days=1)
        raise _refusal(f"a day ends where the next one begins; write {after:%Y-%m-%d}T00:00:00{parts['zone'] or 'Z'}")
    if hour > 23 or minute > 59 or second > 59:
        raise _refusal("hours go from 00 to 23, minutes and seconds from 00 to 59")
    try:
        return datetime.fromisoformat(_format(parts, zone=parts["zone"] or ""))
    except ValueError as error:
        raise _refusal("an offset goes from -23:59 to +23:59") from error


def _in_zone(moment: datetime) -> datetime:
    if moment.tzinfo is None:
        example = f"{moment:%Y-%m-%dT%H:%M:%S}Z"
        raise _refusal(f"it has no time zone; write {example} for UTC, or an offset such as +01:00 in place of Z")
    return moment


def _format(parts: re.Match[str], *, zone: str = "Z") -> str:
    """Return a moment as ISO 8601 writes it in full."""
    date = f"{parts['year']}-{int(parts['month']):02d}-{int(parts['day']):02d}"
    time = f"{int(parts['hour'] or 0):02d}:{parts['minute'] or '00'}:{parts['second'] or '00'}{parts['part'] or ''}"
    digits = zone.replace(":", "")[1:]
    offset = (
        f"{zone[0]}{digits[:-2] if len(digits) > 2 else digits:0>2}:{digits[-2:] if len(digits) > 2 else '00'}"
        if digits
        else zone
    )
    return f"{date}T{time}{offset.upper()}"


def _refusal(remedy: str) -> ValueError:
    return ValueError(f"expected a moment with its time zone, such as {EXAMPLE}; {remedy}")


Instant = Annotated[AwareDatetime, BeforeValidator(read_instant), AfterValidator(lambda moment: moment.astimezone(UTC))]
"""A moment with its time zone, stored in UTC."""
