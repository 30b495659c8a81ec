import pytest
from service_factories import (
    TASK,
    TRACK,
    make_principal,
    make_record,
    make_upload,
    play_all,
    submit_refuted_log,
)
from vitac.evaluator.episodes.records import EpisodeRecord, Timings
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.leaderboards.public_pages import set_public
from vitac.server.principals import VISITOR
from vitac.server.submissions import creation
from vitac.server.submissions.listing import model_card

CONTENTS = {"frameworks": ["torch"], "code_bytes": 100, "weights_bytes": 2000, "blank_answers": []}


def slow_record(episode: int, *, task: str) -> EpisodeRecord:
    """An episode of three env steps, in which the policy took 6 ms."""
    return make_record(episode, task=task, timings=Timings(policy_s=0.006))


def test_a_card_says_what_manifest_archive_and_records_say(database: Database) -> None:
    with database.transaction() as session:
        by = make_principal(session)
        manifest = {"track": TRACK, "name": "zero", "observation_keys": ["relative_motion"]}
        submission = creation.create(session, by, make_upload(manifest=manifest, contents=CONTENTS))[0]
        set_public(session, by, submission.id, public=True)
        before = model_card(session, by, submission.id)
    play_all(database, submission, slow_record)
    with database.transaction() as session:
        card = model_card(session, VISITOR, submission.id)
    assert before.policy_ms is None
    assert card.policy_ms == pytest.approx(2.0)
    assert (card.tasks, card.observation_keys) == ([TASK], ["relative_motion"])
    assert card.contents is not None
    assert card.contents.model_dump() == CONTENTS


def test_what_was_uploaded_before_and_what_is_no_model_has_less_or_none(database: Database) -> None:
    with database.transaction() as session:
        by = make_principal(session)
        old = creation.create(session, by, make_upload())[0]
        assert model_card(session, by, old.id).contents is None
        log: Submission = submit_refuted_log(session, by, "log")
        with pytest.raises(ServiceError) as refused:
            model_card(session, by, log.id)
    assert refused.value.code is ProblemCode.UNSUPPORTED_SUBMISSION_KIND
