"""What operators decide: once each, noted with its length, and with a stop that nobody overlooks."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Event
from typing import Any

import pytest
from vitac.evaluator.episodes.records import HelpKind
from vitac.station.guard import StationStopped
from vitac.station.operators import DecisionRefused, Operator, OperatorDecision

CHOICES = (OperatorDecision.ACCEPT, OperatorDecision.REGRASP, OperatorDecision.REFUSE)


def started(work: Callable[[], Any], operator: Operator) -> "Future[Any]":
    """Work of the station's thread, which has come to where it waits for people."""
    future = ThreadPoolExecutor(1).submit(work)
    while not operator.is_awaited and not future.done():
        Event().wait(0.001)
    return future


def number(operator: Operator) -> int:
    return int(operator.describe()["question"]["number"])


def test_of_two_operators_the_first_decides_and_the_other_reads_so() -> None:
    operator = Operator(asks=True)
    asked = started(lambda: operator.ask("Begin?", CHOICES), operator)
    first = number(operator)
    operator.decide(first, OperatorDecision.ACCEPT)
    with pytest.raises(DecisionRefused, match=r"This was decided already \(accept\)\. Look at the page as it is now\."):
        operator.decide(first, OperatorDecision.ACCEPT)
    assert asked.result(5) == (OperatorDecision.ACCEPT, "")
    again = started(lambda: operator.ask("And now?", CHOICES), operator)
    with pytest.raises(DecisionRefused, match="decided already"):
        operator.decide(first, OperatorDecision.REFUSE, "late")
    with pytest.raises(DecisionRefused, match="why the trial is refused"):
        operator.decide(number(operator), OperatorDecision.REFUSE)
    operator.decide(number(operator), OperatorDecision.REFUSE, " a hand ")
    assert again.result(5) == (OperatorDecision.REFUSE, "a hand")
    operator.pause()
    for change, sentence in ((operator.pause, "paused already"), (lambda: operator.write_note(" "), "got nothing")):
        with pytest.raises(DecisionRefused, match=sentence):
            change()
    operator.resume()
    with pytest.raises(DecisionRefused, match="is not paused"):
        operator.resume()


def test_every_help_is_in_the_record_of_its_trial_with_its_length() -> None:
    operator = Operator(asks=False)
    operator.begin({})
    operator.pause()
    waiting = started(lambda: operator.wait_while_paused("Env step 2 of 8."), operator)
    Event().wait(0.2)
    operator.write_note("The gel looks dry.")
    operator.resume()
    waiting.result(5)
    note, pause = operator.end()
    assert (note.kind, note.length_s, note.note) == (HelpKind.NOTE, 0.0, "The gel looks dry.")
    assert (pause.kind, 0.2 <= pause.length_s < 2, pause.at_s) == (HelpKind.PAUSE, True, 0.0)
    assert operator.end() == ()


def test_stop_ends_a_trial_that_waits_and_nothing_moves_before_it_is_released() -> None:
    operator = Operator(asks=False)
    operator.pause()
    waiting = started(lambda: operator.wait_while_paused("Env step 2 of 8."), operator)
    operator.stop("An operator stopped it.")
    with pytest.raises(StationStopped, match="An operator stopped it"):
        waiting.result(5)
    operator.resume()
    safe = started(lambda: operator.make_safe("An operator stopped it."), operator)
    with pytest.raises(DecisionRefused, match="stopped already"):
        operator.stop("Twice.")
    operator.decide(number(operator), OperatorDecision.ACCEPT, "Took the cable away.")
    safe.result(5)
    operator.begin({"shape": "key1"})
    assert operator.describe()["about"] == {"shape": "key1"}
    assert [(each.kind, each.at_s < 0.1, each.note) for each in operator.end()] == [
        (HelpKind.PAUSE, True, ""),
        (HelpKind.RELEASE, True, "Took the cable away."),
    ]
    assert operator.describe()["about"] == {}, "nothing is about to happen"
    operator.wait_while_paused("It goes on.")


def test_agent_that_ends_gives_up_waiting_and_the_next_trial_waits_again() -> None:
    operator = Operator(asks=True)
    safe = started(lambda: operator.make_safe("A limit was passed."), operator)
    operator.cancel("The agent ends the trial.")
    with pytest.raises(StationStopped, match="The agent ends"):
        safe.result(5)
    assert operator.stop_reason == "A limit was passed."
    operator.open()
    again = started(lambda: operator.make_safe("A limit was passed."), operator)
    operator.decide(number(operator), OperatorDecision.ACCEPT)
    again.result(5)
