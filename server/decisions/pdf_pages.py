"""Counts the pages of a PDF without showing it: by its page objects, in the file and in its packed object streams.

ISO 32000-2:2020, 7.5.7 (object streams) and 7.7.3 (pages). Of an object that a file has several times only one counts.
"""

import re
import zlib
from collections.abc import Iterator
from typing import Final

_OBJECT: Final = re.compile(rb"(?<![0-9])(\d{1,9})\s+\d{1,5}\s+obj\b")
_PAGE: Final = re.compile(rb"/Type\s*/Page(?![A-Za-z])")
_PACKED: Final = re.compile(rb"/Type\s*/ObjStm\b")
_UNPACKED_BYTES: Final = 16 << 20
"""Of all object streams together; those of a few pages have some kilobytes."""


def count_pages(data: bytes) -> int:
    """Return the number of pages; 0 of what is no PDF, is encrypted, or hides its pages in another way.

    Each byte is looked at a few times at most, whatever the file says of itself.
    """
    if not data.startswith(b"%PDF-") or b"/Encrypt" in data:
        return 0
    return len({number for number, content in _list_objects(data) if _PAGE.search(content)})


def _list_objects(data: bytes) -> Iterator[tuple[int, bytes]]:
    left = _UNPACKED_BYTES
    for part in data.split(b"endobj"):
        if (begin := _OBJECT.search(part)) is None:
            continue
        head, _, stream = part[begin.end() :].partition(b"stream")
        if not _PACKED.search(head):
            yield int(begin[1]), head
        elif first := re.search(rb"/First\s+(\d{1,9})", head):
            try:
                content = zlib.decompressobj().decompress(stream.lstrip(b"\r\n"), left) if left else b""
            except zlib.error:
                continue
            left -= len(content)
            yield from _list_packed(content, int(first[1]))


def _list_packed(content: bytes, first: int) -> Iterator[tuple[int, bytes]]:
    """Yield the objects of an object stream: numbers and places in pairs, in order, then the objects."""
    numbers = [int(word) for word in content[:first].split() if word.isdigit() and len(word) < 10]
    places = numbers[1::2]
    for number, begin, end in zip(numbers[::2], places, [*places[1:], len(content)], strict=False):
        if begin > end:
            return
        yield number, content[first + begin : first + end]
