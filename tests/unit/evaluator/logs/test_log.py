import hashlib
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from evaluation_records import make_manifest, make_record
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord, Timings, canonical_json
from vitac.evaluator.logs.log import (
    MAX_INFO_BYTES,
    MAX_INFO_VALUES,
    MAX_LINE_BYTES,
    LogHeader,
    LogProblem,
    LogReader,
    LogRejected,
    count_values,
    is_log,
    is_team_name,
    write_log,
)

RECORDS = [make_record(1), make_record(2, EpisodeOutcome.TACTILE), make_record(3, EpisodeOutcome.POLICY_FAILED, 0)]


def written(records: list[EpisodeRecord] = RECORDS, **header: Any) -> bytes:
    stream = io.BytesIO()
    write_log(stream, LogHeader(**{"manifest": make_manifest(), "team": "Touch", **header}), records)
    return stream.getvalue()


LOG = written()
LINES = LOG.splitlines(keepends=True)


def read(log: bytes) -> list[EpisodeRecord]:
    return list(LogReader(io.BytesIO(log)).records())


def refused(log: bytes) -> LogRejected:
    with pytest.raises(LogRejected) as rejection:
        read(log)
    return rejection.value


def changed(line: int, change: Any) -> bytes:
    """The log with the JSON of one line (from 1) changed and its digest left as it was."""
    content = json.loads(LINES[line - 1])
    change(content)
    lines = list(LINES)
    lines[line - 1] = json.dumps(content).encode() + b"\n"
    return b"".join(lines)


def test_log_holds_header_and_records_without_their_timings() -> None:
    records = [record.model_copy(update={"timings": Timings(wall_s=2)}) for record in RECORDS]
    log = written(records)
    assert LogReader(io.BytesIO(log)).header.team == "Touch"
    assert read(log) == RECORDS


def test_log_is_written_and_read_as_a_stream() -> None:
    class OneWay(io.BytesIO):
        def seek(self, *_: object) -> int:
            raise AssertionError("the log was sought in")

    def endless() -> Iterator[EpisodeRecord]:
        yield from RECORDS

    stream = OneWay()
    write_log(stream, LogHeader(manifest=make_manifest()), endless())
    assert list(LogReader(OneWay(stream.getvalue())).records()) == RECORDS


def test_knows_its_own_files(tmp_path: Any) -> None:
    ours, other = tmp_path / "ours", tmp_path / "other"
    ours.write_bytes(LOG)
    other.write_bytes(b"2025-01-01 | INFO\n" + LOG)
    assert (is_log(ours), is_log(other)) == (True, False)


@pytest.mark.parametrize("line", [1, 2, 3, 4, 5])
def test_altered_line_is_named(line: int) -> None:
    def alter(content: dict[str, Any]) -> None:
        if "manifest" in content:
            content["team"] = "Somebody else"
        elif "record" in content:
            content["record"]["total_reward"] = 99.5
        else:
            content["digest"] = "0" * 64

    rejection = refused(changed(line, alter))
    assert (rejection.problem, rejection.line) == (LogProblem.ALTERED, line)
    assert str(rejection).startswith(f"Line {line}: ")


@given(st.integers(0, len(LOG) - 1), st.integers(1, 255))
def test_no_changed_byte_goes_unnoticed(place: int, difference: int) -> None:
    """Unless the JSON says the same: a line end of another kind."""
    damaged = bytearray(LOG)
    damaged[place] ^= difference
    try:
        records = read(bytes(damaged))
    except LogRejected:
        return
    assert records == RECORDS
    assert LogReader(io.BytesIO(bytes(damaged))).header == LogReader(io.BytesIO(LOG)).header


@given(st.integers(0, len(LOG) - 1))
def test_log_cut_anywhere_is_refused(length: int) -> None:
    rejection = refused(LOG[:length])
    assert rejection.line - LOG[:length].count(b"\n") in (1, 2)


@pytest.mark.parametrize(
    "junk",
    [
        b"",
        b"\x00\xff\xfe" * 100,
        b"\n",
        b"null\n",
        b"[1]\n",
        b"{}\n",
        b'{"format": "other"}\n',
        b"[" * 100_000,
        b'"\\ud800"',
    ],
)
def test_junk_is_not_a_log(junk: bytes) -> None:
    rejection = refused(junk)
    assert (rejection.problem, rejection.line) == (LogProblem.NOT_A_LOG, 1)


def test_endless_line_is_refused_after_a_megabyte() -> None:
    class Endless(io.RawIOBase):
        """A line of 1 GB that tells how much of it was read."""

        given = 0

        def readable(self) -> bool:
            return True

        def readinto(self, buffer: Any) -> int:
            buffer[:] = b"{" * len(buffer)
            self.given += len(buffer)
            assert self.given < 1 << 30
            return len(buffer)

    endless = Endless()
    with pytest.raises(LogRejected) as rejection:
        LogReader(io.BufferedReader(endless))
    assert (rejection.value.problem, rejection.value.line) == (LogProblem.LINE_TOO_LONG, 1)
    assert endless.given < 2 * MAX_LINE_BYTES


@pytest.mark.parametrize(("bytes_over", "problem"), [(0, LogProblem.ALTERED), (1, LogProblem.LINE_TOO_LONG)])
def test_line_up_to_the_limit_is_read(bytes_over: int, problem: LogProblem) -> None:
    """A line of just a megabyte is refused for its digest only, its line end counted."""
    end = json.dumps({"episodes": 3, "digest": "0" * 64}).encode()
    line = end + b" " * (MAX_LINE_BYTES - len(end) - 1 + bytes_over) + b"\n"
    assert len(line) == (1 << 20) + bytes_over
    rejection = refused(b"".join([*LINES[:4], line]))
    assert (rejection.problem, rejection.line) == (problem, 5)


def test_limits_are_those_that_participants_read(repository: Path) -> None:
    text = (repository / "docs" / "logs.md").read_text()
    assert f"one object and at most {MAX_LINE_BYTES >> 20} MiB a line" in text
    assert f"at most {MAX_INFO_BYTES >> 10} KiB and {MAX_INFO_VALUES} values each" in text
    assert (MAX_LINE_BYTES % (1 << 20), MAX_INFO_BYTES % (1 << 10)) == (0, 0)


def with_info(info: Any) -> bytes:
    """A log in whose second episode env step 3 has this info."""
    infos = ({"steps": 1}, {"steps": 2}, info)
    return written([RECORDS[0], make_record(2, infos=infos), RECORDS[2]])


@pytest.mark.parametrize(
    "info",
    [
        {"flat": [0] * (MAX_INFO_VALUES - 2)},
        {"deep": [[[0]]] * ((MAX_INFO_VALUES - 2) // 4)},
        {"text": "x" * (MAX_INFO_BYTES - len('{"text":""}'))},
    ],
)
def test_info_up_to_the_limits_is_read(info: Any) -> None:
    assert read(with_info(info))[1].infos[2] == info


@pytest.mark.parametrize(
    ("info", "expected"),
    [
        ({"flat": [0] * (MAX_INFO_VALUES - 1)}, f"expected at most {MAX_INFO_VALUES} values, got more"),
        ({"deep": [[[0]]] * 200}, f"expected at most {MAX_INFO_VALUES} values, got more"),
        ({str(key): {} for key in range(MAX_INFO_VALUES)}, f"expected at most {MAX_INFO_VALUES} values, got more"),
        (
            {"text": "x" * (MAX_INFO_BYTES - 10)},
            f"expected at most {MAX_INFO_BYTES} bytes of JSON, got {MAX_INFO_BYTES + 1}",
        ),
    ],
)
def test_oversized_info_is_refused_with_its_line_and_env_step(info: Any, expected: str) -> None:
    rejection = refused(with_info(info))
    assert (rejection.problem, rejection.line) == (LogProblem.INFO_TOO_LARGE, 3)
    assert f"Line 3: the info of env step 3: {expected}" in str(rejection)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_number_that_is_none_is_refused(number: str) -> None:
    line = LINES[1].replace(b'"total_reward":1.5', f'"total_reward":{number}'.encode())
    assert line != LINES[1]
    rejection = refused(b"".join([LINES[0], line, *LINES[2:]]))
    assert rejection.problem in (LogProblem.NOT_JSON, LogProblem.INVALID)
    assert rejection.line == 2


def test_nan_action_is_refused() -> None:
    import base64

    nan = base64.b64encode(b"\x00\x00\xc0\x7f" * 9).decode()
    rejection = refused(changed(2, lambda content: content["record"]["actions"].update(float32_base64=nan)))
    assert (rejection.problem, rejection.line) == (LogProblem.INVALID, 2)
    assert "every action must be finite" in str(rejection)


@pytest.mark.parametrize(("line", "nearest"), [(1, "team"), (5, "episodes")])
def test_unknown_key_is_named_with_the_nearest(line: int, nearest: str) -> None:
    rejection = refused(changed(line, lambda content: content.update({f"{nearest}s": 1})))
    assert (rejection.problem, rejection.line) == (LogProblem.INVALID, line)
    assert f"did you mean '{nearest}'?" in str(rejection)


@pytest.mark.parametrize("key", ["shape", "task"])
def test_name_that_could_steer_a_terminal_is_refused(key: str) -> None:
    rejection = refused(changed(2, lambda content: content["record"].update({key: "\x1b[2J"})))
    assert (rejection.problem, rejection.line) == (LogProblem.INVALID, 2)


def test_reader_tells_how_far_it_is_and_the_digest_up_to_there() -> None:
    reader = LogReader(io.BytesIO(LOG))
    digests = [json.loads(line)["digest"] for line in LINES]
    assert (reader.line, reader.digest) == (1, digests[0])
    for number, _ in enumerate(reader.records(), start=2):
        assert (reader.line, reader.digest) == (number, digests[number - 1])
    assert (reader.line, reader.digest) == (5, digests[4])


def test_message_about_many_problems_stays_short() -> None:
    many = {f"key{number}": 1 for number in range(1000)}
    rejection = refused(changed(2, lambda content: content.update(many)))
    assert "And 995 more." in str(rejection)
    assert len(str(rejection)) < 2000


def test_digests_follow_the_documented_recipe() -> None:
    """docs/logs.md, in other words than the code's."""
    before = ""
    for line in LINES:
        content = json.loads(line)
        digest = content.pop("digest")
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
        assert digest == hashlib.sha256((before + text).encode()).hexdigest()
        before = digest


def test_problems_are_the_stable_codes_of_the_api() -> None:
    assert all(problem.value == problem.name.lower() for problem in LogProblem)
    assert {problem.value for problem in LogProblem} == {
        "not_a_log",
        "unknown_version",
        "line_too_long",
        "info_too_large",
        "not_json",
        "invalid",
        "altered",
        "episode_repeated",
        "truncated",
        "trailing",
    }


def chained(*contents: dict[str, Any]) -> bytes:
    """A log of these lines, each with a right digest."""
    lines, digest = [], ""
    for content in contents:
        digest = hashlib.sha256(digest.encode() + canonical_json(content)).hexdigest()
        lines.append(canonical_json({**content, "digest": digest}) + b"\n")
    return b"".join(lines)


def contents() -> list[dict[str, Any]]:
    """The log's lines without their digests."""
    found = [json.loads(line) for line in LINES]
    for content in found:
        del content["digest"]
    return found


FIRST, ONE, TWO, THREE, END = contents()
REFUSALS: list[tuple[bytes, LogProblem, str]] = [
    (b"", LogProblem.NOT_A_LOG, "Line 1: it is not JSON: Expecting value: line 1 column 1 (char 0)."),
    (b"[1]\n", LogProblem.NOT_A_LOG, "Line 1: expected a JSON object, got a list."),
    (b"{}\n", LogProblem.NOT_A_LOG, 'Line 1: expected the header of a log, {"format": "vitac-log", ...}.'),
    (
        chained({**FIRST, "version": 2}),
        LogProblem.UNKNOWN_VERSION,
        "Line 1: expected format version 1, got 2.",
    ),
    (
        chained({**FIRST, "version": "one" * 30}),
        LogProblem.UNKNOWN_VERSION,
        "Line 1: expected format version 1, got 'oneoneoneoneoneoneoneoneoneoneoneoneone.",
    ),
    (LINES[0], LogProblem.TRUNCATED, "Line 2: the log has no last line; it is truncated."),
    (LINES[0] + LINES[1][:-1], LogProblem.TRUNCATED, "Line 2: the log has no last line; it is truncated."),
    (LINES[0] + b"null\n", LogProblem.NOT_JSON, "Line 2: expected a JSON object, got a NoneType."),
    (LINES[0] + b'{"a": NaN}\n', LogProblem.NOT_JSON, "Line 2: it is not JSON: NaN is not a number."),
    (LINES[0] + b'{"a": -Infinity}\n', LogProblem.NOT_JSON, "Line 2: it is not JSON: -Infinity is not a number."),
    (LINES[0] + b'{"a": 1, "a": 1}\n', LogProblem.NOT_JSON, "Line 2: it is not JSON: a key is repeated."),
    (
        LOG + b"\n",
        LogProblem.TRAILING,
        "Line 6: there is data after the end of the log; upload one log at a time.",
    ),
    (
        chained(FIRST, ONE, ONE, END),
        LogProblem.EPISODE_REPEATED,
        "Line 3: episode 1 is in the log twice.",
    ),
    (
        chained(FIRST, TWO, ONE, END),
        LogProblem.ALTERED,
        "Line 3: expected episodes in ascending order, got 1 after 2.",
    ),
    (
        chained(FIRST, ONE, TWO, END),
        LogProblem.ALTERED,
        "Line 4: expected 3 episodes, as the last line says, got 2.",
    ),
    (
        LINES[0] + LINES[2],
        LogProblem.ALTERED,
        "Line 2: its digest is wrong: the line was altered, moved or duplicated.",
    ),
    (
        LINES[0] + b'{"a": ' + b" " * MAX_LINE_BYTES + b"1}\n",
        LogProblem.LINE_TOO_LONG,
        f"Line 2: expected at most {MAX_LINE_BYTES} bytes, got more.",
    ),
]


@pytest.mark.parametrize(("log", "problem", "message"), REFUSALS, ids=[message[:40] for *_, message in REFUSALS])
def test_a_refusal_is_one_sentence_with_its_line(log: bytes, problem: LogProblem, message: str) -> None:
    refusal = refused(log)
    assert (refusal.problem, str(refusal)) == (problem, message)
    assert refusal.line == int(message.removeprefix("Line ").partition(":")[0])


@pytest.mark.parametrize("record", [None, [], "text", {"infos": None}, {"infos": {"a": 1}}, {"infos": [None]}])
def test_a_record_of_another_form_is_invalid(record: object) -> None:
    refusal = refused(chained(FIRST, {"record": record}))
    assert (refusal.problem, refusal.line) == (LogProblem.INVALID, 2)


@pytest.mark.parametrize("numbers", [(1,), (2, 3), (1, 5, 9), (3, 1000)])
def test_a_log_may_have_a_part_of_the_episodes(numbers: tuple[int, ...]) -> None:
    records = [make_record(number) for number in numbers]
    assert [record.episode for record in read(written(records))] == list(numbers)


def test_a_header_without_team_and_submission_is_one() -> None:
    header = LogReader(io.BytesIO(written([], team=None))).header
    assert (header.team, header.submission_digest) == (None, None)
    named = LogReader(io.BytesIO(written([], submission_digest="ab12"))).header
    assert named.submission_digest == "ab12"


@pytest.mark.parametrize(
    ("name", "can_be_named"),
    [
        ("", True),
        ("Touch 2", True),
        ("Tästers Ünited", True),
        ("x" * 200, True),
        ("x" * 201, False),
        ("two\nlines", False),
        ("bell\a", False),
        ("\u202etfel", False),
        ("\u00a0", False),
    ],
)
def test_a_team_is_one_line_of_printable_characters(name: str, can_be_named: bool) -> None:
    assert is_team_name(name) == can_be_named
    if can_be_named:
        assert LogReader(io.BytesIO(written([], team=name))).header.team == name
    else:
        refusal = refused(chained({**FIRST, "team": name}))
        assert refusal.problem is LogProblem.INVALID
        assert "must be one line of at most 200 printable characters" in str(refusal)


@pytest.mark.parametrize(
    ("content", "values"),
    [(1, 1), ("text", 1), (None, 1), ([], 1), ({}, 1), ([[], []], 3), ({"a": {"b": [1, 2]}}, 5), ({"a": 1, "b": 2}, 3)],
)
def test_lists_and_objects_count_as_values_too(content: object, values: int) -> None:
    assert count_values(content, 100) == values
