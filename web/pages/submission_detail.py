"""What the page of a submission and its files show; read in one transaction."""

from collections.abc import Sequence
from dataclasses import dataclass
from uuid import UUID

from sqlalchemy.orm import Session
from vitac.server.evaluations.action_matches import read_matches
from vitac.server.evaluations.history import histories
from vitac.server.leaderboards.history import past_results
from vitac.server.leaderboards.public_pages import readable
from vitac.server.principals import Principal
from vitac.server.settings import Settings
from vitac.server.submissions import files, listing
from vitac.server.submissions.listing import make_card, submission_views
from vitac.server.views.leaderboards import PastResultView
from vitac.server.views.receipts import ActionMatchView
from vitac.server.views.submissions import EpisodeView, ModelCardView, SubmissionView


@dataclass(frozen=True, kw_only=True)
class SubmissionDetail:
    """What the page of a submission shows.

    Attributes:
        submission: with its newest evaluation.
        episodes: outcomes of the finished episodes of that evaluation.
        practice_episodes: those on the public list, where it was played beside a sealed one.
        action_matches: how many of a log's actions the team's models give; empty for other submissions.
        episodes_with_output: number of episodes with output, or in which the policy failed, that the visitor may see.
        past: results of the team in the tasks of this submission; empty before the submission has a result.
        card: of a model.
    """

    submission: SubmissionView
    episodes: Sequence[EpisodeView]
    action_matches: Sequence[ActionMatchView]
    episodes_with_output: int
    past: Sequence[PastResultView]
    practice_episodes: Sequence[EpisodeView] = ()
    card: ModelCardView | None = None


def read_detail(session: Session, settings: Settings, by: Principal, submission_id: UUID) -> SubmissionDetail:
    """Return one submission with its episodes.

    Raises:
        ServiceError: the principal may not see it; a visitor is asked for a token.
    """
    row = readable(session, by, submission_id)
    evaluations = histories(session, [row], with_output=True)
    shown, is_own = evaluations[submission_id][0], by.may_see(row.team_id, row.competition)
    view = submission_views(session, settings, evaluations, by, with_output=True)[0]
    return SubmissionDetail(
        submission=view,
        episodes=listing.list_episodes(session, by, shown),
        action_matches=read_matches(session, by, shown) if is_own else (),
        episodes_with_output=files.episodes_with_output(session, by, shown),
        practice_episodes=listing.list_episodes(session, by, shown, practice=True),
        past=past_results(session, by, shown) if is_own else (),
        card=make_card(session, by, shown) if row.kind.form.has_card else None,
    )
