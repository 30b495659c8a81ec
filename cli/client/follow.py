"""Follows an evaluation over HTTP until it ends and shows its progress.

Called by `status`, `submit` and `demo`.
"""

import sys
import time
from collections.abc import Callable
from typing import TypeVar

from .answers import RequestRefused, ServiceUnreachable
from .http import Client, Json
from .pieces import PAUSES_S, is_transient
from .progress import EvaluationProgress

AnswerT = TypeVar("AnswerT")

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
            found = ask_patiently(lambda: client.submission(submission_id))
            progress.update(found)
            if has_ended(found):
                return found
            pause()


def ask_patiently(ask: Callable[[], AnswerT], *, pause: Callable[[float], object] = time.sleep) -> AnswerT:
    """Return what is answered; a service that is down, or starts, is waited for as an upload waits.

    Raises:
        RequestRefused: the service refuses it.
        ServiceUnreachable: nothing answered for about a minute.
    """
    for number, pause_s in enumerate(PAUSES_S):
        try:
            return ask()
        except (RequestRefused, ServiceUnreachable) as error:
            if isinstance(error, RequestRefused) and not is_transient(error):
                raise
            if number == 0:
                print(f"{error} Trying again for about a minute.", file=sys.stderr)
        pause(pause_s)
    return ask()
