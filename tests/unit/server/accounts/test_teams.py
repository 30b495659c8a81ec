import threading

import pytest
from sqlalchemy import select
from vitac.server.accounts import teams, tokens
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.database.models import Team
from vitac.server.database.states import Role
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import CONSOLE, Principal

from competitions import make_competition, put_in_place


def register(database: Database, name: str) -> str:
    with database.transaction() as session:
        return teams.register(session, None, name=name).name


def test_names_are_shown_composed_with_single_spaces(database: Database) -> None:
    assert register(database, "  Équipe \t rouge ") == "Équipe rouge"


def test_a_raised_digit_is_the_digit_and_a_second_team_with_it_is_refused(database: Database) -> None:
    assert register(database, "Team A²") == "Team A2"
    with pytest.raises(ServiceError) as refused:
        register(database, "Team A2")
    assert refused.value.code is ProblemCode.TEAM_EXISTS


@pytest.mark.parametrize("same", ["team a", "TEAM  A", "Ｔｅａｍ Ａ"])
def test_names_that_look_alike_are_one_name(database: Database, same: str) -> None:
    register(database, "Team A")
    with pytest.raises(ServiceError) as refused:
        register(database, same)
    assert refused.value.code is ProblemCode.TEAM_EXISTS
    with database.transaction() as session:
        assert teams.find(session, same).name == "Team A"


MARKED = ["a" + "\u0301\u0302" * 20, "x\u0301\u0301", "a\u20dd"]
DISGUISED = (
    "ViTac Arena 2025",
    "Official ViTac",
    "The Jury",
    "Staff 1",
    "adm1n",
    "a.d.m.i.n",
    "M0derator",
    "Organizing team",
)
BLANKS = ["\u3164\u3164", "\u2800\u2800", "a\u200bb", "a\ufe0fb", "a\u034fb", "\u115f\u1160", "\xad\xad"]


@pytest.mark.parametrize(
    ("taken", "name"),
    [
        ("Robot Lab", "R\u043eb\u043et Lab"),  # Cyrillic o
        ("Pilot", "\u03a1ilot"),  # Greek Rho
        ("Robot Lab", "RobotLab"),
        ("Team 1", "Team I"),
        ("Team O", "Team 0"),
        ("Team l", "Team |"),
        ("modern", "rnodern"),
        ("Team A", "Team_A"),
        ("Team A", "Team A."),
        ("Team A", "Te\u0301am A"),
        ("Team A", "\u13a2eam \U0001d4d0"),  # Cherokee, mathematical script
        ("Wasp", "\u0561asp"),  # Armenian
        ("Robot Lab", "R\u1d0f\u0253ot Lab"),
        ("Robot Lab", "R0bot Lab"),
        ("Lima", "Iima"),
        ("Team A", "Team~A"),
        ("Team A", "Team A+"),
        ("Team A", "Team \u1d00"),  # a small capital
        ("Ants", "\u2c65nts"),  # with a stroke
    ],
)
def test_names_that_readers_would_confuse_are_refused_as_taken(database: Database, taken: str, name: str) -> None:
    register(database, taken)
    with pytest.raises(ServiceError, match=r"looks like that of team") as refused:
        register(database, name)
    assert refused.value.code is ProblemCode.TEAM_EXISTS


def test_names_in_other_scripts_are_not_refused(database: Database) -> None:
    register(database, "Robot Lab")
    register(database, "Klm")
    register(database, "AI Lab")
    for name in ("Robot Lab 2", "Роботы", "ρομπότ", "ロボット", "Team \N{ROBOT FACE}", "Kim", "AL Lab", "Яндекс Lab"):
        assert register(database, name) == name


def test_words_of_latin_and_cyrillic_letters_are_refused(database: Database) -> None:
    with pytest.raises(ServiceError, match="mixes Latin and Cyrillic letters"):
        register(database, "T\u0454am A")


def test_names_with_a_reserved_word_of_another_meaning_are_not_refused(database: Database) -> None:
    for name in ("Support Vectors", "Badminton", "System 1", "Organisms", "ManiSkill-ViTac fans", "The Team of Arena"):
        assert register(database, name) == name


def test_names_of_those_who_run_the_service_are_theirs(database: Database) -> None:
    for name in (
        "Organizers",
        "The 0rganizer",
        "ADMIN",
        "adm\u0456n team",
        "vitac_arena",
        "V\u0456Tac",
        "Jury",
        *DISGUISED,
    ):
        with pytest.raises(ServiceError, match="reserved"):
            register(database, name)
        with database.transaction() as session:
            assert teams.register(session, CONSOLE, name=name).name == name
            session.rollback()  # some look like one another


def test_the_name_of_a_judge_is_no_name_of_a_team(database: Database) -> None:
    with database.transaction() as session:
        tokens.issue(session, CONSOLE, role=Role.JUDGE, label="Prof. X", lifetime=None)
        for name in ("Prof. X", "prof x", "PROF X"):
            with pytest.raises(ServiceError, match="is that of somebody who runs this service"):
                teams.register(session, None, name=name)
        teams.register(session, None, name="Prof. Y")


def test_an_anonymous_competition_does_not_say_which_names_are_taken(database: Database) -> None:
    register(database, "Ants")
    with database.transaction() as session:
        put_in_place(session, make_competition(anonymous=True))
    said = []
    for name in ("Ants", "Ant\u0455", "ants.", "Admin"):
        with pytest.raises(ServiceError) as refused:
            register(database, name)
        said.append(refused.value.detail.replace(repr(name), "NAME"))
    assert len(set(said)) == 1


def test_a_name_that_hides_another_team_is_refused_and_does_not_tell_which(database: Database) -> None:
    register(database, "Ants")
    with database.transaction() as session:
        ants, bees = teams.find(session, "Ants"), teams.register(session, CONSOLE, name="Bees")
        ants.pseudonym = "Team 0A1B2C3D4E"
        for taken in ("Team 0A1B2C3D4E", "team  0a1b2c3d4e", "Team OA1B2C3D4E", "\u0422eam 0A1B2C3D4E"):
            with pytest.raises(ServiceError, match="another team is shown") as refused:
                teams.register(session, None, name=taken)
            assert (refused.value.code, "Ants" in str(refused.value)) == (ProblemCode.TEAM_EXISTS, False)
        with pytest.raises(ServiceError, match="another team is shown"):
            teams.rename(session, CONSOLE, bees, "Team 0A1B2C3D4E")
        assert bees.name == "Bees"


def test_compatibility_forms_are_shown_as_what_they_stand_for(database: Database) -> None:
    assert register(database, "Ｔｅａｍ\u2460 ﬁn") == "Team1 fin"


def test_names_that_cannot_be_shown_are_refused(database: Database) -> None:
    for name in ["", " ", "a" * 65, "two\x00parts", "turned \u202e around", *MARKED, *BLANKS]:
        with pytest.raises(ServiceError) as refused:
            register(database, name)
        assert refused.value.code is ProblemCode.INVALID_REQUEST


def test_a_name_may_be_one_character_as_that_of_the_organizers_logs(database: Database) -> None:
    with database.transaction() as session:
        assert teams.register(session, CONSOLE, name="1").name == "1"


def test_of_two_registrations_at_once_one_wins(database: Database) -> None:
    outcomes: list[str] = []
    barrier = threading.Barrier(5)

    def run() -> None:
        barrier.wait()
        try:
            outcomes.append(register(database, "Team A"))
        except ServiceError as error:
            outcomes.append(error.code)

    threads = [threading.Thread(target=run) for _ in range(5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(outcomes) == ["Team A", *["team_exists"] * 4]


def test_team_is_found_by_name_and_id_and_listed_in_order(database: Database) -> None:
    with database.transaction() as session:
        second, first = (teams.register(session, CONSOLE, name=name) for name in ("beta", "Alpha"))
        assert teams.find(session, "BETA").id == teams.find(session, str(second.id)).id == second.id
        assert [team.id for team in session.scalars(select(Team).order_by(Team.name_key))] == [first.id, second.id]
    with pytest.raises(ServiceError, match="There is no team 'gamma'"), database.transaction() as session:
        teams.find(session, "gamma")


def test_a_disqualified_team_is_reinstated_and_both_are_recorded(database: Database) -> None:
    register(database, "Team A")
    with database.transaction() as session:
        team = teams.find(session, "Team A")
        teams.disqualify(session, CONSOLE, team, " two   accounts ")
        assert teams.organizer_team_view(session, team).disqualified_for == "two accounts"
        session.flush()
        with pytest.raises(ServiceError, match="is disqualified: two accounts"):
            teams.disqualify(session, CONSOLE, team, "again")
        for _ in range(2):
            teams.reinstate(session, CONSOLE, team)
        assert team.disqualified_at is None
        undone, done = newest_entries(session, 2)
    assert (done.action, done.before, done.after) == ("team.disqualify", {"reason": None}, {"reason": "two accounts"})
    assert (undone.action, undone.before) == ("team.reinstate", {"reason": "two accounts"})


def test_a_reason_can_be_shown(database: Database) -> None:
    register(database, "Team A")
    for reason in ("", "x", "a" * 201, "two\x00parts"):
        with pytest.raises(ServiceError), database.transaction() as session:
            teams.disqualify(session, CONSOLE, teams.find(session, "Team A"), reason)


@pytest.mark.parametrize("role", [Role.TEAM, Role.JUDGE])
def test_only_organizers_disqualify(database: Database, role: Role) -> None:
    register(database, "Team A")
    with database.transaction() as session:
        team, by = teams.find(session, "Team A"), Principal(role=role)
        with pytest.raises(ServiceError, match="Only organizers"):
            teams.disqualify(session, by, team, "a reason")
        with pytest.raises(ServiceError, match="Only organizers"):
            teams.reinstate(session, by, team)
