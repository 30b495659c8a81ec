from typing import Any, cast

import pytest
from vitac.cli.client.follow import follow, has_ended
from vitac.cli.client.http import Client
from vitac.cli.client.progress import EvaluationProgress

SUBMISSION_ID = "id"


class Answers:
    """Gives one state after the other, as a service does while it evaluates."""

    def __init__(self, *states: str) -> None:
        self.states = list(states)

    def submission(self, submission_id: str) -> dict[str, Any]:
        assert submission_id == SUBMISSION_ID
        return {"evaluation": {"state": self.states.pop(0)}}


def following(answers: Answers, pause: Any) -> dict[str, Any]:
    return follow(cast("Client", answers), SUBMISSION_ID, EvaluationProgress(quiet=True), pause)


@pytest.mark.parametrize("end", ["completed", "failed", "cancelled"])
def test_evaluation_is_looked_at_until_it_has_ended(end: str) -> None:
    answers = Answers("queued", "running", end, "never asked for")
    pauses: list[None] = []
    found = following(answers, lambda: pauses.append(None))
    assert found["evaluation"]["state"] == end
    assert has_ended(found)
    assert len(pauses) == 2
    assert answers.states == ["never asked for"]


def test_pause_may_stop_following() -> None:
    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        following(Answers("running", "running"), stop)
