from uuid import uuid4

from service_factories import (
    TASK,
    claim,
    make_record,
    make_settings,
    store,
    take_away,
)
from submission_steps import ids_of
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission
from vitac.server.evaluations.view import list_evaluations
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions.listing import get, list_submissions
from vitac.server.views.evaluations import DifferingEpisodeView

SETTINGS = make_settings()
FIRST, OTHER = make_record(3), make_record(3, EpisodeOutcome.STEPS)


def alarms(database: Database, submission: Submission, by: Principal = CONSOLE) -> list[DifferingEpisodeView] | None:
    with database.transaction() as session:
        return get(session, SETTINGS, by, submission.id).evaluation.differing_episodes


def test_episode_that_differs_from_the_stored_one_alarms_the_organizers(
    database: Database, submission: Submission
) -> None:
    shard_id, second_worker = ids_of(database, submission)[0], uuid4()
    store(database, claim(database, shard_id), [FIRST])
    take_away(database, shard_id)
    store(database, claim(database, shard_id, second_worker), [OTHER])
    (alarm,) = alarms(database, submission) or []
    assert (alarm.task, alarm.episode, alarm.worker_id) == (TASK, 3, second_worker)
    assert (alarm.stored_digest, alarm.differing_digest) == (FIRST.record_digest(), OTHER.record_digest())
    with database.transaction() as session:
        assert [row.differing_episodes for row in list_evaluations(session, limit=10)] == [1]
        (listed,) = list_submissions(session, SETTINGS, CONSOLE).items
        assert listed.evaluation.differing_episodes == [alarm]


def test_episode_that_repeats_itself_alarms_nobody(database: Database, submission: Submission) -> None:
    store(database, claim(database, ids_of(database, submission)[0]), [FIRST, FIRST])
    assert alarms(database, submission) == []
    with database.transaction() as session:
        assert [row.differing_episodes for row in list_evaluations(session, limit=10)] == [0]


def test_same_difference_is_told_once_and_another_one_beside_it(database: Database, submission: Submission) -> None:
    third = make_record(3, EpisodeOutcome.STEPS, total_reward=2.0)
    store(database, claim(database, ids_of(database, submission)[0]), [FIRST, OTHER, OTHER, third])
    found = alarms(database, submission) or []
    assert [alarm.differing_digest for alarm in found] == [OTHER.record_digest(), third.record_digest()]
    with database.transaction() as session:
        assert [row.differing_episodes for row in list_evaluations(session, limit=10)] == [1]


def test_team_is_not_told(database: Database, submission: Submission, principal: Principal) -> None:
    store(database, claim(database, ids_of(database, submission)[0]), [FIRST, OTHER])
    assert alarms(database, submission, by=principal) is None
