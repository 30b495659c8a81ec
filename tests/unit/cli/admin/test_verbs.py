import pytest
import typer
from cli_service import CliService
from sqlalchemy.orm import Session
from typer.testing import CliRunner
from vitac.cli.admin import verbs
from vitac.cli.admin.consent import NOTHING_CHANGED


@pytest.fixture
def app() -> typer.Typer:
    made = typer.Typer()

    @verbs.change(made, done="added {name}", unknown=("id",))
    def add(_: Session, name: str) -> dict[str, object]:
        """Add something."""
        return {"id": 7, "name": name}

    @verbs.list_records(made, "name", none="Nothing.")
    def list_all(_: Session) -> list[dict[str, object]]:
        """List everything."""
        return []

    return made


def test_a_change_prints_its_sentence_and_what_a_dry_run_does_not_know_is_left_out(
    app: typer.Typer, service: CliService
) -> None:
    done = CliRunner().invoke(app, ["add", "peg"], env=service.environment)
    tried = CliRunner().invoke(app, ["add", "peg", "--dry-run", "--json"], env=service.environment)
    assert done.stdout == "added peg\n"
    assert '"id": null' in tried.stdout
    assert NOTHING_CHANGED in tried.stderr
    assert CliRunner().invoke(app, ["list"], env=service.environment).stdout == "Nothing.\n"


def test_a_verb_works_in_a_session() -> None:
    with pytest.raises(TypeError, match="expected a session as the first parameter of add"):
        verbs.show(typer.Typer())(add)


def add(name: str) -> str:
    return name
