"""What the service takes of its witnesses, and what a stage that demands them waits for."""

from typing import Any

import pytest
from made_logs import publish
from made_receipts import KEY, PUBLIC_KEY, a_result
from pydantic import ValidationError
from service_factories import TRACK, make_principal, play_all, submit
from sqlalchemy import text
from sqlalchemy.orm import Session
from vitac.server.competitions.definition import CompetitionDefinition
from vitac.server.database.engine import Database
from vitac.server.decisions.finishing import finalize
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import CONSOLE
from vitac.server.receipts.issuing import receipts_of_submission
from vitac.server.receipts.witnesses import add_cosignatures, list_witness_views, list_witnessed_checkpoints
from vitac.server.transparency.log import make_checkpoint, read_log_key, read_tree
from vitac.server.transparency.notes import OF_LOG, OF_WITNESS, Checkpoint, VerifierKey, cosign

from competitions import make_competition, moved, open_now, put_in_place

PUBLIC = bytes.fromhex(PUBLIC_KEY)
WITNESS = VerifierKey(name="ants.example/v", kind=OF_WITNESS, public_key=PUBLIC)
SECOND = VerifierKey(name="bees.example/v", kind=OF_WITNESS, public_key=PUBLIC)


def witnessed_cup(demanded: int = 1, *keys: VerifierKey) -> dict[str, Any]:
    """A competition of one stage with witnesses."""
    content = make_competition(witnesses=[str(key) for key in keys or (WITNESS, SECOND)])
    del content["tracks"][TRACK]["stages"][1]
    content["tracks"][TRACK]["stages"][0]["witnesses"] = demanded
    return content


def signed(session: Session, *by: VerifierKey, at: int = 1_600_000_000) -> Checkpoint:
    """The newest checkpoint with lines of witnesses."""
    checkpoint = make_checkpoint(session, read_tree(session))
    return checkpoint.with_signatures(cosign(KEY, key.name, checkpoint, at) for key in by)


def test_a_stage_waits_for_its_witnesses_and_a_receipt_shows_them(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, open_now(witnessed_cup(demanded=2)))
        submission = submit(session, make_principal(session))
    play_all(database, submission)
    with database.transaction() as session:
        put_in_place(session, moved(witnessed_cup(demanded=2), days=-3650))
        assert [(view.size, view.behind) for view in list_witness_views(session)] == [(0, 2), (0, 2)]
        assert all(view.behind_s > 0 for view in list_witness_views(session))
        with pytest.raises(ServiceError, match=r"Expected 2 witnesses that have signed entry 2 of the log, .*, got 0"):
            finalize(session, CONSOLE)
        assert add_cosignatures(session, str(signed(session, WITNESS))) == 1
        with pytest.raises(ServiceError, match="got 1"):
            finalize(session, CONSOLE)
        assert add_cosignatures(session, str(signed(session, WITNESS, SECOND))) == 2, "also what is there already"
        finalize(session, CONSOLE)
        receipt = receipts_of_submission(session, submission.id)[0]
        receipt.require_valid(read_log_key(session).public_key.hex())
        assert set(receipt.find_witnesses([WITNESS, SECOND])) == {WITNESS, SECOND}
        assert [proof.checkpoint.size for proof in receipt.parsed_proofs()] == [4, 2], "the newest, and the witnessed"
        assert [checkpoint.size for checkpoint in list_witnessed_checkpoints(session)] == [2]
        assert [view.behind for view in list_witness_views(session)] == [2, 2], "the board and the end"


def test_signatures_of_strangers_of_tomorrow_and_of_another_history_are_refused(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, open_now(witnessed_cup(1, SECOND)))
        submit(session, make_principal(session))
        for note, named in ((signed(session), "of no line"), (signed(session, WITNESS), WITNESS.name)):
            with pytest.raises(ServiceError, match=f"No competition .* names the witness {named}") as refused:
                add_cosignatures(session, str(note))
            assert refused.value.code is ProblemCode.UNKNOWN_WITNESS, "no hint about tokens follows"
        with pytest.raises(ServiceError, match="Expected a signature of now, got one of 2286-11-20 17:46Z: set the"):
            add_cosignatures(session, str(signed(session, SECOND, at=9_999_999_999)))
        with pytest.raises(ServiceError, match="Expected a checkpoint"):
            add_cosignatures(session, "hello")
        with pytest.raises(ServiceError, match="of another log"):
            add_cosignatures(session, publish([a_result().entry(1)])["checkpoint"].decode())
        before = signed(session, SECOND)
        submit(session, make_principal(session, "Bees"), "other")
        after = signed(session, SECOND)
        session.execute(text("SET LOCAL session_replication_role = replica"))
        session.execute(text("DELETE FROM receipts WHERE number = 2"))
        with pytest.raises(ServiceError, match="signed a log of 2 entries that is not the beginning"):
            add_cosignatures(session, str(after))
        assert add_cosignatures(session, str(before)) == 1


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (witnessed_cup(3), "demands 3 witnesses, expected at most the 2"),
        (witnessed_cup(1, VerifierKey(name="a", kind=OF_LOG, public_key=PUBLIC)), "expected keys of witnesses"),
        (witnessed_cup(1, WITNESS, WITNESS), "there are two witness keys"),
        (make_competition(witnesses=["ants"]), "Expected a key as NAME"),
    ],
)
def test_a_competition_names_its_witnesses_by_their_keys(content: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValidationError, match=reason):
        CompetitionDefinition.model_validate(content)
