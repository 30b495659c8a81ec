import pytest
from service_factories import (
    LOCK,
    TASK,
    TRACK,
    claim,
    complete_scored,
    make_failed_record,
    make_principal,
    make_record,
    make_score,
    play,
    play_public_list,
    shard_ids,
    store,
    submit,
    submit_refuted_log,
)
from sqlalchemy import select, update
from submission_steps import SETTINGS, refused
from vitac.evaluator.tracks import ListKind, load_track
from vitac.evaluator.tracks.sealed import make_commitment, sealed_track
from vitac.server.audit import newest_entries
from vitac.server.competitions import sealing
from vitac.server.competitions.competition import Competition
from vitac.server.database.engine import Database
from vitac.server.database.models import EpisodeResult, Evaluation, Submission
from vitac.server.database.states import Role
from vitac.server.errors import ProblemCode
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.action_matches import action_matches
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.logs import export_log
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import listing
from vitac.server.submissions.files import episode_outputs
from vitac.server.visibility import EvaluationVisibility, decide_sight

from competitions import stored_stage

STAGE = "final"
JUDGE = Principal(role=Role.JUDGE)


@pytest.fixture
def sealed(database: Database, principal: Principal) -> Submission:
    """A submission whose evaluation plays the sealed list of a stage."""
    with database.transaction() as session:
        sealing.seal(session, CONSOLE, stored_stage(session, TRACK, STAGE), b"\1" * 32)
        submission = submit(session, principal)
        lifecycle.cancel(session, newest_evaluation(session, submission))
        session.execute(update(Submission).values(stage=STAGE))
    with database.transaction() as session:
        found = session.get_one(Submission, submission.id)
        lifecycle.start(session, found, 1)
        return found


def reveal(database: Database) -> None:
    with database.transaction() as session:
        sealing.reveal(session, CONSOLE, stored_stage(session, TRACK, STAGE))


def complete(database: Database, submission: Submission) -> None:
    with database.transaction() as session:
        complete_scored(session, session.get_one(Submission, submission.id), {TASK: make_score(60)})


def test_a_stage_is_sealed_once_and_its_commitment_does_not_change(database: Database) -> None:
    with database.transaction() as session:
        made = sealing.seal(session, CONSOLE, stored_stage(session, TRACK, STAGE))
        assert make_commitment(bytes.fromhex(made.secret)) == made.commitment
        assert sealing.seal(session, CONSOLE, stored_stage(session, TRACK, STAGE)).commitment == made.commitment
        assert sealing.seal(session, CONSOLE, stored_stage(session, TRACK, STAGE), bytes.fromhex(made.secret)) is made
        assert [entry.action for entry in newest_entries(session)] == ["list.seal"]
        assert made.secret not in str(newest_entries(session)[0].after)
    with refused(ProblemCode.LIST_SEALED), database.transaction() as session:
        sealing.seal(session, CONSOLE, stored_stage(session, TRACK, STAGE), b"\2" * 32)


def test_other_stages_have_other_secrets(database: Database) -> None:
    with database.transaction() as session:
        one, two, three = (stored_stage(session, TRACK, name) for name in ("one", "two", "three"))
        first, second = (sealing.seal(session, CONSOLE, stage) for stage in (one, two))
        assert first.secret != second.secret
        assert [found.stage for found in sealing.sealed_lists(session, Competition.read(session))] == ["one", "two"]
        assert [stage.commitment for stage in (one, two, three)] == [first.commitment, second.commitment, None]


@pytest.mark.parametrize("by", [JUDGE, Principal(role=Role.TEAM)])
def test_only_organizers_seal_and_reveal(database: Database, by: Principal) -> None:
    for change in (sealing.seal, sealing.reveal):
        with refused(ProblemCode.FORBIDDEN), database.transaction() as session:
            change(session, by, stored_stage(session, TRACK, STAGE))


def test_an_evaluation_of_the_stage_plays_the_sealed_list(database: Database, sealed: Submission) -> None:
    lease = claim(database, play_public_list(database, sealed)[0])
    assert lease.commitment == make_commitment(b"\1" * 32)
    store(database, lease, [make_record(1)])
    with database.transaction() as session:
        assert session.scalars(select(EpisodeResult.commitment).distinct()).all() == ["", lease.commitment]
        assert sealing.find_secret(session, lease.commitment or "") == b"\1" * 32


def test_episodes_of_the_public_list_are_not_those_of_the_sealed_one(
    database: Database, sealed: Submission, principal: Principal
) -> None:
    with database.transaction() as session:
        public = submit(session, principal)
        assert public.id != sealed.id
        assert public.digest == sealed.digest
    for shard in (ids(database, public)[0], play_public_list(database, sealed)[0]):
        store(database, claim(database, shard), [make_record(1)])
    with database.transaction() as session:
        of_first = EpisodeResult.episode == 1
        assert len(session.scalars(select(EpisodeResult.id).where(of_first)).all()) == 2


def ids(database: Database, submission: Submission) -> list[int]:
    with database.transaction() as session:
        return shard_ids(session, submission)


def view(database: Database, by: Principal, submission: Submission) -> tuple[object, ...]:
    """What is shown of progress, verdict and printed output."""
    with database.transaction() as session:
        shown = listing.get(session, SETTINGS, by, submission.id).evaluation
        ends = listing.episodes(session, by, submission.id)
    verdict = shown.verdict and (shown.verdict.code, shown.verdict.episode)
    return shown.progress.successes, verdict, shown.log_tail, len(ends), shown.episodes_hidden


def test_a_team_sees_no_single_episode_of_a_running_evaluation(
    database: Database, principal: Principal, sealed: Submission
) -> None:
    lease = claim(database, play_public_list(database, sealed)[0])
    store(database, lease, [make_record(1), make_failed_record(2, output="what it observed")])
    for by in (principal, JUDGE):
        assert view(database, by, sealed) == (None, None, "", 0, True)
    assert view(database, CONSOLE, sealed) == (271, None, "what it observed", 2, False)


def test_progress_on_a_sealed_list_is_told_in_tenths(
    database: Database, principal: Principal, sealed: Submission
) -> None:
    first, second, *_ = ids(database, sealed)
    play(database, first)
    lease = claim(database, second)
    shown = []
    for last in (53, 54):  # of 270 on each list
        store(database, lease, [make_record(number) for number in lease.episodes if number <= last])
        with database.transaction() as session:
            evaluation = listing.get(session, SETTINGS, principal, sealed.id).evaluation
            assert (evaluation.progress.tasks, evaluation.eta_s) == ([], None)
            shown.append(evaluation.progress.episodes_done)
            full = listing.get(session, SETTINGS, CONSOLE, sealed.id).evaluation.progress
            assert (full.episodes_done, [task.episodes_done for task in full.tasks]) == (last, [last])
    assert shown == [0, 54]


def test_a_verdict_tells_a_team_its_code_only(database: Database, principal: Principal, sealed: Submission) -> None:
    with database.transaction() as session:
        evaluation = newest_evaluation(session, session.get_one(Submission, sealed.id))
        evaluation.verdict_task, evaluation.verdict_episode = TASK, 17
        lifecycle.fail_by_machines(session, evaluation, "what it observed")
    with database.transaction() as session:
        verdict = listing.get(session, SETTINGS, principal, sealed.id).evaluation.verdict
        assert verdict is not None
        assert (verdict.code, verdict.task, verdict.episode) == ("machine_failed", None, None)
        assert "what it observed" not in verdict.model_dump_json()
        full = listing.get(session, SETTINGS, CONSOLE, sealed.id).evaluation.verdict
        assert full is not None
        assert (full.episode, full.message) == (17, "what it observed")


def test_what_was_found_against_a_log_is_not_shown_on_a_sealed_list(
    database: Database, principal: Principal, sealed: Submission
) -> None:
    with database.transaction() as session:
        log = submit_refuted_log(session, principal, "log")
        newest_evaluation(session, log).commitment = stored_stage(session, TRACK, STAGE).commitment
    with database.transaction() as session:
        of_team, full = (listing.get(session, SETTINGS, by, log.id).log for by in (principal, CONSOLE))
    assert of_team is not None
    assert full is not None
    assert (of_team.reason, of_team.divergence) == (None, None)
    assert full.divergence is not None


def test_a_final_score_is_shown_and_its_episodes_after_the_reveal(
    database: Database, principal: Principal, sealed: Submission
) -> None:
    store(database, claim(database, play_public_list(database, sealed)[0]), [make_record(1)])
    complete(database, sealed)
    with database.transaction() as session:
        shown = listing.get(session, SETTINGS, principal, sealed.id).evaluation
        assert (shown.success_rate, shown.progress.successes, shown.list_kind) == (0.3, 60, ListKind.SEALED)
        with refused(ProblemCode.LIST_SEALED):
            export_log(session, principal, sealed.id, None)
        with refused(ProblemCode.FORBIDDEN):
            episode_outputs(session, principal, sealed.id)
        assert action_matches(session, principal, sealed.id) == []
    reveal(database)
    with database.transaction() as session:
        assert len(listing.episodes(session, principal, sealed.id)) == 1
        assert episode_outputs(session, principal, sealed.id).items == []
        assert not listing.get(session, SETTINGS, principal, sealed.id).evaluation.episodes_hidden


def test_nothing_is_revealed_while_an_evaluation_runs(database: Database, sealed: Submission) -> None:
    with refused(ProblemCode.LIST_SEALED):
        reveal(database)
    complete(database, sealed)
    reveal(database)
    reveal(database)
    with database.transaction() as session:
        assert [entry.action for entry in newest_entries(session)].count("list.reveal") == 1
    with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
        sealing.reveal(session, CONSOLE, stored_stage(session, TRACK, "another"))


def test_sight_is_by_role_and_list(database: Database, principal: Principal, sealed: Submission) -> None:
    with database.transaction() as session:
        other = make_principal(session, "Team B")
        public = newest_evaluation(session, submit(session, principal, tasks=(TASK, LOCK)))
        hidden = session.scalars(select(Evaluation).where(Evaluation.commitment.is_not(None))).one()
        everything = EvaluationVisibility(episodes=True, output=True, practice=True)
        practice = EvaluationVisibility(episodes=False, output=False, practice=True)
        nothing = EvaluationVisibility(episodes=False, output=False, practice=False)
        seen = {by: (decide_sight(by, public), decide_sight(by, hidden)) for by in (CONSOLE, principal, JUDGE, other)}
    assert seen == {
        CONSOLE: (everything, everything),
        principal: (everything, practice),
        JUDGE: (everything, practice),
        other: (nothing, nothing),
    }


def test_an_episode_is_played_back_with_the_seed_of_its_list(database: Database) -> None:
    with database.transaction() as session:
        made = sealing.seal(session, CONSOLE, stored_stage(session, TRACK, STAGE), b"\1" * 32)
        derived = sealed_track(load_track(TRACK), b"\1" * 32).tasks[TASK].episode_list.list_seed
        assert sealing.derive_list_seed(session, made.commitment, TRACK, TASK) == derived
        assert sealing.derive_list_seed(session, "", TRACK, TASK) is None
        assert derived != load_track(TRACK).tasks[TASK].episode_list.list_seed
