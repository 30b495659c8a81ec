from uuid import UUID

from asked_playbacks import Played, played
from service_factories import TASK, complete_scored, make_score
from vitac.server.database.models import Submission
from vitac.server.leaderboards.public_pages import set_public
from vitac.server.playbacks.comparisons import list_choices


def choices(team: Played, number: int = 2, best: UUID | None = None) -> list[tuple[str, int]]:
    with team.database.transaction() as session:
        found = list_choices(session, team.by, team.submission.id, TASK, number, best=best)
    return [(choice.label, choice.episode) for choice in found]


def test_offers_the_same_start_of_public_submissions_and_that_of_private_ones_is_not(team_a: Played) -> None:
    team_b = played(team_a.database, "Team B", "other content")
    assert [label for label, _ in choices(team_a) if label.startswith("Team B")] == []
    with team_b.database.transaction() as session:
        complete_scored(session, session.get_one(Submission, team_b.submission.id), {TASK: make_score(80)})
        set_public(session, team_b.by, team_b.submission.id, public=True)
    assert [episode for label, episode in choices(team_a) if label.startswith("Team B: ")] == [2]


def test_who_leads_the_board_comes_first_and_is_named(team_a: Played) -> None:
    others = [played(team_a.database, f"Team {name}", f"content {name}") for name in "BC"]
    with team_a.database.transaction() as session:
        for other in others:
            complete_scored(session, session.get_one(Submission, other.submission.id), {TASK: make_score(80)})
            set_public(session, other.by, other.submission.id, public=True)
    for leader in others:
        first, second, *_ = (label for label, _ in choices(team_a, best=leader.submission.id))
        assert first.endswith(", first of the board")
        assert not second.endswith("board")
        assert first != second


def test_other_episodes_of_the_submission_are_offered(team_a: Played) -> None:
    own = [episode for label, episode in choices(team_a) if label.startswith("this submission")]
    assert own
    assert 2 not in own
