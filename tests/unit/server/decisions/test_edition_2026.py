"""The competition of 2026: a brief for a committee, then results that operators enter; its published board."""

import zlib
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from service_factories import make_principal
from vitac.server.accounts import teams
from vitac.server.accounts.merging import merge
from vitac.server.audit import newest_entries
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.definition import CompetitionDefinition, read_competition
from vitac.server.competitions.view import competition_view
from vitac.server.database.engine import Database
from vitac.server.decisions import advancement, entered_results, finishing
from vitac.server.decisions.publishing import result_files
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.operations import team_data
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.submissions import briefs
from vitac.server.submissions.briefs import count_pages
from vitac.server.views.by_hand import EnteredBoardView

from competitions import open_now, put_in_place

FILE = Path(__file__).parents[4] / "competitions" / "vitac-2026.yaml"
TRACK = "real_robot"
BOARD = [(420, 280), (200, 140), (200, 40), (140, 60), (0, 180), (160, 0), (0, 60)]
"""As published: tube and grinding of each; the second one is the organizers' baseline."""


def pdf(pages: int, *, packed: bool = False, times: int = 1) -> bytes:
    """A PDF with so many page objects, in an object stream or not, each written several times."""
    bodies = [b"<< /Type /Pages /Count %d >>" % pages, *[b"<< /Type /Page /Parent 1 0 R >>"] * pages]
    if not packed:
        objects = [b"%d 0 obj %b endobj\n" % (number, body) for number, body in enumerate(bodies, 1)]
        return b"%PDF-1.4\n" + b"".join(objects) * times + b"%%EOF"
    places, content = [], b""
    for number, body in enumerate(bodies, 1):
        places.append(b"%d %d" % (number, len(content)))
        content += body + b" "
    head = b" ".join(places) + b" "
    stream = zlib.compress(head + content)
    return (
        b"%%PDF-1.7\n9 0 obj << /Type /ObjStm /N %d /First %d /Length %d >>\nstream\n%b\nendstream endobj\n%%%%EOF"
        % (len(bodies), len(head), len(stream), stream)
    )


@pytest.mark.parametrize(
    ("data", "pages"),
    [
        (pdf(3), 3),
        (pdf(3, packed=True), 3),
        (pdf(2, times=3), 2),
        (b"no PDF /Type /Page", 0),
        (pdf(3) + b"<< /Encrypt 4 0 R >>", 0),
        (b"%PDF-1.7\n1 0 obj << /Type /ObjStm /First 4 >>\nstream\njunk\nendstream endobj", 0),
    ],
)
def test_pages_of_a_pdf_are_counted(data: bytes, pages: int) -> None:
    assert count_pages(data) == pages


OVERLAPPING = b"1 0 2 99999 " * 100_000
"""Of an object stream each of whose objects would be most of it."""


@pytest.mark.parametrize(
    "data",
    [
        b"1 0 obj " * 1_000_000,
        b"1 0 obj <<>> stream\n" * 500_000 + b"endobj",
        b"1 0 obj << /Type /ObjStm /First %d >>\nstream\n%b\nendstream endobj"
        % (len(OVERLAPPING), zlib.compress(OVERLAPPING + bytes(8_000_000))),
    ],
    ids=["objects without an end", "streams without an end", "objects that overlap"],
)
def test_a_hostile_pdf_is_looked_at_once(data: bytes) -> None:
    assert count_pages(b"%PDF-1.7\n" + data) == 0


@pytest.fixture
def edition() -> dict[str, Any]:
    return read_competition(FILE).model_dump(mode="json")


def place(database: Database, edition: dict[str, Any], stage: int) -> None:
    """Let a stage be open."""
    with database.transaction() as session:
        put_in_place(session, open_now(edition, stage, TRACK))


def hand_in(database: Database, by: Principal, content: bytes) -> None:
    with database.transaction() as session:
        briefs.hand_in(session, by, Competition.read(session).stage(TRACK, "stage1"), content)


def decide(database: Database, by: Principal, *, accepted: bool = True) -> None:
    assert by.team_id is not None
    with database.transaction() as session:
        stage = Competition.read(session).stage(TRACK, "stage1")
        briefs.decide(session, CONSOLE, stage, by.team_id, "read by three", accepted=accepted)


def enter(database: Database, by: Principal = CONSOLE, **values: Any) -> EnteredBoardView:
    usual = {"team": None, "baseline": None, "attempt": 1, "evidence": "https://example.org/film.mp4"}
    with database.transaction() as session:
        stage = Competition.read(session).stage(TRACK, "stage2")
        entered_results.enter(session, by, stage, **{**usual, **values})
        return entered_results.board(session, stage)


def principal(database: Database, name: str) -> Principal:
    with database.transaction() as session:
        return make_principal(session, name)


def problem(call: Callable[..., object], *arguments: Any, **options: Any) -> ServiceError:
    """What a call is refused with."""
    with pytest.raises(ServiceError) as caught:
        call(*arguments, **options)
    return caught.value


def points(tube: float, grinding: float) -> dict[str, float]:
    return {"test_tube": tube, "grinding": grinding}


def test_the_published_board_follows_from_the_attempts_whose_sums_it_shows(
    database: Database, edition: dict[str, Any]
) -> None:
    place(database, edition, 0)
    names = ["Ants", "", "Bees", "Cats", "Dogs", "Elks", "Fish"]
    teams = {name: principal(database, name) for name in filter(None, names)}
    for team in teams.values():
        hand_in(database, team, pdf(3))
    place(database, edition, 1)
    for team in teams.values():
        decide(database, team)
    for name, best in zip(names, BOARD, strict=True):
        player: dict[str, Any] = {"team": name} if name else {"baseline": "Baseline"}
        # Halves of two attempts make no better one, and a worse attempt afterwards changes nothing.
        enter(database, **player, attempt=1, points=points(best[0], 0))
        enter(database, **player, attempt=2, points=points(*best))
        board = enter(database, **player, attempt=3, points=points(0, best[1] / 2))
    found = [(entry.rank, entry.team, entry.total) for entry in board.entries]
    assert found == [
        (1, "Ants", 700), (None, "Baseline", 340), (2, "Bees", 240), (3, "Cats", 200), (4, "Dogs", 180),
        (5, "Elks", 160), (6, "Fish", 60),
    ]  # fmt: skip
    assert [tuple(entry.points.values()) for entry in board.entries] == BOARD
    assert {entry.prize for entry in board.entries} == {None}
    with database.transaction() as session:
        edition["tracks"][TRACK]["stages"][1]["closes"] = (datetime.now(UTC) - timedelta(hours=1)).isoformat()
        put_in_place(session, edition)
        board = entered_results.board(session, Competition.read(session).stage(TRACK, "stage2"))
    prizes = [entry.prize for entry in board.entries if not entry.is_baseline]
    assert prizes == ["first", "second", "second", "third", "third", "third"]


def test_the_end_gives_prizes_by_the_entered_points_and_keeps_them_under_the_names_of_today(
    database: Database, edition: dict[str, Any]
) -> None:
    place(database, edition, 0)
    players = {name: principal(database, name) for name in ("Ants", "Bees", "Cats")}
    for team in players.values():
        hand_in(database, team, pdf(3))
    place(database, edition, 1)
    for number, (name, team) in enumerate(players.items()):
        decide(database, team)
        enter(database, team=name, points=points(100 - number, 0), evidence=f"film {number}")
    enter(database, baseline="Ours", points=points(500, 500))
    edition["tracks"][TRACK]["stages"][1]["closes"] = (datetime.now(UTC) - timedelta(hours=1)).isoformat()
    with database.transaction() as session:
        put_in_place(session, edition)
        unsettled = [concern.name for concern in finishing.concerns_at_end(session)]
        winners = finishing.finalize(session, CONSOLE, confirmed=unsettled)
    assert [(each.place, each.rank, each.team, each.points, each.evidence) for each in winners] == [
        ("first", 1, "Ants", 100, "film 0"), ("second", 2, "Bees", 99, "film 1"), ("second", 3, "Cats", 98, "film 2"),
    ]  # fmt: skip
    with database.transaction() as session:
        files = result_files(session)
        assert "99 points" in files["certificates.html"]
        assert "evidence film 1" in files["certificates.html"]
        teams.disqualify(session, CONSOLE, teams.find(session, "Ants"), "plays by hand")
        cats = teams.find(session, "Cats")
        team_data.erase(session, CONSOLE, cats)
        view = competition_view(session)
        assert [winner.team for winner in view.winners] == ["Ants", "Bees", cats.name]
        assert [each.team for each in view.disqualified] == ["Ants"]
    with database.transaction() as session:
        again = finishing.finalize_again(session, CONSOLE)
    assert [(each.place, each.points) for each in again] == [("first", 99), ("second", 98)]


def test_a_committee_lets_in_whom_it_accepts_and_nobody_else(database: Database, edition: dict[str, Any]) -> None:
    place(database, edition, 0)
    ants, bees = principal(database, "Ants"), principal(database, "Bees")
    hand_in(database, ants, pdf(2))
    hand_in(database, ants, pdf(4))
    hand_in(database, bees, pdf(3))
    assert "STAGE" in problem(decide, database, ants).code.name  # it is still open
    place(database, edition, 1)
    decide(database, ants)
    decide(database, bees, accepted=False)
    enter(database, team="Ants", points=points(1, 2))
    for team in ("Bees", str(principal(database, "Cats").team_id)):
        assert problem(enter, database, team=team, points=points(1, 2)).code is ProblemCode.NOT_QUALIFIED
    assert problem(hand_in, database, bees, pdf(3)).code is ProblemCode.STAGE_CLOSED
    with database.transaction() as session:
        competition = Competition.read(session)
        first, second = competition.stage(TRACK, "stage1"), competition.stage(TRACK, "stage2")
        assert [brief.team.name for brief in briefs.list_briefs(session, ants, first)] == ["Ants"]
        assert [brief.pages for brief in briefs.list_briefs(session, CONSOLE, first)] == [4, 3]
        assert briefs.list_briefs(session, VISITOR, first) == []
        assert bees.team_id is not None
        assert problem(briefs.find, session, ants, first, bees.team_id).code is ProblemCode.NOT_FOUND
        assert "committee decides" in problem(advancement.propose, session, CONSOLE, second).detail


@pytest.mark.parametrize("content", [pdf(1), pdf(5), b"%PDF-1.7 nothing", b"a letter"])
def test_a_brief_of_other_pages_is_refused(database: Database, edition: dict[str, Any], content: bytes) -> None:
    place(database, edition, 0)
    refusal = problem(hand_in, database, principal(database, "Ants"), content)
    assert "Expected a brief of 2 to 4 pages as PDF, got " in refusal.detail


@pytest.mark.parametrize(
    ("values", "part"),
    [
        ({"points": {"test_tube": 1}}, "Expected points of test_tube, grinding"),
        ({"points": points(501, 0)}, "from 0 to 500, got 501"),
        ({"points": points(float("nan"), 0)}, "from 0 to 500, got nan"),
        ({"points": points(1, -1)}, "from 0 to 500, got -1"),
        ({"points": points(1, 1), "team": "Ants"}, "one of both"),
    ],
)
def test_points_that_no_attempt_can_have_are_refused(
    database: Database, edition: dict[str, Any], values: dict[str, Any], part: str
) -> None:
    place(database, edition, 1)
    assert part in problem(enter, database, **{"baseline": "Ours", **values}).detail


def test_a_baseline_with_the_name_of_a_team_is_another_player(database: Database, edition: dict[str, Any]) -> None:
    place(database, edition, 0)
    ants = principal(database, "Ants")
    hand_in(database, ants, pdf(2))
    place(database, edition, 1)
    decide(database, ants)
    enter(database, team="Ants", points=points(1, 2))
    board = enter(database, baseline="Ants", points=points(30, 4))
    shown = [(entry.rank, entry.is_baseline, entry.total, entry.attempts) for entry in board.entries]
    assert shown == [(None, True, 34, 1), (1, False, 3, 1)]


def test_results_are_entered_of_teams_that_advanced_only_by_whatever_rule(
    database: Database, edition: dict[str, Any]
) -> None:
    edition["tracks"][TRACK]["stages"][1]["qualified"] = {"top": 1}
    place(database, edition, 1)
    principal(database, "Ants")
    refusal = problem(enter, database, team="Ants", points=points(1, 2))
    assert refusal.code is ProblemCode.NOT_QUALIFIED
    assert "it is for the best team of the stage before" in refusal.detail


def test_a_correction_replaces_the_attempt_and_the_audit_log_has_both(
    database: Database, edition: dict[str, Any]
) -> None:
    place(database, edition, 1)
    enter(database, baseline="Ours", points=points(100, 1))
    board = enter(database, baseline="Ours", points=points(10, 1), evidence="counted again")
    (entry,) = board.entries
    assert (entry.total, entry.attempts, entry.evidence) == (11, 1, "counted again")
    with database.transaction() as session:
        newest = newest_entries(session, action="result.enter")[0]
        assert newest.before is not None
        assert (newest.before["points"], newest.after["points"]) == (points(100, 1), points(10, 1))


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda track: track.update(taken_here=True), "write `taken_here: false`"),
        (lambda track: track["stages"][0].update(brief=None), "but no stage before has a brief"),
        (lambda track: track["stages"][1].update(brief={}), "a brief or entered results, expected not both"),
        (lambda track: track["stages"][0]["brief"].update(min_pages=5), "expected at most max_pages"),
    ],
)
def test_a_file_that_cannot_be_held_is_refused(edition: dict[str, Any], change: Any, part: str) -> None:
    change(edition["tracks"][TRACK])
    with pytest.raises(ValueError, match=part):
        CompetitionDefinition.model_validate(edition)


def test_a_merge_keeps_the_accepted_brief_and_numbers_attempts_on(database: Database, edition: dict[str, Any]) -> None:
    place(database, edition, 0)
    ants, bees = principal(database, "Ants"), principal(database, "Bees")
    hand_in(database, ants, pdf(2))
    hand_in(database, bees, pdf(3))
    place(database, edition, 1)
    decide(database, ants)
    decide(database, bees)
    enter(database, team="Ants", points=points(1, 2))
    enter(database, team="Bees", points=points(3, 4))
    decide(database, bees, accepted=False)
    with database.transaction() as session:
        merge(session, CONSOLE, teams.find(session, "Ants"), teams.find(session, "Bees"))
    with database.transaction() as session:
        competition = Competition.read(session)
        (entry,) = entered_results.board(session, competition.stage(TRACK, "stage2")).entries
        assert (entry.team, entry.total, entry.attempts) == ("Bees", 7, 2)
        (brief,) = briefs.list_briefs(session, CONSOLE, competition.stage(TRACK, "stage1"))
        assert (brief.team.name, brief.pages, brief.accepted) == ("Bees", 2, True)
        team_data.erase(session, CONSOLE, brief.team)
    with database.transaction() as session:
        (brief,) = briefs.list_briefs(session, CONSOLE, Competition.read(session).stage(TRACK, "stage1"))
        assert (brief.content, brief.accepted) == (b"", True)
