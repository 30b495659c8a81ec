"""The one result hash of an evaluation of several tasks."""

import hashlib
from collections.abc import Mapping


def combine_hashes(hashes: Mapping[str, str]) -> str:
    """Return the hash of the one task; of several, SHA-256 [hex] over a line `task hash` for each, by task name."""
    if len(hashes) == 1:
        return next(iter(hashes.values()))
    lines = "".join(f"{task} {hashes[task]}\n" for task in sorted(hashes))
    return hashlib.sha256(lines.encode()).hexdigest()
