"""Tables of the documents that are written from the code."""

import pytest
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.server.settings import Settings
from vitac.web.documentation.library import Library
from vitac.web.documentation.markup import settings


def test_every_setting_has_a_meaning_and_its_default() -> None:
    rows = {name: (meaning, default) for name, meaning, default in (row.split(" | ") for row in lines(settings()))}
    assert rows.keys() == {f"`VITAC_{name.upper()}`" for name in Settings.model_fields}
    assert all(meaning.endswith(".") for meaning, _ in rows.values())
    for name, default in (
        ("LEASE_S", "6"),
        ("CLIENT_SHARE", "0.1"),
        ("REGISTRATION", "open"),
        ("LOG_BYTES", "33554432"),
        ("STATE_DIR", "as described"),
        ("TRUSTED_PROXIES", "none"),
        ("WEBHOOKS_MAY_LEAD_INSIDE", "false"),
    ):
        assert rows[f"`VITAC_{name}`"][1] == default


def lines(table: str) -> list[str]:
    """Return the rows of a table without its head."""
    return [line.removeprefix("| ").removesuffix(" |") for line in table.splitlines()[2:]]


@pytest.mark.parametrize(
    ("document", "cells"),
    [
        ("deployment", ["VITAC_WORKER_SLOTS"]),
        ("submissions", ["relative_motion", "object_point_cloud", "(480, 640, 3) uint8", "4 degree"]),
        ("failures", [*VerdictCode, *EpisodeOutcome, VerdictCode.SHARD_TIME.sentence.partition(";")[0]]),
    ],
)
def test_documents_show_the_tables(document: str, cells: list[str]) -> None:
    html = Library(describe_api=dict).document(document).html
    assert [cell for cell in cells if cell not in html] == []
