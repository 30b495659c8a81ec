"""What `session` asks of whichever protocol a policy server speaks."""

from collections.abc import Mapping
from typing import Any, Final, Protocol

from numpy.typing import NDArray

from ..agent.isolation.output import printable
from ..agent.verdicts import PolicyFailed, VerdictCode

_ERROR_CHARACTERS: Final = 4096

Sent = Mapping[str, NDArray[Any]]


class Dialogue(Protocol):
    """What both ends say on one line; every call has a deadline by the monotonic clock.

    All raise `PolicyFailed`, `LineLost` and `LineSilent`.
    """

    def greet(self, deadline_s: float) -> None:
        """Do what comes before the first episode."""

    def begin(self, prompt: str, deadline_s: float) -> None:
        """Say that an episode begins."""

    def ask(self, sent: Sent, prompt: str, deadline_s: float) -> object:
        """Send an observation; return the field with the actions, undecoded."""

    def end(self, deadline_s: float) -> None:
        """Say that the episode is over."""

    def close(self) -> None:
        """Close this end."""


def reported(text: str) -> PolicyFailed:
    """Return the failure of a policy whose server said so, in a text of any length."""
    end = printable(text[-_ERROR_CHARACTERS:]).strip()
    return PolicyFailed(
        VerdictCode.CRASHED, f"The policy server reported an error: {end.rpartition(chr(10))[2]!r:.300}.", end
    )
