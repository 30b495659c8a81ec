"""Each message of a 2025 text log goes to its part of the log; one at a wrong place is told, with its line."""

import io
from datetime import datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.logs.text_2025.messages import TextLogRejected
from vitac.evaluator.logs.text_2025.reader import MAX_PROBLEMS, TextLog, read_text_log

BEGIN = datetime(2025, 3, 1, 12)
HEADER = ("#KEY: Touch", "{'max_steps': 12}")
STEP = ("Step 1 Action: [0.5 -1. 0.]", "Offset: [1. 2. 3.]", "info: {'steps': 1}", "Reward: -0.25")


def when(line: int) -> datetime:
    """The time of a line; each is a second after the one before."""
    return BEGIN + timedelta(seconds=line)


def read(*messages: str, header: tuple[str, ...] = HEADER) -> TextLog:
    lines = [
        f"{when(number).isoformat(' ', 'milliseconds')} | INFO     | __main__:evaluate:1 - {message}\n"
        for number, message in enumerate((*header, *messages), start=1)
    ]
    return read_text_log(io.BytesIO("".join(lines).encode()))


def test_the_header_is_read_in_any_order() -> None:
    header = (
        "Git Repository Information:",
        "  branch: main",
        "{'max_steps': 12, 'scale': [1, 2.5]}",
        "this is MD5: " + "0a" * 16,
        "#KEY:  Touch and go ",
        "\n-----Parameters-----\n  friction : 87.5 \n  time: 12:30\n-----End-----\n",
    )
    for order in (header, header[::-1]):
        log = read(header=order)
        assert (log.team, log.script_md5) == ("Touch and go", "0a" * 16)
        assert log.environment == {"max_steps": 12, "scale": (1, 2.5)}
        assert log.parameters == {"friction": "87.5", "time": "12:30"}
    assert read(header=header).git == {"branch": "main"}
    assert read(header=header).problems == []


@pytest.mark.parametrize("header", [HEADER[:1], HEADER[1:], ("#KEY: Touch", "{}")])
def test_without_a_key_or_an_environment_it_is_no_log(header: tuple[str, ...]) -> None:
    with pytest.raises(TextLogRejected, match="Line 1: expected a 2025 text log with `#KEY` and its env") as refused:
        read(header=header)
    assert refused.value.line == 1


def test_the_first_hash_and_the_first_environment_count() -> None:
    log = read("this is MD5: " + "1" * 32, "this is MD5: " + "2" * 32, "{'max_steps': 99}")
    assert (log.script_md5, log.environment) == ("1" * 32, {"max_steps": 12})


@pytest.mark.parametrize("md5", ["1" * 31, "1" * 33, "G" * 32])
def test_what_is_no_md5_is_an_unknown_message(md5: str) -> None:
    log = read(f"this is MD5: {md5}")
    assert log.script_md5 is None
    assert log.problems == [f"line 3: unknown message 'this is MD5: {md5}'"]


def test_a_second_log_begins_where_a_key_stands_again() -> None:
    log = read("#KEY: Other")
    assert log.team == "Touch"
    assert (log.problems, log.misplaced) == (["line 3: a second log begins here"], [3])


@pytest.mark.parametrize("name", ["Touch\x1b[2J", "Touch\tgo", "Touch\x7f"])
def test_a_team_that_could_steer_a_terminal_is_refused(name: str) -> None:
    with pytest.raises(TextLogRejected, match="Line 1: the team's name contains control characters") as refused:
        read(header=(f"#KEY: {name}", HEADER[1]))
    assert refused.value.line == 1


def test_a_whole_test_has_its_times_and_values() -> None:
    second = ("Step 2 Action: [0. 0. 1.]", "Offset: [0. 0. 0.]", "info: {'steps': 2}", "Reward: 10")
    log = read("#### Test No. 1 ####", "Initial offset: [1. 2. 3.]", *STEP, *second, "RESULT: SUCCESS")
    assert log.problems == []
    (episode,) = log.episodes
    assert (episode.number, episode.line, episode.success) == (1, 3, True)
    assert (episode.initial_offset, episode.started, episode.reset_ended) == ((1, 2, 3), when(3), when(4))
    assert episode.ended == when(13)
    first, last = episode.steps
    assert (first.n, first.line, first.action) == (1, 5, (0.5, -1.0, 0.0))
    assert (first.offset, first.info, first.reward) == ((1, 2, 3), {"steps": 1}, -0.25)
    assert (first.started, first.ended) == (when(5), when(6))
    assert (last.n, last.action, last.reward, last.ended) == (2, (0, 0, 1), 10, when(10))


def test_a_log_with_actions_only_takes_its_times_from_the_next_messages() -> None:
    """The lock's script writes no offset, so a step ends where the next begins, and the reset where the first does."""
    log = read("#### Test No. 1 ####", "Step 1 Action: [0. 1.]", "Step 2 Action: [1. 0.]", "RESULT: FAIL")
    (episode,) = log.episodes
    assert [(step.started, step.ended) for step in episode.steps] == [(when(4), when(5)), (when(5), when(6))]
    assert (episode.initial_offset, episode.reset_ended, episode.success) == (None, when(4), False)


@pytest.mark.parametrize(
    ("messages", "problems"),
    [
        (("RESULT: SUCCESS",), ["line 3: it is outside a test"]),
        (("Step 1 Action: [0. 0.]",), ["line 3: it is outside a test"]),
        (("Initial offset: [0. 0.]",), ["line 3: it is outside a test"]),
        (("Offset: [0. 0.]",), ["line 3: it is outside a test"]),
        (("#### Test No. 1 ####", "Reward: 1"), ["line 4: it is before the first action"]),
        (("#### Test No. 1 ####", "info: {'a': 1}"), ["line 4: it is before the first action"]),
        (("#### Test No. 2 ####",), ["line 3: expected test 1, got test 2"]),
        (
            ("#### Test No. 1 ####", "#### Test No. 2 ####"),
            ["line 4: test 1 has no RESULT"],
        ),
        (
            ("#### Test No. 1 ####", "RESULT: FAIL", "#### Test No. 1 ####"),
            ["line 5: test 1 is repeated"],
        ),
        (
            ("#### Test No. 1 ####", "RESULT: FAIL", "#### Test No. 3 ####", "RESULT: FAIL", "#### Test No. 4 ####"),
            ["line 5: expected test 2, got test 3"],
        ),
        (("#### Test No. 1 ####", "RESULT: FAIL", "RESULT: FAIL"), ["line 5: it is outside a test"]),
        (("#### Test No. 1 ####", "RESULT: MAYBE"), ["line 4: expected RESULT SUCCESS or FAIL, got 'MAYBE'"]),
        (
            ("#### Test No. 1 ####", "Step 2 Action: [0. 0.]"),
            ["line 4: expected env step 1, got 2"],
        ),
        (
            ("#### Test No. 1 ####", "Initial offset: [0. 0.]", "Initial offset: [1. 0.]"),
            ["line 5: an initial offset inside a test"],
        ),
        (
            ("#### Test No. 1 ####", "Step 1 Action: [0. 0.]", "Initial offset: [1. 0.]"),
            ["line 5: an initial offset inside a test"],
        ),
        (("what is this",), ["line 3: unknown message 'what is this'"]),
        (("Colour: red",), ["line 3: unknown message 'Colour: red'"]),
        (("#SUCCESS_RATE: 50%",), ["line 3: unknown message '#SUCCESS_RATE: 50%'"]),
        (("#AVG_STEP: 12345.00",), ["line 3: unknown message '#AVG_STEP: 12345.00'"]),
        (("#SUCCESS_RATE: 0", "#SUCCESS_RATE: 0"), ["line 4: the totals are repeated"]),
        (("#SUCCESS_RATE: 100.01%",), ["line 3: expected a success rate of at most 100 %, got 100.01 %"]),
    ],
)
def test_a_message_at_a_wrong_place_is_told(messages: tuple[str, ...], problems: list[str]) -> None:
    log = read(*messages)
    assert log.problems == problems
    assert log.misplaced == [int(problem.split(":")[0].removeprefix("line ")) for problem in problems]


@pytest.mark.parametrize("part", STEP[1:])
def test_an_env_step_has_each_part_once_and_keeps_the_first(part: str) -> None:
    log = read("#### Test No. 1 ####", *STEP, part.replace("1", "7").replace("-0.25", "9"))
    name = part.partition(":")[0].lower()
    assert log.problems == [f"line 8: a second {name} of this env step"]
    (step,) = log.episodes[0].steps
    assert (step.offset, step.info, step.reward) == ((1, 2, 3), {"steps": 1}, -0.25)


def test_the_next_env_step_may_have_all_parts_again() -> None:
    again = ("Step 2 Action: [0. 0. 0.]", *STEP[1:])
    assert read("#### Test No. 1 ####", *STEP, *again, "RESULT: FAIL").problems == []


@pytest.mark.parametrize(
    ("rate", "steps", "claimed"),
    [
        ("#SUCCESS_RATE: 87.50%", "#AVG_STEP: 4.25", (0.875, 4.25)),
        ("#SUCCESS_RATE: 100.00%", "#AVG_STEP: 1234.00", (1.0, 1234.0)),
        ("#SUCCESS_RATE: 0", "#AVG_STEP: NA", (0.0, None)),
    ],
)
def test_totals_are_read_as_claims(rate: str, steps: str, claimed: tuple[float, float | None]) -> None:
    log = read(rate, steps)
    assert (log.claimed_success_rate, log.claimed_average_steps) == claimed
    assert log.has_totals
    assert log.problems == []


def test_without_totals_nothing_is_claimed() -> None:
    log = read("#AVG_STEP: 4.25")
    assert not log.has_totals
    assert (log.claimed_success_rate, log.claimed_average_steps) == (None, 4.25)


def test_a_time_before_that_of_the_line_before_is_told_once() -> None:
    prefix = "2025-03-01 12:00:{:02}.000 | INFO | a:b:1 - "
    lines = [prefix.format(5) + HEADER[0], prefix.format(5) + HEADER[1], prefix.format(4) + "#SUCCESS_RATE: 0"]
    lines += [prefix.format(4) + "#AVG_STEP: NA"]
    log = read_text_log(io.BytesIO("\n".join(lines).encode()))
    assert log.problems == ["line 3: its time is earlier than that of the line before"]
    assert log.has_totals


def test_as_many_misplaced_lines_as_allowed_are_a_log_and_one_more_is_none() -> None:
    assert len(read(*["what"] * MAX_PROBLEMS).problems) == MAX_PROBLEMS
    with pytest.raises(TextLogRejected, match=f"more than {MAX_PROBLEMS} lines are misplaced") as refused:
        read(*["what"] * (MAX_PROBLEMS + 1))
    assert refused.value.line == len(HEADER) + MAX_PROBLEMS + 1


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ("Step 1 Action: 0. 0.", "expected numbers in brackets, got '0. 0.'"),
        ("Step 1 Action: [0. nan]", "expected a finite number, got 'nan'"),
        ("Step 1 Action: [0. zero]", "expected a number, got 'zero'"),
        ("Step 1234567890 Action: [0.]", "expected a count of at most nine digits, got '1234567890'"),
        ("Initial offset: [inf]", "expected a finite number, got 'inf'"),
        ("#### Test No. 1234567890 ####", "expected a count of at most nine digits"),
    ],
)
def test_a_value_that_is_none_ends_the_reading(message: str, reason: str) -> None:
    with pytest.raises(TextLogRejected, match="Line 4: ") as refused:
        read("#### Test No. 1 ####", message)
    assert reason in str(refused.value)
    assert refused.value.line == 4


@pytest.mark.parametrize("message", ["Offset: 5", "Reward: much", "info: [1]", "info: {1: 2}", "info: {'a': f()}"])
def test_a_part_of_a_step_that_has_no_value_ends_the_reading(message: str) -> None:
    with pytest.raises(TextLogRejected, match="Line 5: ") as refused:
        read("#### Test No. 1 ####", STEP[0], message)
    assert refused.value.line == 5


PARTS = ("Initial offset: [1. 2. 3.]", "Step 2 Action: [0. 0.]", "#SUCCESS_RATE: 50.00%", "#AVG_STEP: NA", "{'a': 1}")
TESTS = ("#### Test No. 1 ####", "#### Test No. 2 ####", "RESULT: SUCCESS", "RESULT: FAIL")
KINDS = st.sampled_from([*STEP, *PARTS, *TESTS, "#KEY: A", "junk"])


@given(st.lists(KINDS, max_size=25))
def test_messages_in_any_order_are_read_or_told_and_none_is_lost(messages: list[str]) -> None:
    log = read(*messages)
    assert len(log.problems) == len(log.misplaced)
    assert sum(message.startswith("#### Test") for message in messages) == len(log.episodes)
    steps = [step for episode in log.episodes for step in episode.steps]
    outside = sum("is outside a test" in problem for problem in log.problems)
    assert len(steps) <= sum(message.startswith("Step") for message in messages) <= len(steps) + outside
    assert all(step.started <= (step.ended or step.started) for step in steps)
