"""What of an evaluation is shown to whom: every combination of reader, publicity, list and kind."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import Any, cast
from uuid import uuid4

import pytest
from service_factories import LOCK, TASK, TRACK, make_principal, submit
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind, load_track
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation
from vitac.server.database.states import Role
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.visibility import (
    EvaluationVisibility,
    changeable,
    decide_sight,
    find_list_kind,
    is_sealed,
    played_list_kind,
    require_episodes,
    visible,
)

OURS = uuid4()
READERS = {
    "visitor": VISITOR,
    "own": Principal(role=Role.TEAM, team_id=OURS, team_name="Ours"),
    "other": Principal(role=Role.TEAM, team_id=uuid4(), team_name="Theirs"),
    "judge": Principal(role=Role.JUDGE, judge_name="Judge"),
    "organizer": CONSOLE,
}
OPEN, SEALED, REVEALED = "open", "sealed", "revealed"
NOTHING, PRACTICE, EPISODES, EVERYTHING = (
    EvaluationVisibility(episodes=False, output=False, practice=False),
    EvaluationVisibility(episodes=False, output=False, practice=True),
    EvaluationVisibility(episodes=True, output=False, practice=True),
    EvaluationVisibility(episodes=True, output=True, practice=True),
)


def evaluation(
    *,
    listed: str = OPEN,
    public: bool = False,
    kind: SubmissionKind = SubmissionKind.MODEL,
    tasks: tuple[str, ...] = (TASK,),
    commitment: str | None = None,
    list_kind: ListKind = ListKind.PUBLIC,
) -> Evaluation:
    """What the rules look at of an evaluation of our team."""
    sealed_list = None if listed == OPEN else SimpleNamespace(revealed_at=None if listed == SEALED else "a moment")
    if sealed_list is not None:
        commitment = "c" * 64  # the row of the list is found by it
    submission = SimpleNamespace(
        team_id=OURS, competition="", is_public=public, kind=kind, track=TRACK, tasks=list(tasks)
    )
    return cast(
        Evaluation,
        SimpleNamespace(submission=submission, sealed_list=sealed_list, commitment=commitment, list_kind=list_kind),
    )


SEEN = {
    # reader: (private, public) of an open or revealed list; then the same of a sealed one
    "visitor": ((NOTHING, EPISODES), (NOTHING, PRACTICE)),
    "own": ((EVERYTHING, EVERYTHING), (PRACTICE, PRACTICE)),
    "other": ((NOTHING, EPISODES), (NOTHING, PRACTICE)),
    "judge": ((EVERYTHING, EVERYTHING), (PRACTICE, PRACTICE)),
    "organizer": ((EVERYTHING, EVERYTHING), (EVERYTHING, EVERYTHING)),
}


@pytest.mark.parametrize("reader", READERS)
def test_what_is_shown_of_a_model(reader: str) -> None:
    for listed, public in product((OPEN, REVEALED, SEALED), (False, True)):
        found = decide_sight(READERS[reader], evaluation(listed=listed, public=public))
        assert found == SEEN[reader][listed == SEALED][public], (listed, public)


@pytest.mark.parametrize("kind", [SubmissionKind.LOG, SubmissionKind.TEXT_LOG])
@pytest.mark.parametrize("reader", READERS)
def test_nobody_sees_an_output_of_a_log_because_no_policy_ran(reader: str, kind: SubmissionKind) -> None:
    for listed, public in product((OPEN, REVEALED, SEALED), (False, True)):
        of_model = SEEN[reader][listed == SEALED][public]
        found = decide_sight(READERS[reader], evaluation(listed=listed, public=public, kind=kind))
        assert found == replace(of_model, output=False), (listed, public)


@pytest.mark.parametrize("reader", READERS)
def test_episodes_that_are_not_shown_are_refused_with_the_reason(reader: str) -> None:
    for listed in (OPEN, SEALED):
        asked = evaluation(listed=listed, public=True)
        if SEEN[reader][listed == SEALED][True].episodes:
            require_episodes(READERS[reader], asked)
            continue
        with pytest.raises(ServiceError) as refused:
            require_episodes(READERS[reader], asked)
        assert refused.value.code is ProblemCode.LIST_SEALED


def test_a_list_is_sealed_until_its_secret_is_published() -> None:
    assert [is_sealed(evaluation(listed=listed)) for listed in (OPEN, SEALED, REVEALED)] == [False, True, False]


def test_a_stage_or_a_task_of_the_file_can_have_a_sealed_list(monkeypatch: pytest.MonkeyPatch) -> None:
    both, one = (evaluation(tasks=tasks) for tasks in ((TASK, LOCK), (TASK,)))
    assert find_list_kind(both.submission) is ListKind.PUBLIC
    assert played_list_kind(evaluation(commitment="c" * 64)) is ListKind.SEALED
    track = load_track(TRACK)
    lock = track.tasks[LOCK]
    sealed = lock.model_copy(update={"episode_list": lock.episode_list.model_copy(update={"commitment": "c"})})
    changed = track.model_copy(update={"tasks": {**track.tasks, LOCK: sealed}})
    monkeypatch.setattr("vitac.server.tracks.load_track", lambda _: changed)
    assert find_list_kind(both.submission) is ListKind.SEALED, "one of its tasks is enough"
    assert find_list_kind(one.submission) is ListKind.PUBLIC
    assert is_sealed(evaluation(tasks=(LOCK,), list_kind=ListKind.SEALED))
    assert not is_sealed(evaluation(listed=REVEALED, tasks=(LOCK,))), "a stage's own list counts before the file's"


def test_a_list_that_was_removed_with_its_task_counts_as_sealed() -> None:
    removed = evaluation(tasks=(TASK, "gone"), list_kind=ListKind.SEALED)
    assert find_list_kind(removed.submission) is ListKind.SEALED
    assert not decide_sight(VISITOR, removed).episodes
    assert decide_sight(CONSOLE, removed).episodes
    require_episodes(CONSOLE, removed)


def test_the_kind_that_was_kept_counts_whatever_the_track_file_says_later(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.server.tracks.load_track", lambda _: pytest.fail("the track file was asked"))
    public, sealed = (evaluation(tasks=(TASK,), list_kind=kind) for kind in ListKind)
    assert (played_list_kind(public), played_list_kind(sealed)) == (ListKind.PUBLIC, ListKind.SEALED)
    assert decide_sight(READERS["own"], public) == EVERYTHING
    require_episodes(READERS["own"], public)
    assert is_sealed(evaluation(listed=SEALED, list_kind=ListKind.PUBLIC)), "the stage's secret counts first"
    assert not is_sealed(evaluation(listed=REVEALED, list_kind=ListKind.SEALED))


def test_a_sealed_list_of_the_file_opens_when_its_commitment_is_taken_out(monkeypatch: pytest.MonkeyPatch) -> None:
    played = evaluation(list_kind=ListKind.SEALED)
    track = load_track(TRACK)
    task = track.tasks[TASK]
    listed = task.model_copy(update={"episode_list": task.episode_list.model_copy(update={"commitment": "c"})})
    closed = track.model_copy(update={"tasks": {**track.tasks, TASK: listed}})
    for file, seen in ((closed, PRACTICE), (track, EVERYTHING)):
        monkeypatch.setattr("vitac.server.tracks.load_track", lambda _, file=file: file)
        assert is_sealed(played) is (seen == PRACTICE)
        assert decide_sight(READERS["own"], played) == seen
        assert played_list_kind(played) is ListKind.SEALED, "who could know it while it was played stays"
    assert is_sealed(evaluation(commitment="c" * 64, list_kind=ListKind.SEALED)), "of a stage whose secret is lost"
    gone = evaluation(tasks=(TASK, "gone"), list_kind=ListKind.SEALED)
    assert refused_code(require_episodes, READERS["own"], gone) is ProblemCode.LIST_SEALED


def refused_code(call: Any, *arguments: Any) -> ProblemCode | None:
    try:
        call(*arguments)
    except ServiceError as error:
        return error.code
    return None


def test_who_may_see_and_who_may_change_a_submission(database: Database) -> None:
    with database.transaction() as session:
        owner, other = make_principal(session), make_principal(session, "Team B")
        found = submit(session, owner).id
        readers = {"own": owner, "other": other, **{name: READERS[name] for name in ("visitor", "judge", "organizer")}}
        seen = {name: refused_code(visible, session, by, found) for name, by in readers.items()}
        changed = {name: refused_code(changeable, session, by, found) for name, by in readers.items()}
        absent = {refused_code(visible, session, by, uuid4()) for by in readers.values()}
    hidden = dict.fromkeys(("other", "visitor"), ProblemCode.NOT_FOUND)
    assert {name: code for name, code in seen.items() if code} == hidden
    assert {name: code for name, code in changed.items() if code} == {**hidden, "judge": ProblemCode.FORBIDDEN}
    assert absent == {ProblemCode.NOT_FOUND}, "one that is hidden looks like one that is not there"
