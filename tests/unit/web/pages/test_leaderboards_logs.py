"""Logs on their boards, on pages of their own, and as files."""

import csv
import io
import re
from collections.abc import Iterator

import pytest
from seeded_site import BEARS, GELBOTS, SeededSite, form_token, played_record, seeded_site, words
from service_factories import LOCK, TASK, add_result, forget_boards, make_score, play_all, submit_refuted_log
from sqlalchemy import update
from uploaded_logs import EPISODES, a_log, a_text_log
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.logs.findings import Divergence, LogFinding
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.database.models import Shard, Submission, Team
from vitac.server.evaluations.logs import LogClaim

PAGE = "/tracks/track_1/logs"
CLAIM = LogClaim(team=None, episodes=270, successes=243, success_rate=0.9, mean_steps=4.5)


def record_of(episode: int, *, task: str) -> EpisodeRecord:
    """What `done` of the Gelbots plays."""
    return played_record("done", task, episode, (80, 74, 80))


def upload(site: SeededSite, team: str, name: str, content: bytes) -> None:
    """Uploads a log and has a worker meet all its states."""
    browser = site.visitor(team)
    answer = browser.post(
        "/submissions/upload", data={"form_token": form_token(browser)}, files={"file": (name, content)}
    )
    with site.database.transaction() as session:
        submission = session.get_one(Submission, answer.headers["location"].rpartition("/")[2])
    site.added[name] = submission.id
    play_all(site.database, submission, record_of)
    forget_boards()


@pytest.fixture(scope="module")
def logged() -> Iterator[SeededSite]:
    """A verified log of the Gelbots, a copy of it by the Bears, and a text log."""
    with seeded_site() as site:
        content = a_log((record_of(number, task=TASK) for number in EPISODES), team=None)
        upload(site, GELBOTS, "run.jsonl", content)
        upload(site, BEARS, "copy.jsonl", content)
        upload(site, GELBOTS, "old.log", a_text_log(GELBOTS))
        yield site


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_logs_of_a_track_rank_apart_and_text_logs_stand_beside_their_claims(logged: SeededSite) -> None:
    html = logged.visitor().get(PAGE).text
    shown = words(html)
    for text in (
        "270 of 270 episodes as an earlier submission of Gelbots",
        "actions verified, policy not seen",
        "86.7 %",
    ):
        assert text in shown, text
    assert "No verified log of this task yet" in shown
    for text in ("does not reproduce itself", "4.8 %", "not ranked"):
        assert text in shown, text
    assert f'href="{PAGE}" aria-current="page"' in html
    assert 'role="search"' not in html, "a few need neither search nor pages"
    assert 'class="pages"' not in html


def test_boards_of_logs_are_files_with_their_verification_copies_and_claims(logged: SeededSite) -> None:
    answer = logged.visitor().get("/tracks/track_1/logs.csv")
    assert "track_1-logs.csv" in answer.headers["content-disposition"]
    own, copy = rows_of(answer.text)
    assert (own["task"], own["rank"], own["team"], own["verification"]) == (TASK, "1", GELBOTS, "verified")
    assert (own["copy_of_team"], own["copied_episodes"], own["successes"]) == ("", "", "234")
    assert (copy["copy_of_team"], copy["copied_episodes"]) == (GELBOTS, "270")
    answer = logged.visitor().get("/tracks/track_1/text-logs.csv")
    assert "track_1-text-logs.csv" in answer.headers["content-disposition"]
    (row,) = rows_of(answer.text)
    assert (row["claimed_success_rate"], row["success_rate"][:5]) == ("0.0481", "0.866")
    assert int(row["problems"]) > 0
    for file in ("/tracks/track_1/logs.csv", "/tracks/track_1/text-logs.csv", "/api/v1/leaderboards/track_1/logs"):
        assert f'href="{file}"' in logged.visitor().get(PAGE).text


def test_a_log_names_the_models_that_give_its_actions_and_a_text_log_why_it_is_not_verified(logged: SeededSite) -> None:
    browser = logged.visitor(GELBOTS)
    verified, text_log = (words(browser.get(logged.path_of(name)).text) for name in ("run.jsonl", "old.log"))
    for text in ("done", "270 of 270", "all states are equal"):
        assert text in verified
    for text in ("cannot be verified", "4.8 %", " more"):
        assert text in text_log


def test_a_diverged_log_shows_both_states(site: SeededSite) -> None:
    divergence = Divergence(
        episode=31,
        env_step=2,
        recorded_state="ab" * 32,
        recorded_info={"is_success": True, "surface_diff_m": None},
        resimulated_state="cd" * 32,
        resimulated_info={"is_success": False, "surface_diff_m": [0.0004321987, 0.0005]},
    )
    with site.database.transaction() as session:
        log = submit_refuted_log(session, site.seed.people[GELBOTS], "log")
        finding = LogFinding.diverged(divergence).model_dump(mode="json")
        session.execute(update(Shard).where(Shard.finding.is_not(None)).values(finding=finding))
    shown = words(site.visitor(GELBOTS).get(f"/submissions/{log.id}").text)
    for text in ("Episode 31, env step 2", "ab" * 6, "cd" * 6, "surface_diff_m", "0.0004322, 0.0005"):
        assert text in shown


TEAMS = [f"Team {place:03d}" for place in range(1, 61)]


@pytest.fixture
def many(site: SeededSite) -> SeededSite:
    """61 verified logs of the peg task and 61 text logs; the Gelbots' are the last."""
    with site.database.transaction() as session:
        teams = [Team(name=name, name_key=name.casefold()) for name in TEAMS]
        session.add_all(teams)
        teams.append(session.get_one(Team, site.seed.people[GELBOTS].team_id))
        session.flush()
        for number, team in enumerate(teams):
            for kind in (SubmissionKind.LOG, SubmissionKind.TEXT_LOG):
                made = add_result(
                    session, 2 * number + (kind is SubmissionKind.LOG), team, {TASK: make_score(200 - number, 270)},
                    team.created_at, kind=kind,
                )  # fmt: skip
                made.submission.manifest = CLAIM.stored()
    forget_boards()
    return site


def section(html: str, name: str) -> str:
    found = re.search(rf'<section aria-labelledby="{name}">.*?</section>', html, re.DOTALL)
    assert found is not None
    return found[0]


def test_each_board_has_pages_of_its_own_and_a_search_looks_through_all(many: SeededSite) -> None:
    html = many.visitor().get(f"{PAGE}?page-text-logs=3").text
    peg, text_logs = section(html, f"logs-{TASK}"), section(html, "text-logs")
    assert peg.count('<tr role="row" class') == 25
    assert "Team 001" in peg
    assert f'href="{PAGE}?page-logs-{TASK}=2#logs-{TASK}"' in peg
    assert text_logs.count('<tr role="row" class') == 11
    assert f'href="{PAGE}?page-text-logs=3#text-logs" aria-current="page"' in text_logs
    assert "No verified log of this task yet." in section(html, f"logs-{LOCK}")
    html = many.visitor().get(f"{PAGE}?q=team+05").text
    for name in (f"logs-{TASK}", "text-logs"):
        found = section(html, name)
        assert found.count('<tr role="row" class') == 10
        assert 'class="pages"' not in found
    nobody = many.visitor().get(f"{PAGE}?q=<b>").text
    assert "Entries with “<bdi>&lt;b&gt;</bdi>” in the name." in nobody
    assert nobody.count("matches the search") == 2


def test_the_own_rows_are_marked_and_linked(many: SeededSite) -> None:
    assert "Your team" not in many.visitor().get(PAGE).text
    browser = many.visitor(GELBOTS)
    first = browser.get(PAGE).text
    assert f'<a href="{PAGE}?page-logs-{TASK}=3#logs-{TASK}">Your team</a>: rank 61' in first
    assert section(first, f"logs-{TASK}").count('class="own"') == 0
    second = browser.get(f"{PAGE}?page-logs-{TASK}=3").text
    assert section(second, f"logs-{TASK}").count('class="own"') == 1
