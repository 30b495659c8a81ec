"""Follows an evaluation over the REST interface until it ends, showing its progress.

Called by `status`, `submit` and `demo`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .http import Client, Json
    from .progress import EvaluationProgress

POLL_S = 0.5
_ENDED = frozenset({"completed", "failed", "cancelled"})

Pause = Callable[[], object]
"""What happens between two looks at an evaluation; may raise to stop following."""


def has_ended(found: Json) -> bool:
    """Tell whether the newest evaluation of a submission goes on no more."""
    return found["evaluation"]["state"] in _ENDED


def follow(
    client: Client, submission_id: str, progress: EvaluationProgress, pause: Pause = lambda: time.sleep(POLL_S)
) -> Json:
    """Show the progress of an evaluation until it ends, and return its last state."""
    with progress:
        while True:
            found = client.submission(submission_id)
            progress.update(found)
            if has_ended(found):
                return found
            pause()
