import json

import pytest
import quick_worker
from cli_service import CliService
from service_factories import TASK, TRACK, make_principal, make_score, outdate, submit_scored
from vitac.cli.client.answers import RequestRefused
from vitac.cli.client.verbs import ConsentMissing


@pytest.mark.slow
def test_a_rejudgement_is_started_shown_and_applied(service: CliService) -> None:
    with service.database.transaction() as session:
        for name, successes in (("Ants", 80), ("Bees", 78)):
            submit_scored(session, make_principal(session, name), name, {TASK: make_score(successes)})
        outdate(session)
    assert service.run("admin", "rejudge", "list").stdout.strip() == "There is none."
    start = ("admin", "rejudge", "start", "--track", TRACK, "--reason", "upgrade")
    assert service.run(*start, "--dry-run").stdout.strip() == "2 submissions"
    tried = json.loads(service.run(*start, "--dry-run", "--json").stdout)
    assert (tried["id"], len(tried["submissions"])) == (None, 2)
    assert service.run("admin", "rejudge", "list").stdout.strip() == "There is none."
    made = json.loads(service.run(*start, "--json").stdout)
    assert len(made["submissions"]) == 2
    assert "2 would change" not in service.run("admin", "rejudge", "show", made["id"]).stdout
    early = service.run("admin", "rejudge", "apply", made["id"], "--yes")
    assert isinstance(early.exception, RequestRefused)
    listed = json.loads(service.run("admin", "rejudge", "list", "--json").stdout)
    assert [(row["id"], row["reason"], row["applied_at"]) for row in listed] == [(made["id"], "upgrade", None)]
    quick_worker.play_queued(service.database)
    assert "queued" not in service.run("admin", "rejudge", "show", made["id"]).stdout
    assert "2 of 2 submissions would change" in service.run("admin", "rejudge", "apply", made["id"], "--dry-run").stdout
    assert isinstance(service.run("admin", "rejudge", "apply", made["id"]).exception, ConsentMissing)
    rows = json.loads(service.run("admin", "rejudge", "apply", made["id"], "--yes", "--json").stdout)
    assert {row["team"] for row in rows} == {"Ants", "Bees"}
    assert all(row["changes"] and row["before"]["evaluator_version"] == "0+old" for row in rows)
    assert json.loads(service.run("admin", "rejudge", "list", "--json").stdout)[0]["applied_at"]


def test_a_rejudgement_is_discarded(service: CliService) -> None:
    with service.database.transaction() as session:
        submit_scored(session, make_principal(session, "Ants"), "Ants", {TASK: make_score(80)})
    arguments = ("--track", TRACK, "--reason", "doubt")
    made = json.loads(service.run("admin", "rejudge", "start", *arguments, "--json").stdout)["id"]
    assert isinstance(service.run("admin", "rejudge", "discard", made).exception, ConsentMissing)
    dry = service.run("admin", "rejudge", "discard", made, "--dry-run", "--json")
    assert json.loads(dry.stdout) == {"rejudgement": made, "discarded": True}
    assert "cancelled" not in service.run("admin", "rejudge", "show", made).stdout
    assert service.run("admin", "rejudge", "discard", made, "--yes").stdout.strip() == f"discarded {made}"
    assert "cancelled" in service.run("admin", "rejudge", "show", made).stdout
