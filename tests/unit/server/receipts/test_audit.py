"""A board is exported from a database, as it is and after somebody has changed something in it, and audited."""

import json
import zipfile
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest
from audited_boards import complete, environment_of, played_again, sampled
from databases import opened_database
from made_receipts import KEY, PUBLIC_KEY
from obstore.store import MemoryStore
from service_factories import TASK, TRACK, forget_boards, make_principal, own_record, submit
from sqlalchemy import Executable, func, select, text, update
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.episode import Environment
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.tracks.sealed import make_commitment
from vitac.server.accounts import merging, teams
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation, ReceiptKey, ReceiptRow, Submission, Team
from vitac.server.database.states import EvaluationState
from vitac.server.decisions import rejudging
from vitac.server.decisions.exporting import export_receipts
from vitac.server.decisions.publishing import ResultsNotWritten
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.scores import combined_result
from vitac.server.operations import team_data
from vitac.server.principals import CONSOLE
from vitac.server.receipts import issuing
from vitac.server.receipts.audit import Audit, audit
from vitac.server.receipts.export import DESCRIPTION_NAME, LOG_NAME, ExportRejected, read_receipts
from vitac.server.storage.blobs import BlobStore
from vitac.server.transparency import log
from vitac.server.transparency.entries import Content
from vitac.server.transparency.merkle import ProofRejected

from competitions import shown_stage

SEED = 1
TEAMS = ("Ants", "Bees", "Cats")
NO_FILES = BlobStore(MemoryStore())


def finish_all(database: Database, team: int, env: Environment, real: EpisodeRecord) -> None:
    """A submission of a team that fails in the first `team` episodes, complete; one of its records is given."""

    def record_of(_task: str, number: int) -> EpisodeRecord:
        if (team, number) == (1, real.episode):
            return real
        has_failed = number <= 5 * team
        return own_record(100 * team + 100, number, EpisodeOutcome.TACTILE if has_failed else EpisodeOutcome.SUCCESS)

    with database.transaction() as session:
        submission = submit(session, make_principal(session, TEAMS[team]), TEAMS[team])
    complete(database, submission, env, record_of)


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    """A database with three teams on a board; what a test changes in it is taken back."""
    entry, number = sampled(SEED, len(TEAMS))
    assert entry == 1, "the seed samples an episode of the second team"
    with opened_database() as database:
        env = environment_of(TASK)
        real = played_again(TASK, number, env)
        for team in range(len(TEAMS)):
            finish_all(database, team, env, real)
        yield database


def audited(
    database: Database, folder: Path, *changes: Executable | Callable[[Session], None], **options: Any
) -> Audit:
    """The audit of the board after changes that somebody can make who has the database."""
    forget_boards()  # nothing notes these changes
    with Session(database.engine) as session:
        session.execute(text("SET LOCAL session_replication_role = replica"))  # no triggers, no foreign keys
        for change in changes:
            if callable(change):
                change(session)
            else:
                session.execute(change)
        session.expire_all()
        export_receipts(session, NO_FILES, folder / "board.zip", shown_stage(session, TRACK), task=TASK)
    return audit(folder / "board.zip", **({"episodes": 0} | options))


def changed(folder: Path, member: str, change: Callable[[bytes], bytes]) -> Path:
    """The export with other content in one of its members."""
    path = folder / "changed.zip"
    with zipfile.ZipFile(folder / "board.zip") as export, zipfile.ZipFile(path, "w") as written:
        for name in export.namelist():
            content = export.read(name)
            written.writestr(name, change(content) if name == member else content)
    return path


def test_an_untouched_board_is_found_right_and_a_sampled_episode_gives_the_same_states(
    database: Database, tmp_path: Path
) -> None:
    with database.transaction() as session:
        key = log.read_log_state(session).public_key
    found = audited(database, tmp_path, episodes=1, seed=SEED, public_key=key)
    assert found.findings == []
    assert found.unchecked == []
    assert (found.log_entries, found.entries, found.logs, found.is_believed) == (6, 3, 3, True)
    assert [sample.episode for sample in found.resimulated] == [sampled(SEED, len(TEAMS))[1]]
    other_key = audit(tmp_path / "board.zip", episodes=0, public_key="1" * 64).findings
    assert other_key == [f"Expected the key {'1' * 64}, got {key}."], "said once, however long the chain is"
    secret = {"secret": "1" * 64, "commitment": make_commitment(bytes.fromhex("1" * 64))}
    published = changed(tmp_path, DESCRIPTION_NAME, lambda content: json.dumps(json.loads(content) | secret).encode())
    still = audit(published, episodes=1, seed=SEED).findings
    assert still == [], "results of the public list are not run again on the sealed one"
    other = audit(tmp_path / "board.zip", episodes=1, seed=SEED + 1)
    assert len(other.findings) == 1, "the other records are made up, which only the physics tells"
    assert "diverge" in other.findings[0].lower() or "differs" in other.findings[0].lower()
    with pytest.raises(ResultsNotWritten, match="Name a new file"), database.transaction() as session:
        export_receipts(session, NO_FILES, tmp_path / "board.zip", shown_stage(session, TRACK))


SCORE = "UPDATE {} SET success_rate = 1, mean_steps = 1 WHERE {}"
OF_LAST = "evaluation_id = (SELECT evaluation_id FROM receipts ORDER BY number DESC LIMIT 1)"
RECORD = """
    UPDATE episode_results SET record = jsonb_set(record, '{outcome}', '"success"'), outcome = 'success', success = true
    WHERE episode = 1 AND outcome <> 'success'
"""
SCORES = """
    UPDATE evaluations SET scores = jsonb_set(scores, '{0,successes}', '270') WHERE id =
    (SELECT evaluation_id FROM receipts ORDER BY number DESC LIMIT 1)
"""


BACKDATED = """
    UPDATE receipts SET entry = regexp_replace(entry, 'issued_at":"[^"]*"', 'issued_at":"2020-01-01T00:00:00Z"')
    WHERE number = 4
"""
SWAPPED_NAMES = """
    UPDATE teams SET name = CASE name WHEN 'Ants' THEN 'Bees' ELSE 'Ants' END WHERE name IN ('Ants', 'Bees')
"""
SWAPPED = """
    UPDATE {table} SET team_id = (SELECT max(id::text)::uuid FROM teams WHERE name IN ('Ants', 'Bees')
    AND id <> {table}.team_id) WHERE team_id IN (SELECT id FROM teams WHERE name IN ('Ants', 'Bees'))
"""
SWAPPED_SUBMISSIONS, SWAPPED_RESULTS = SWAPPED.format(table="submissions"), SWAPPED.format(table="board_results")
REMOVED_WINNER = "DELETE FROM board_results WHERE team_id = (SELECT id FROM teams WHERE name = 'Ants')"
REMOVED_SUBMISSION = REMOVED_WINNER.replace("board_results", "submissions")


@pytest.mark.parametrize(
    ("statements", "finding"),
    [
        ([SCORES], "Cats: successes of peg-insertion is 270 on the board, 260 in the receipt"),
        (["UPDATE submissions SET submitted_at = '2020-01-01Z' WHERE name = 'zero'"], "submission time"),
        ([RECORD], "Bees, peg-insertion: the records have another result hash than the receipt"),
        (["DELETE FROM episode_results WHERE episode = 9"], "the first missing one is 9"),
        (["DELETE FROM receipts WHERE number = 6"], "Cats: there is no receipt"),
        (["UPDATE receipts SET content = replace(content, '260', '261')"], "The result of receipt 6 was changed"),
        (
            [
                "UPDATE receipts SET number = 9 WHERE number = 2",
                "UPDATE receipts SET number = 2 WHERE number = 3",
                "UPDATE receipts SET number = 3 WHERE number = 9",
            ],
            "Expected entry 2 of the log, got 3",
        ),
        (
            ["UPDATE receipts SET leaf_hash = sha256('') WHERE number = 3"],
            "Expected 6 entries in the log with the root",
        ),
        ([SWAPPED_NAMES], "Ants: receipt 4 was issued to another team"),
        ([SWAPPED_SUBMISSIONS, SWAPPED_RESULTS], "Bees: receipt 2 was issued to another team"),
        ([REMOVED_WINNER], "Ants: receipt 2 is of this board, but the team is not on it"),
        ([REMOVED_WINNER, "UPDATE submissions SET stage = 'other'"], "is not on it"),
        ([REMOVED_WINNER, REMOVED_SUBMISSION], "Receipt 2 is of a result that the export gives to no team"),
        (
            ["UPDATE receipts SET entry = replace(entry, '_1//', '_2//') WHERE number = 1"],
            "another board than its entry",
        ),
        (["UPDATE receipt_key SET public_key = repeat('1', 64)"], "The checkpoint is of another log"),
        ([BACKDATED], "Receipt 4 has another issued_at than its entry"),
        ([BACKDATED], "before receipt 3, which it follows"),
        (
            ["UPDATE receipts SET content = replace(content, '\"model\"', '\"log\"') WHERE number = 1"],
            "The submission of receipt 1 was changed",
        ),
    ],
)
def test_a_tampered_database_is_found(
    database: Database, tmp_path: Path, statements: Sequence[str], finding: str
) -> None:
    findings = audited(database, tmp_path, *map(text, statements)).findings
    assert any(finding in each for each in findings), findings


def test_a_log_with_a_gap_has_no_checkpoint(database: Database, tmp_path: Path) -> None:
    with pytest.raises(ProofRejected, match="Tile 0 of level 0: expected 6 hashes, got 5"):
        audited(database, tmp_path, text("DELETE FROM receipts WHERE number = 2"))


def test_a_removed_last_receipt_is_found_by_a_root_that_was_noted(database: Database, tmp_path: Path) -> None:
    with database.transaction() as session:
        state = log.read_log_state(session)
    noted = {state.receipts: state.root}
    assert audited(database, tmp_path, noted=noted).findings == []
    (tmp_path / "board.zip").unlink()
    removed = [
        "DELETE FROM receipts WHERE number >= 5",
        "DELETE FROM board_results WHERE team_id = (SELECT id FROM teams WHERE name = 'Cats')",
    ]
    found = audited(database, tmp_path, *map(text, removed))
    assert found.findings == [], "in itself what is left is right"
    told = audit(tmp_path / "board.zip", episodes=0, noted=noted).findings
    assert told == [f"Expected at least 6 entries with the noted root {state.root}, got 4: the log ends before."]
    other = audit(tmp_path / "board.zip", episodes=0, noted={2: "0" * 64}).findings
    assert "Expected the noted root 000" in other[0]
    shortened = changed(tmp_path, LOG_NAME, lambda content: b"".join(content.splitlines(keepends=True)[:-1]))
    assert "Expected 4 entries in the log with the root" in audit(shortened, episodes=0).findings[0]


def test_what_organizers_did_with_teams_is_told_and_is_no_finding(database: Database, tmp_path: Path) -> None:
    def renamed(session: Session) -> None:
        teams.rename(session, CONSOLE, teams.find(session, "Ants"), "Moths")
        teams.disqualify(session, CONSOLE, teams.find(session, "Bees"), "two accounts")
        team_data.erase(session, CONSOLE, teams.find(session, "Cats"))

    found = audited(database, tmp_path, renamed)
    assert found.findings == []
    assert found.unchecked[0] == (
        "Moths: receipt 2 was issued to 'Ants'; the service says that this team was renamed or merged."
    )
    assert "the service says that the team's names were deleted" in " ".join(found.unchecked)
    assert "Bees: receipt 4; the service leaves the team out: disqualified, two accounts." in found.unchecked
    assert "Cats" not in (tmp_path / "board.zip").read_bytes().decode("latin-1")
    with zipfile.ZipFile(tmp_path / "board.zip") as export:
        assert b"Cats" not in export.read(DESCRIPTION_NAME), "no name of a team that was removed"
    (tmp_path / "board.zip").unlink()

    def merged(session: Session) -> None:
        teams.rename(session, CONSOLE, teams.find(session, "Bees"), "Wasps")
        merging.merge(session, CONSOLE, teams.find(session, "Wasps"), teams.find(session, "Ants"))

    found = audited(database, tmp_path, merged)
    assert found.findings == []
    assert found.unchecked == [
        "Ants: receipt 4 was issued to 'Bees'; the service says that this team was renamed or merged."
    ]


def test_a_policy_that_failed_in_a_rejudgement_is_told_and_is_no_finding(database: Database, tmp_path: Path) -> None:
    def rejudged(session: Session) -> None:
        chosen = session.scalars(select(Submission.id).join(Team).where(Team.name == "Ants")).all()
        made = rejudging.start(session, CONSOLE, shown_stage(session, TRACK), submissions=chosen, reason="in doubt")
        failed = {"state": EvaluationState.FAILED, "verdict_code": "crashed", "finished_at": func.now()}
        session.execute(update(Evaluation).where(Evaluation.rejudgement_id == made.id).values(failed))
        rejudging.apply(session, CONSOLE, made.id)

    found = audited(database, tmp_path, rejudged)
    assert found.findings == []
    assert found.entries == len(TEAMS) - 1
    why = "the service says that a rejudgement took it away."
    assert found.unchecked == [f"Ants: receipt 2 is of this board, but the team is not on it; {why}"]


def test_a_board_of_models_that_is_given_out_as_one_of_logs_is_found(database: Database, tmp_path: Path) -> None:
    """Else a service could hide a model's better result as the copy of a log."""
    audited(database, tmp_path)

    def of_logs(content: bytes) -> bytes:
        return json.dumps(json.loads(content) | {"kind": "log"}).encode()

    found = audit(changed(tmp_path, DESCRIPTION_NAME, of_logs), episodes=0)
    assert found.findings == [f"{team}: kind is log on the board, model in the receipt." for team in TEAMS]


def test_exports_of_another_format_are_refused_by_name(database: Database, tmp_path: Path) -> None:
    audited(database, tmp_path)
    with zipfile.ZipFile(tmp_path / "board.zip") as export:
        described = json.loads(export.read(DESCRIPTION_NAME))

    def written(content: object) -> Path:
        return changed(tmp_path, DESCRIPTION_NAME, lambda _: json.dumps(content).encode())

    newer = described | {"format": "vitac-receipts-3", "witnesses": 3}
    with pytest.raises(ExportRejected, match=r"got the format 'vitac-receipts-3'.*release that wrote it"):
        audit(written(newer))
    for damaged in (described | {"format": 4}, [described], {"made_at": "now"}, described | {"format": "x" * 10_000}):
        with pytest.raises(ExportRejected, match=r"^export\.json: ") as refused:
            audit(written(damaged))
        assert len(str(refused.value)) < 400


def test_a_whole_new_log_is_found_by_its_key_and_by_a_receipt_that_was_stored(
    database: Database, tmp_path: Path
) -> None:
    with database.transaction() as session:
        key, stored = log.read_log_state(session).public_key, tmp_path / "stored.json"
        (old,) = issuing.receipts_of_submission(session, submission_of(session, "Ants"))
        stored.write_text(old.model_dump_json())
    other = old.result.model_copy(update={"evaluator_hash": "ee" * 32})
    entry = other.entry(2)
    rewritten = {"entry": entry.leaf().decode(), "leaf_hash": entry.leaf_hash, "content": other.model_dump_json()}
    statements = [
        update(ReceiptRow).where(ReceiptRow.number == 2).values(rewritten),
        update(ReceiptKey).values(private_key=KEY.hex(), public_key=PUBLIC_KEY),
    ]
    assert audited(database, tmp_path, *statements).findings == [], "in itself the new log is right"
    assert "Expected the key" in audit(tmp_path / "board.zip", episodes=0, public_key=key).findings[0]
    told = audit(tmp_path / "board.zip", episodes=0, held=read_receipts(stored)).findings
    assert told[0] == "Receipt 2, which was stored elsewhere, is not in the log."
    assert "the log was rewritten" in told[1]


def submission_of(session: Session, team: str) -> UUID:
    """The submission of a team."""
    return session.scalars(select(Submission.id).join(Team).where(Team.name == team)).one()


def test_what_is_no_export_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "board.zip"
    for content in (b"", b"PK\3\4 and no more"):
        file.write_bytes(content)
        with pytest.raises(ExportRejected, match="cannot be read as an export"):
            audit(file)
    with pytest.raises(ExportRejected, match="cannot be read"):
        audit(tmp_path / "missing.zip")


HOUR = timedelta(hours=1)
ADDED_LATER = """
    DELETE FROM receipts WHERE number >= 5;
    UPDATE submissions SET submitted_at = submitted_at - interval '1 hour'
    WHERE team_id = (SELECT id FROM teams WHERE name = 'Cats');
    UPDATE board_results SET submitted_at = submitted_at - interval '1 hour'
    WHERE team_id = (SELECT id FROM teams WHERE name = 'Cats');
"""


def added_later(issued_earlier: timedelta) -> Callable[[Session], None]:
    """A submission of the Cats that is said to have come before all others; the service signs what it is asked to."""

    def add(session: Session) -> None:
        for statement in ADDED_LATER.split(";")[:3]:
            session.execute(text(statement))
        session.expire_all()
        submission = session.scalars(select(Submission).join(Team).where(Team.name == "Cats")).one()
        evaluation = newest_evaluation(session, submission)
        real = log.append

        def issue(session: Session, make: Callable[[datetime], Content], **of: Any) -> None:
            real(session, lambda at: make(at - issued_earlier), **of)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(issuing, "append", issue)
            issuing.issue_for_submission(session, submission)
            issuing.issue_for_result(session, evaluation, combined_result(evaluation))

    return add


def test_a_submission_that_was_added_afterwards_is_found_whatever_time_its_receipts_have(
    database: Database, tmp_path: Path
) -> None:
    backdated = audited(database, tmp_path, added_later(HOUR)).findings
    assert len(backdated) == 1
    assert "Receipt 5 was issued at" in backdated[0]
    assert "before receipt 4, which it follows" in backdated[0]
    (tmp_path / "board.zip").unlink()
    honest = audited(database, tmp_path, added_later(timedelta())).findings
    assert len(honest) == 1
    assert "Receipt 5 of submission" in honest[0]
    assert "but the submission is said to have arrived at" in honest[0]


def test_a_board_whose_records_are_missing_is_not_believed(database: Database, tmp_path: Path) -> None:
    found = audited(database, tmp_path, text("DELETE FROM episode_results"))
    assert (found.findings, found.logs, found.is_believed) == ([], 0, False)
    assert len(found.unchecked) == len(TEAMS)
    (tmp_path / "board.zip").unlink()
    of_winner = "DELETE FROM episode_results e USING evaluations v, submissions s, teams t WHERE {}"
    joined = "e.submission_digest = s.digest AND v.submission_id = s.id AND s.team_id = t.id AND t.name = 'Ants'"
    found = audited(database, tmp_path, text(of_winner.format(joined)))
    assert (found.findings, found.logs, found.unverified) == ([], 2, ["Ants"])
    assert not found.is_believed, "the first rank may be anybody's"


def test_a_published_secret_has_to_fit_the_commitment(database: Database, tmp_path: Path) -> None:
    audited(database, tmp_path)
    secret, other = "1" * 64, "2" * 64
    fits = make_commitment(bytes.fromhex(secret))

    def published(**values: str) -> list[str]:
        path = changed(tmp_path, DESCRIPTION_NAME, lambda content: json.dumps(json.loads(content) | values).encode())
        return audit(path, episodes=0).findings

    assert published(secret=secret, commitment=fits) == []
    assert published(secret=other, commitment=fits) == [
        f"The published secret has the commitment {make_commitment(bytes.fromhex(other))}, expected {fits}."
    ]
