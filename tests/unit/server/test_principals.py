"""What each role may see and change."""

from uuid import UUID

import pytest
from vitac.server.database.states import Role
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import CONSOLE, Principal

OWN, OTHER, TOKEN = UUID(int=1), UUID(int=2), UUID(int=3)
TEAM = Principal(role=Role.TEAM, team_id=OWN, team_name="Touch", token_id=TOKEN)
JUDGE = Principal(role=Role.JUDGE, token_id=TOKEN)
ORGANIZER = Principal(role=Role.ORGANIZER, token_id=TOKEN)


@pytest.mark.parametrize(
    ("who", "sees", "changes"),
    [
        (TEAM, (True, False), (True, False)),
        (JUDGE, (True, True), (False, False)),
        (ORGANIZER, (True, True), (True, True)),
        (CONSOLE, (True, True), (True, True)),
    ],
)
def test_a_team_has_its_own_a_judge_reads_all_and_an_organizer_changes_all(
    who: Principal, sees: tuple[bool, bool], changes: tuple[bool, bool]
) -> None:
    assert (who.may_see(OWN), who.may_see(OTHER)) == sees
    assert (who.may_change(OWN), who.may_change(OTHER)) == changes


@pytest.mark.parametrize("who", [ORGANIZER, CONSOLE])
def test_organizers_pass(who: Principal) -> None:
    who.require_organizer()
    assert who.organizes_service


@pytest.mark.parametrize("who", [TEAM, JUDGE])
def test_others_are_refused_with_what_to_use(who: Principal) -> None:
    assert not who.organizes_service
    with pytest.raises(ServiceError) as refused:
        who.require_organizer()
    assert refused.value.code is ProblemCode.FORBIDDEN
    assert refused.value.detail == "Only organizers may do this; use an organizer's token."


@pytest.mark.parametrize(
    ("who", "name"),
    [
        (TEAM, "team:Touch"),
        (JUDGE, f"judge:{TOKEN}"),
        (ORGANIZER, f"organizer:{TOKEN}"),
        (CONSOLE, "organizer:console"),
    ],
)
def test_the_audit_log_names_the_team_the_token_or_the_console(who: Principal, name: str) -> None:
    assert who.actor == name
