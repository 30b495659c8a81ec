"""docs/organizing.md: its tables hold every key of a competition's file, and what is taken where one is left out."""

import re
from pathlib import Path

import pytest
from pydantic import BaseModel
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.competitions.definition import (
    Advancement,
    CompetitionDefinition,
    Judging,
    Prize,
    StageQuotas,
    StageRules,
    TrackRules,
)


def rows(repository: Path, table: str) -> dict[str, tuple[str, str]]:
    """Meaning and default of each key in a table of the manual."""
    manual = (repository / "docs" / "organizing.md").read_text()
    found = re.search(rf"^\| {table} \|.*\n\|[-|]+\|\n((?:\|.*\n)+)", manual, re.MULTILINE)
    assert found is not None, table
    lines = [line.strip("|").split(" | ") for line in found[1].splitlines()]
    return {key: (meaning, default) for keys, meaning, default in lines for key in re.findall(r"`(\w+)`", keys)}


@pytest.mark.parametrize(
    ("table", "model"),
    [("key of the file", CompetitionDefinition), ("key of a track", TrackRules), ("key of a stage", StageRules)],
)
def test_every_key_is_told_with_what_is_taken_without_it(repository: Path, table: str, model: type[BaseModel]) -> None:
    told = rows(repository, table)
    assert told.keys() == model.model_fields.keys()
    needed = {key for key, (_, default) in told.items() if default.strip() == "needed"}
    # A track that the service takes accepts something; the field alone may be left out for one that it does not.
    assert needed == {key for key, field in model.model_fields.items() if field.is_required() or key == "accepts"}


def test_defaults_and_inner_keys_are_those_of_the_code(repository: Path) -> None:
    of_file, of_track, of_stage = (rows(repository, f"key of {what}") for what in ("the file", "a track", "a stage"))
    assert CompetitionDefinition.model_fields["currency"].default in of_file["currency"][1]
    assert of_track["ranking"][1].strip() == "as the track's file says"
    assert StageRules.model_fields["list"].default.value in of_stage["list"][1]
    for row, model in (
        (of_track["prizes"], Prize),
        (of_track["judging"], Judging),
        (of_stage["quotas"], StageQuotas),
        (of_stage["qualified"], Advancement),
    ):
        assert [key for key in model.model_fields if f"`{key}" not in row[0]] == [], model
    assert all(f"`{kind}`" in of_stage["accepts"][0] for kind in (SubmissionKind.MODEL, SubmissionKind.TEXT_LOG))
