"""Submissions with finished episodes, and playbacks of them that somebody asked for."""

from dataclasses import dataclass
from typing import Any

from service_factories import TASK, make_principal, make_settings, play, shard_ids, submit
from vitac.server.database.engine import Database
from vitac.server.database.models import EpisodeResult, Playback, Submission
from vitac.server.playbacks.asking import ask, find_episode, find_playback
from vitac.server.principals import Principal

SETTINGS = make_settings(database_url="postgresql:///elsewhere")


@dataclass(frozen=True, kw_only=True)
class Played:
    """A team and its submission, whose first shard has been played."""

    database: Database
    by: Principal
    submission: Submission

    def ask(self, number: int = 1, *, by: Principal | None = None, **settings: Any) -> Playback:
        """Asks for the playback of an episode, in a transaction of its own."""
        with self.database.transaction() as session:
            episode = find_episode(session, by or self.by, self.submission.id, TASK, number)
            return ask(session, SETTINGS.model_copy(update=settings), by or self.by, episode)

    def found(self, number: int = 1) -> Playback | None:
        """What there is of the playback of an episode."""
        with self.database.transaction() as session:
            return find_playback(session, self.episode(number))

    def episode(self, number: int = 1) -> EpisodeResult:
        with self.database.transaction() as session:
            return find_episode(session, self.by, self.submission.id, TASK, number)


def played(database: Database, team: str = "Team A", content: str = "content") -> Played:
    """A team whose submission has the episodes of its first shard."""
    with database.transaction() as session:
        by = make_principal(session, team)
        submission = submit(session, by, content)
        first = shard_ids(session, submission)[0]
    play(database, first)
    return Played(database=database, by=by, submission=submission)
