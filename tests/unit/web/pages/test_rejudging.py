"""Rejudging on the organizers' page; `cli/admin/test_rejudging` does it over the API."""

import re
from collections.abc import Iterator

import pytest
from cli_service import CliService, cli_service
from served_pages import visitor, visitor_of_role
from service_factories import (
    TASK,
    TRACK,
    make_principal,
    make_score,
    outdate,
    play,
    submit_scored,
    successes_below,
)
from sqlalchemy import select
from vitac.evaluator.tracks import load_track
from vitac.server.database.models import Evaluation, Rejudgement
from vitac.server.database.states import Role
from vitac.server.leaderboards.standings import leaderboard

from competitions import shown_stage


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CliService]:
    """A service with the results of two teams that an older evaluator made."""
    with cli_service(tmp_path_factory.mktemp("service") / "state") as service:
        with service.database.transaction() as session:
            for name in ("Ants", "<Bees>"):
                submit_scored(session, make_principal(session, name), name, {TASK: make_score(60)})
            outdate(session)
        yield service


def play_proposed(service: CliService) -> None:
    """Plays what open rejudgements have queued, each by a policy of its own that solves every episode."""
    with service.database.transaction() as session:
        found = session.scalars(select(Evaluation).where(Evaluation.is_proposed)).all()
        shards = [[shard.id for shard in each.shards if shard.state.value == "queued"] for each in found]
    for number, of_one in enumerate(shards):
        for shard_id in of_one:
            play(service.database, shard_id, successes_below(300 + 100 * number))


def board(service: CliService) -> list[tuple[int | None, float]]:
    with service.database.transaction() as session:
        return [
            (one.rank, one.success_rate)
            for one in leaderboard(session, shown_stage(session, TRACK), task=TASK).view.entries
        ]


def ended(service: CliService) -> dict[str, tuple[bool, bool]]:
    """Whether each rejudgement was applied or discarded, by its reason."""
    with service.database.transaction() as session:
        found = session.scalars(select(Rejudgement))
        return {one.reason: (one.applied_at is not None, one.discarded_at is not None) for one in found}


def field(html: str, name: str) -> str:
    found = re.search(rf'name="{name}" value="([^"]+)"', html.partition("/rejudging/apply")[2])
    assert found is not None
    return found[1]


def test_an_organizer_starts_looks_at_and_applies_a_rejudgement(service: CliService) -> None:
    organizer, judge, anybody = (
        visitor_of_role(service, Role.ORGANIZER),
        visitor_of_role(service, Role.JUDGE),
        visitor(service),
    )
    assert judge.get("/rejudging").status_code == 403
    assert anybody.get("/rejudging").status_code == 303
    assert 'href="/rejudging"' in organizer.get("/desk").text
    for reason in (" ", "a\x00b", "x" * 501):
        refused = organizer.send("/rejudging", "/rejudging/start", track=TRACK, reason=reason)
        assert refused.status_code == 422
    refused = organizer.send("/rejudging", "/rejudging/start", track="none", reason="x")
    assert refused.status_code == 404
    assert judge.send("/announcements", "/rejudging/start", track=TRACK, reason="x").status_code == 403

    started = organizer.send("/rejudging", "/rejudging/start", track=TRACK, reason="<the> new evaluator")
    assert (started.status_code, started.headers["location"]) == (303, "/rejudging")
    waiting = organizer.get("/rejudging").text
    title = load_track(TRACK).title
    assert f"{title}: &lt;the&gt; new evaluator</h2>" in waiting
    assert f'<option value="{TRACK}">{title}</option>' in waiting
    assert "2 still wait or run" in waiting
    assert '<button type="submit" disabled>' in waiting
    before = field(waiting, "shown")
    play_proposed(service)
    assert all(rank is None for rank, _ in board(service)), "nothing has changed yet"
    shown = organizer.get("/rejudging").text
    for what in ("&lt;the&gt; new evaluator", "&lt;Bees&gt;", "30.0", "50.0", "rank 1", "2 of 2 would change"):
        assert what in shown, what
    number = field(shown, "id")
    stale = organizer.send("/rejudging", "/rejudging/apply", id=number, shown=before)
    assert stale.status_code == 409
    assert organizer.send("/rejudging", "/rejudging/apply", id=number).status_code == 422, "it says what was looked at"
    assert ended(service) == {"<the> new evaluator": (False, False)}, "what has changed meanwhile is looked at first"
    applied = organizer.send("/rejudging", "/rejudging/apply", id=number, shown=field(shown, "shown"))
    assert applied.status_code == 303, applied.text
    assert [rank for rank, _ in board(service)] == [1, 2]
    assert ended(service) == {"<the> new evaluator": (True, False)}
    listed = organizer.get("/rejudging").text.partition('id="ended"')[2]
    assert "applied" in listed
    assert f"<p>{title}, " in listed
    again = organizer.send("/rejudging", "/rejudging/discard", id=number)
    assert again.status_code == 409, "it has ended"
