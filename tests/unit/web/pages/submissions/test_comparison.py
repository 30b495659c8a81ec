import csv
import io
import re
from uuid import uuid4

from seeded_site import GELBOTS, SeededSite, words
from service_factories import LOCK, TASK
from sqlalchemy import update
from vitac.server.database.models import EpisodeResult, Evaluation


def compare(site: SeededSite, *names: str, suffix: str = "") -> str:
    query = "&".join(f"id={site.id_of(name)}" for name in names)
    answer = site.visitor(GELBOTS).get(f"/compare{suffix}?{query}")
    assert answer.status_code == 200
    return answer.text


def rows_of(html: str) -> list[list[str]]:
    """The rows of all tables, as the texts of their cells."""
    rows = re.findall(r"<tr role=.*?</tr>", html, re.DOTALL)
    return [[words(cell) for cell in re.findall(r"<t[dh] .*?</t[dh]>", row, re.DOTALL)] for row in rows]


def test_own_results_and_those_of_the_board_are_offered(site: SeededSite) -> None:
    html = compare(site, "done")
    assert f'<option value="{site.id_of("both")}">' in html
    assert f'<option value="{site.id_of("sharp")}">Bears: sharp</option>' in html
    for other in ("done", "runs", "waits", "broke"):
        assert f'<option value="{site.id_of(other)}"' not in html


def test_the_address_below_a_submission_leads_to_the_page_of_both(site: SeededSite) -> None:
    done, both = site.id_of("done"), site.id_of("both")
    answer = site.visitor(GELBOTS).get(f"/submissions/{done}/compare?with={both}")
    assert (answer.status_code, answer.headers["location"]) == (303, f"/compare?id={done}&id={both}")


def test_three_are_compared_in_pairs_by_shape_and_by_difficulty(site: SeededSite) -> None:
    for name, successes in (("first", (20, 0, 0)), ("second", (10, 3, 0)), ("third", (10, 3, 0))):
        site.submit(GELBOTS, name, {TASK: successes})
    html = compare(site, "first", "second", "third")
    rows = rows_of(html)
    names = [f"Gelbots: {name}" for name in ("first", "second", "third")]
    pairs = {row[0]: [cell.split()[-1] for cell in row[1:]] for row in rows if " and " in row[0]}
    assert pairs[f"{names[0]} and {names[1]}"][:4] == ["10", "10", "3", "247"]
    assert pairs[f"{names[1]} and {names[2]}"] == ["13", "0", "0", "257", "+2.1)", "1"]
    assert pairs.keys() == {f"{names[a]} and {names[b]}" for a, b in ((0, 1), (0, 2), (1, 2))}
    assert ["Shape", *names] in rows
    assert next(row for row in rows if row[0] == "Cuboid")[1].endswith("20 of 90")
    quarters = [row for row in rows if row[0].endswith("starts")]
    counts = [[int(n) for n in re.findall(r"(\d+) of", " ".join(row))] for row in quarters]
    assert [sum(of) for of in zip(*counts, strict=True)] == [20, 13, 13]
    links = re.findall(r'href="/submissions/([0-9a-f-]+)/episodes/([a-z-]+)/(\d+)\?beside=([0-9a-f-]+):(\d+)"', html)
    mine, other = str(site.id_of("first")), str(site.id_of("second"))
    assert (mine, TASK, "31", other, "31") in links, "each differing episode leads to both side by side"


def test_differing_episodes_and_the_comparison_are_files_and_namesakes_have_numbers(site: SeededSite) -> None:
    site.submit(GELBOTS, "one", {TASK: (1, 0, 0)})
    site.submit(GELBOTS, "none", {TASK: (0, 0, 0)})
    for name in ("one", "none"):
        with site.evaluation(name) as (_, evaluation):
            evaluation.submission.name = "same"
    (row,) = csv.DictReader(io.StringIO(compare(site, "one", "none", suffix=".csv")))
    assert row["episode"] == "1"
    assert row["Gelbots: same (1) outcome"] == "success"
    assert row["Gelbots: same (2) outcome"] != "success"
    assert '"p_value":1.0' in compare(site, "one", "none", suffix=".json")


def test_nothing_in_common_and_different_evaluators_are_said(site: SeededSite) -> None:
    site.submit(GELBOTS, "lock", {LOCK: (1, 1, 1, 1)})
    assert "have no episode in common" in compare(site, "done", "lock")
    assert "different evaluators" not in compare(site, "done", "both")
    site.submit(GELBOTS, "sealed", {TASK: (1, 1, 1)})
    site.seal("sealed", is_revealed=True)
    assert "have no episode in common" in compare(site, "done", "sealed")
    site.submit(GELBOTS, "old", {TASK: (1, 1, 1)})
    with site.evaluation("old") as (session, evaluation):
        new = evaluation.evaluator_version
        for table, of_evaluation in ((Evaluation, Evaluation.id), (EpisodeResult, EpisodeResult.evaluation_id)):
            session.execute(update(table).where(of_evaluation == evaluation.id).values(evaluator_version="0+old"))
    assert f"different evaluators, 0+old and {new}" in compare(site, "done", "old")


def test_another_teams_submission_is_there_only_if_it_is_on_a_board(site: SeededSite) -> None:
    for other in (site.id_of("waits"), uuid4(), "no-id"):
        assert site.visitor(GELBOTS).get(f"/compare?id={site.id_of('done')}&id={other}").status_code == 404
    assert "Bears: sharp" in compare(site, "done", "sharp")
