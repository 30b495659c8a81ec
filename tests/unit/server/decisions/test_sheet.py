from uuid import UUID

import pytest
from measured_figures import GRASP, TOUCH, start
from service_factories import TRACK, make_principal, make_score, sha256, submit_scored
from sqlalchemy import update
from submission_steps import refused
from vitac.evaluator.figures.figures import FiguresPart
from vitac.evaluator.version import evaluator_version
from vitac.server.competitions import sealing
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation, Submission, SubmissionFile
from vitac.server.database.states import FileRole, Role
from vitac.server.decisions.judging import declare_conflict, give_marks
from vitac.server.decisions.sheet import Sheet, SheetEntry, sheets
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import CONSOLE, VISITOR, Principal

from competitions import make_competition, open_now, put_in_place, stored_stage

JUDGE = Principal(role=Role.JUDGE, token_id=UUID(int=7), judge_name="Dr. Y")
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
