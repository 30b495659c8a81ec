"""Follows an evaluation over HTTP until it ends and shows its progress.

Called by `status`, `submit` and `demo`.
"""

import time
from collections.abc import Callable

from .http import Client, Json
from .progress import EvaluationProgress

POLL_S = 0.5
_ENDED = frozenset({"completed", "failed", "cancelled"})

Pause = Callable[[], object]
"""Called between two requests for the state of an evaluation; raises to stop following."""


def has_ended(found: Json) -> bool:
    """Return whether the newest evaluation of a submission has ended."""
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
