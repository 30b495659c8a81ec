from dataclasses import replace
from pathlib import Path

from service_factories import claim, make_principal, shard_ids, submit
from vitac.server.database.engine import Database
from vitac.server.database.states import FileRole
from vitac.server.submissions.files import add_files, find_file, stored_digests
from vitac.server.submissions.intake import UploadedFile


def uploaded(role: FileRole, digit: str) -> UploadedFile:
    return UploadedFile(role=role, path=Path("unread"), sha256=64 * digit, n_bytes=1, name="file", facts={})


def test_a_submission_has_one_sensor_which_is_the_one_made_last(database: Database) -> None:
    """Another mesher makes another one of the same archive; shown and played is the same one."""
    with database.transaction() as session:
        submission = submit(session, make_principal(session))
        for digit in "b", "c", "a":
            add_files(session, submission.id, [uploaded(FileRole.SENSOR, digit), uploaded(FileRole.FIGURES, digit)])
            shown = find_file(session, submission.id, FileRole.SENSOR)
            assert shown is not None
            assert shown.sha256 == 64 * digit
        shards = shard_ids(session, submission)
        add_files(session, submission.id, [uploaded(FileRole.SENSOR, "a")])
        assert {64 * digit for digit in "abc"} <= set(stored_digests(session))
    assert claim(database, shards[0]).sensor_sha256 == 64 * "a"


def test_new_facts_of_a_file_are_added_to_those_it_has(database: Database) -> None:
    """A rejudgement that learns the same of a sensor takes nothing off the result that is shown."""
    with database.transaction() as session:
        submission = submit(session, make_principal(session))
        for facts in {"first": "a"}, {"second": "b"}, {"first": "c"}:
            add_files(session, submission.id, [replace(uploaded(FileRole.COEFFICIENTS, "a"), facts=facts)])
        session.expire_all()
        stored = find_file(session, submission.id, FileRole.COEFFICIENTS)
        assert stored is not None
        assert stored.facts == {"first": "c", "second": "b"}
