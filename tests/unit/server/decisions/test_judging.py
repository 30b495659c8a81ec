from concurrent.futures import ThreadPoolExecutor
from typing import Any
from uuid import UUID

import pytest
from measured_figures import GRASP, TOUCH, start
from service_factories import TASK, TRACK, make_principal, make_score, sha256, submit_scored
from sqlalchemy import select, update
from submission_steps import refused
from vitac.evaluator.figures.figures import (
    FiguresPart,
    GraspFigures,
    Information,
    SensitivityMap,
    SensorFigures,
    TouchFigures,
)
from vitac.evaluator.version import evaluator_version
from vitac.server.accounts import merging, teams, tokens
from vitac.server.audit import newest_entries
from vitac.server.competitions import sealing
from vitac.server.database.engine import Database
from vitac.server.database.models import CompetitionRow, Evaluation, JudgingMark, Submission, SubmissionFile
from vitac.server.database.states import FileRole, Role
from vitac.server.decisions.judging import Sheet, SheetEntry, declare_conflict, give_marks, judged, percentiles, sheets
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.views.decisions import JudgedTeamView

from competitions import make_competition, open_now, put_in_place, shown_stage, stored_stage

MARKS = {"structure": 8.0, "clarity": 6.0}
JUDGE = Principal(role=Role.JUDGE, token_id=UUID(int=7), judge_name="Dr. Y")


@pytest.fixture
def stage(database: Database) -> dict[str, Submission]:
    """An open stage of a judged track, without weight on figures, with two scored teams."""
    content = make_competition()
    content["tracks"][TRACK]["judging"] = {
        "criteria": [{"name": "structure", "title": "The structure"}, {"name": "clarity", "title": "The words"}],
        "weights": {"success": 0.5, "judges": 0.5, "figures": 0},
    }
    with database.transaction() as session:
        put_in_place(session, open_now(content))
        return {
            name: submit_scored(session, make_principal(session, name), name, {TASK: make_score(successes)})
            for name, successes in (("Ants", 80), ("Bees", 60))
        }


def mark(
    database: Database, submission: Submission, judge: str | None = None, by: Principal = CONSOLE, **marks: float
) -> None:
    with database.transaction() as session:
        give_marks(session, by, submission.id, MARKS | marks, judge=judge)


def shown(database: Database) -> dict[str, JudgedTeamView]:
    with database.transaction() as session:
        return {team.team: team for team in judged(session, CONSOLE, shown_stage(session, TRACK))}


def test_marks_of_two_judges_make_mean_spread_and_total(database: Database, stage: dict[str, Submission]) -> None:
    mark(database, stage["Bees"], "Prof. X")
    assert shown(database)["Bees"].total is None, "one judge is not enough"
    mark(database, stage["Bees"], by=JUDGE, structure=10.0, clarity=10.0)
    found = shown(database)
    bees = found["Bees"]
    assert bees.judges == ("Dr. Y", "Prof. X")
    assert bees.mark == 8.5
    assert bees.spread == pytest.approx(4.5**0.5)
    assert [(each.criterion, each.mean) for each in bees.criteria] == [("structure", 9.0), ("clarity", 8.0)]
    assert bees.total == pytest.approx(0.5 * bees.success_rate + 0.5 * 0.85)
    assert list(found) == ["Bees", "Ants"], "those without a total come last"
    assert found["Ants"].mark is None


def test_new_marks_of_a_judge_replace_the_old_ones_in_the_audit_log_too(
    database: Database, stage: dict[str, Submission]
) -> None:
    mark(database, stage["Ants"], "Prof. X")
    mark(database, stage["Ants"], "Prof. X", clarity=1.0)
    assert shown(database)["Ants"].mark == 4.5
    with database.transaction() as session:
        entry = newest_entries(session, 1)[0]
    assert entry.before is not None
    assert 6.0 in entry.before["marks"].values()
    assert entry.after["marks"]["clarity"] == 1.0


def test_a_judge_with_a_conflict_of_interest_judges_the_others_only(
    database: Database, stage: dict[str, Submission]
) -> None:
    mark(database, stage["Ants"], by=JUDGE)
    mark(database, stage["Bees"], by=JUDGE)
    with database.transaction() as session:
        declare_conflict(session, JUDGE, "Ants", "advises them")
        declare_conflict(session, JUDGE, "Ants", "advises two of them")
    found = shown(database)
    assert (found["Ants"].mark, found["Ants"].conflicts) == (None, ("Dr. Y",))
    assert found["Bees"].judges == ("Dr. Y",)
    with pytest.raises(Exception, match="advises two of them"):
        mark(database, stage["Ants"], by=JUDGE)


def test_marks_from_before_a_merge_with_a_team_of_a_conflict_are_shown_as_set_aside(
    database: Database, stage: dict[str, Submission]
) -> None:
    mark(database, stage["Ants"], by=JUDGE)
    mark(database, stage["Ants"], "Prof. X")
    with database.transaction() as session:
        declare_conflict(session, JUDGE, "Bees", "advises them")
        merging.merge(session, CONSOLE, teams.find(session, "Bees"), teams.find(session, "Ants"))
    merged = shown(database)["Ants"]
    assert (merged.judges, merged.conflicts, merged.set_aside) == (("Prof. X",), ("Dr. Y",), ("Dr. Y",))


def test_a_judge_is_one_however_the_marks_come_in(database: Database, stage: dict[str, Submission]) -> None:
    def sign_in() -> Principal:
        with database.transaction() as session:
            made = tokens.issue(session, CONSOLE, role=Role.JUDGE, label="Prof. X", lifetime=None)
            return tokens.authenticate(session, made.secret)

    first = sign_in()
    mark(database, stage["Ants"], by=first)
    mark(database, stage["Ants"], "prof.  x", clarity=1.0)
    with refused(ProblemCode.NAME_TAKEN):
        sign_in()
    assert first.token_id is not None
    with database.transaction() as session:
        tokens.revoke(session, CONSOLE, first.token_id)
    second = sign_in()
    mark(database, stage["Ants"], by=second, clarity=2.0)
    assert shown(database)["Ants"].judges == ("Prof. X",)
    with database.transaction() as session:
        declare_conflict(session, CONSOLE, "Ants", "advises them", judge="PROF. X")
    with pytest.raises(Exception, match="declared a conflict of interest with Ants"):
        mark(database, stage["Ants"], by=second)
    assert shown(database)["Ants"].mark is None


def test_a_judge_who_sends_marks_twice_at_once_has_them_once(database: Database, stage: dict[str, Submission]) -> None:
    mark(database, stage["Ants"], "Prof. X")
    with ThreadPoolExecutor() as pool:
        list(pool.map(lambda given: mark(database, stage["Ants"], by=JUDGE, clarity=given), range(8)))
    with database.transaction() as session:
        rows = session.scalars(select(JudgingMark).where(JudgingMark.judge == JUDGE.judge_name)).all()
    assert sorted(row.criterion for row in rows) == ["clarity", "structure"]


def test_what_is_no_judgement_is_refused(database: Database, stage: dict[str, Submission]) -> None:
    def refuse(code: ProblemCode, by: Principal = CONSOLE, judge: str | None = "X", **marks: Any) -> None:
        with refused(code), database.transaction() as session:
            give_marks(session, by, stage["Ants"].id, MARKS | marks, judge=judge)

    for wrong in (-0.1, 10.1, float("nan"), float("inf")):
        refuse(ProblemCode.INVALID_REQUEST, structure=wrong)
    refuse(ProblemCode.INVALID_REQUEST, beauty=5.0)
    refuse(ProblemCode.INVALID_REQUEST, judge=None)
    team = Principal(role=Role.TEAM, team_id=stage["Ants"].team_id, team_name="Ants")
    refuse(ProblemCode.FORBIDDEN, by=team)
    with refused(ProblemCode.FORBIDDEN), database.transaction() as session:
        judged(session, JUDGE, shown_stage(session, TRACK))
    with refused(ProblemCode.INVALID_REQUEST), database.transaction() as session:
        judged(session, CONSOLE, shown_stage(session, "track_2"))
    with database.transaction() as session:
        row = session.get_one(CompetitionRow, "cup")
        row.finalized_at, row.winners = row.applied_at, []
    refuse(ProblemCode.COMPETITION_FINAL)


def figures(bits: float, pin_mm: float | None, normal_px_n: float | None = 1.0) -> SensorFigures:
    nothing = SensitivityMap(x_mm=(), y_mm=(), normal_px_n=(), shear_px_n=())
    touch = TouchFigures(
        sensitivity=nothing, normal_px_n=normal_px_n, shear_px_n=1.0, pin_mm=pin_mm, edge_mm=(1.0, 1.0)
    )
    return SensorFigures(
        starts=1,
        information=Information(bits=(bits,), bounds=(1.0, 1.0, 1.0), prior=(1.0, 1.0, 1.0)),
        touch=touch,
        grasp=GraspFigures(indentation_mm=1.0, force_n=1.0, smallest_det_f=0.5),
        robustness=(),
        cpu_s=None,
    )


def test_who_is_not_named_in_the_file_is_refused(database: Database, stage: dict[str, Submission]) -> None:
    with database.transaction() as session:
        row = session.get_one(CompetitionRow, "cup")
        judging = row.definition["tracks"][TRACK]["judging"] | {"judges": ["Prof. X", "Dr. Y"]}
        tracks = row.definition["tracks"] | {TRACK: row.definition["tracks"][TRACK] | {"judging": judging}}
        row.definition = row.definition | {"tracks": tracks}
    other = Principal(role=Role.JUDGE, token_id=UUID(int=8), judge_name="Dr. Z")
    for by, judge in ((CONSOLE, "Proff. X"), (CONSOLE, "prof. x"), (other, None)):
        with pytest.raises(ServiceError, match=r"is no judge by .*, expected one of Dr\. Y, Prof\. X"):
            mark(database, stage["Ants"], judge, by=by)
        with database.transaction() as session, refused(ProblemCode.FORBIDDEN):
            declare_conflict(session, by, "Ants", "a cousin", judge=judge)
    mark(database, stage["Ants"], "Prof. X")
    mark(database, stage["Ants"], by=JUDGE)
    assert shown(database)["Ants"].judges == ("Dr. Y", "Prof. X")


def test_figures_are_compared_one_by_one_with_all_other_sensors() -> None:
    best, middle, worst, missing = (UUID(int=number) for number in range(4))
    found = percentiles({best: figures(9, 0.1), middle: figures(5, 0.2), worst: figures(1, 0.3), missing: None})
    # Two of five figures differ: (1 + 1 + 3 x 0.5) / 5 for the best, and the other way round for the worst.
    assert found == {
        best: pytest.approx(0.7),
        middle: pytest.approx(0.5),
        worst: pytest.approx(0.3),
        missing: None,
    }
    # A sensor that senses in no place is the worst in both; the others are equal.
    found = percentiles({best: figures(9, 0.1), worst: figures(9, None, None)})
    assert found == {best: pytest.approx(0.7), worst: pytest.approx(0.3)}
    assert percentiles({best: figures(9, 0.1)}) == {best: 1.0}


def test_marks_and_conflicts_of_a_team_wait_for_each_other(
    database: Database, stage: dict[str, Submission], monkeypatch: pytest.MonkeyPatch
) -> None:
    locked: list[UUID] = []
    monkeypatch.setattr(teams, "lock", lambda _, team: locked.append(team.id))
    mark(database, stage["Ants"], "Prof. X")
    with database.transaction() as session:
        declare_conflict(session, CONSOLE, "Ants", "advises them", judge="Prof. X")
    assert locked == [stage["Ants"].team_id] * 2
    with database.transaction() as session:  # as if the marks had come at the same moment
        session.add(JudgingMark(submission_id=stage["Ants"].id, judge="Prof. X", criterion="structure", mark=9.0))
    ants = shown(database)["Ants"]
    assert (ants.judges, ants.mark, ants.criteria) == ((), None, ())


SENSORS = "track_3"


@pytest.fixture
def measured(database: Database) -> Submission:
    """A submission to a judged track of sensors, with the figures of one start."""
    content = make_competition()
    track = content["tracks"].pop(TRACK)
    del track["stages"][1]
    track["judging"] = {"criteria": [{"name": "structure", "title": "The structure"}]}
    content["tracks"][SENSORS] = track
    with database.transaction() as session:
        put_in_place(session, open_now(content, track=SENSORS))
        team = make_principal(session, "Ants")
        made = submit_scored(session, team, "ridge", {"sensor-design": make_score(80)}, track=SENSORS)
    keep_figures(database, made, None)
    return made


def test_a_sensor_that_is_never_in_the_ranking_takes_no_marks(database: Database, measured: Submission) -> None:
    with database.transaction() as session:
        team = make_principal(session, "Bees")
        scores = {task: make_score(90) for task in ("sensor-standard", "sensor-blind")}
        without = submit_scored(session, team, "dome", scores, track=SENSORS)
    ranked = pytest.raises(ServiceError, match="plays sensor-design, by which track_3 is ranked, got one")
    with ranked as caught, database.transaction() as session:
        give_marks(session, JUDGE, without.id, {"structure": 4.0})
    assert caught.value.code is ProblemCode.INVALID_REQUEST
    assert seen(database, JUDGE)[1].entry.submission_id == measured.id


def keep_figures(database: Database, submission: Submission, commitment: str | None) -> None:
    part = FiguresPart(starts=(start(1, won=True),), touch=TOUCH, grasp=GRASP).model_dump(mode="json")
    facts = {"evaluator_version": evaluator_version(), "shard": 0, "commitment": commitment, "part": part}
    values = {"role": FileRole.FIGURES, "sha256": sha256(str(commitment)), "n_bytes": 1, "name": "part.json"}
    with database.transaction() as session:
        session.add(SubmissionFile(submission_id=submission.id, facts=facts, **values))


def seen(database: Database, by: Principal) -> tuple[Sheet, SheetEntry]:
    with database.transaction() as session:
        (sheet,) = sheets(session, by)
    (entry,) = sheet.entries
    return sheet, entry


def test_judges_see_figures_their_own_marks_and_their_own_conflict(database: Database, measured: Submission) -> None:
    sheet, entry = seen(database, JUDGE)
    assert (sheet.track, sheet.has_sensors, sheet.judged, entry.entry.team) == (SENSORS, True, (), "Ants")
    assert entry.figures is not None
    assert (entry.figures.starts, entry.figures.touch) == (1, TOUCH)
    with database.transaction() as session:
        give_marks(session, JUDGE, measured.id, {"structure": 4.0})
        give_marks(session, CONSOLE, measured.id, {"structure": 9.0}, judge="X")
        declare_conflict(session, CONSOLE, "Ants", "knows them", judge="Y")
    _, entry = seen(database, JUDGE)
    assert (entry.marks, entry.conflict) == ({"structure": 4.0}, None)
    (total,) = seen(database, CONSOLE)[0].judged
    assert (total.mark, total.conflicts, total.figures) == (6.5, ("Y",), 1.0)
    with database.transaction() as session:
        declare_conflict(session, JUDGE, "Ants", "advises them")
    _, entry = seen(database, JUDGE)
    assert (entry.marks, entry.conflict) == ({}, "advises them")


def test_figures_of_starts_on_a_sealed_list_are_for_organizers(database: Database, measured: Submission) -> None:
    with database.transaction() as session:
        commitment = sealing.seal(session, CONSOLE, stored_stage(session, SENSORS, "stage1")).commitment
        session.execute(update(Evaluation).values(commitment=commitment))
    keep_figures(database, measured, commitment)
    judges, organizers = (seen(database, by)[1].figures for by in (JUDGE, CONSOLE))
    assert judges is not None
    assert organizers is not None
    assert (judges.starts, judges.robustness, judges.touch) == (0, (), TOUCH)
    assert organizers.starts == 1


def test_sheets_are_for_judges_and_organizers(database: Database) -> None:
    with database.transaction() as session:
        assert sheets(session, JUDGE) == []
        for by in (VISITOR, make_principal(session, "Ants")):
            with refused(ProblemCode.FORBIDDEN):
                sheets(session, by)
