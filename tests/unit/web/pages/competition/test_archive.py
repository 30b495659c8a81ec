from seeded_site import SeededSite, words
from sqlalchemy import select
from vitac.server.accounts import teams
from vitac.server.competitions.competition import Competition
from vitac.server.database.models import Team
from vitac.server.decisions.finishing import finalize
from vitac.server.principals import CONSOLE

from competitions import make_competition, moved, open_now

PRIZES = [{"place": "first", "amount": 2000, "note": "a talk"}]


def test_the_archive_shows_winners_boards_and_how_to_cite_and_strikes_out_who_is_disqualified(site: SeededSite) -> None:
    content = make_competition(prizes=PRIZES)
    del content["tracks"]["track_1"]["stages"][1]
    visitor = site.visitor()
    assert visitor.get("/competition/archive").status_code == 404
    site.hold(open_now(content))
    assert visitor.get("/competition/archive").status_code == 404, "before the end"
    site.score("<Wolves>", "wolf", 200)
    site.hold(moved(content, days=-60))
    with site.database.transaction() as session:
        finalize(session, CONSOLE)
        final = Competition.read(session).row.finalized_at
    html = visitor.get("/competition/archive").text
    for text in ("Touch, Simulation", "&lt;Wolves&gt;", "@misc{", f"{final:%F}", '<td role="cell">Touch</td>'):
        assert text in html, text
    assert "This page changes only when a team is disqualified, reinstated or removed." in words(html)
    assert ("<s>" in html, "Decided again" in html) == (False, False)
    assert 'href="/competition/archive"' in visitor.get("/competition").text
    with site.database.transaction() as session:
        teams.disqualify(
            session, CONSOLE, session.scalars(select(Team).where(Team.name == "<Wolves>")).one(), "cheated"
        )
    struck = visitor.get("/competition/archive").text
    assert struck.count("<s>&lt;Wolves&gt;</s>") == 2, "among the winners and on the board"
    assert struck.count("disqualified after the end") == 2
    assert "struck through" in struck
    assert visitor.get("/competition").text.count("<s>&lt;Wolves&gt;</s>") == 1


def test_an_archive_of_nobody_says_so(site: SeededSite) -> None:
    site.hold(moved(open_now(make_competition()), days=-90))
    with site.database.transaction() as session:
        finalize(session, CONSOLE)
    assert "Nobody took part" in site.visitor().get("/competition/archive").text


def test_an_archive_has_what_its_board_was_ranked_by(site: SeededSite) -> None:
    content = make_competition(prizes=PRIZES, ranking=["surface_diff_mm", "submitted_at"])
    del content["tracks"]["track_1"]["stages"][1]
    site.hold(open_now(content))
    site.score("Wolves", "wolf", 200)
    site.hold(moved(content, days=-90))
    with site.database.transaction() as session:
        finalize(session, CONSOLE)
    html = site.visitor().get("/competition/archive").text
    assert 'class="right">Surface [mm]</th>' in html
