from typing import Any, cast

import pytest
from vitac.cli.client.answers import RequestRefused, ServiceUnreachable
from vitac.cli.client.http import Client
from vitac.cli.client.pieces import PAUSES_S
from vitac.cli.client.progress import EvaluationProgress
from vitac.cli.client.status import ask_patiently, follow, has_ended

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


class Down:
    """Answers after some failures."""

    def __init__(self, failures: int, error: Exception) -> None:
        self.failures, self.error = failures, error

    def ask(self) -> str:
        if self.failures:
            self.failures -= 1
            raise self.error
        return "answer"


def refusal_with(code: str) -> RequestRefused:
    return RequestRefused(status=503, code=code, detail="no", request_id=None)


@pytest.mark.parametrize("error", [ServiceUnreachable("down"), refusal_with("service_stopping")])
def test_a_service_that_is_down_is_waited_for_and_given_up_in_the_end(
    error: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    pauses: list[float] = []
    assert ask_patiently(Down(3, error).ask, pause=pauses.append) == "answer"
    assert pauses == list(PAUSES_S[:3])
    assert capsys.readouterr().err.count("Trying again for about a minute.") == 1
    with pytest.raises(type(error)):
        ask_patiently(Down(100, error).ask, pause=pauses.append)
    assert len(pauses) == 3 + len(PAUSES_S)


def test_a_refusal_that_stays_is_not_waited_for() -> None:
    with pytest.raises(RequestRefused):
        ask_patiently(Down(1, refusal_with("not_found")).ask, pause=lambda _: pytest.fail("waited"))
