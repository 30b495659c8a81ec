"""Models whose archive is alike to an earlier one of another team are noted for organizers, and stay ranked."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from service_factories import TASK, TRACK, RecordOf, make_principal, make_record, make_upload, play_all, sha256
from submission_steps import refused
from vitac.evaluator.episodes.records import ActionSequence, EpisodeRecord
from vitac.evaluator.submission.likeness import make_sketch
from vitac.server.database.engine import Database
from vitac.server.errors import ProblemCode
from vitac.server.evaluations.near_copies import compare_archives, list_archive_copies, list_near_copies
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.operations.desk import troubles
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import creation

from competitions import shown_stage

CODE = "class Policy:\n    def act(self, observation):\n        return self.layer @ observation['marker_flow'][0][0]\n"


def acting(seed: int) -> RecordOf:
    """Records of a policy that acts by its seed."""

    def record_of(episode: int, *, task: str) -> EpisodeRecord:
        actions = np.random.default_rng((seed, episode)).uniform(-0.9, 0.9, (3, 3)).astype(np.float32)
        hashes = tuple(sha256(f"{seed} {episode} {step}") for step in range(4))
        return make_record(episode, task=task, actions=ActionSequence.from_array(actions), state_hashes=hashes)

    return record_of


@pytest.fixture
def teams(database: Database) -> tuple[Principal, Principal]:
    with database.transaction() as session:
        return make_principal(session, "Source"), make_principal(session, "Other")


def play_model(database: Database, folder: Path, by: Principal, name: str, weights: int, acts: int) -> None:
    """Submit and evaluate a model with weights of a seed, a little changed, which acts by another seed."""
    (folder / name).mkdir()
    (folder / name / "policy.py").write_text(CODE)
    trained = np.random.default_rng(weights).standard_normal(1000)
    noise = np.random.default_rng(len(name)).standard_normal(1000)
    np.save(folder / name / "weights.npy", trained + 0.01 * noise)
    upload = make_upload(name, name=name, archive_sketch=make_sketch(folder / name).to_bytes())
    with database.transaction() as session:
        submission = creation.create(session, by, upload)[0]
    play_all(database, submission, acting(acts))


def found(database: Database) -> list[tuple[str, str]]:
    with database.transaction() as session:
        return sorted(
            (one.submission_name, one.earlier_submission_name) for one in list_archive_copies(session, CONSOLE)
        )


def test_tuned_weights_of_another_team_are_noted_and_stay_ranked(
    database: Database, teams: tuple[Principal, Principal], tmp_path: Path
) -> None:
    play = partial(play_model, database, tmp_path)
    play(teams[0], "source", weights=1, acts=1)
    play(teams[1], "seed", weights=2, acts=2)
    assert found(database) == []
    play(teams[1], "tuned", weights=1, acts=3)
    play(teams[0], "again", weights=1, acts=4)
    assert found(database) == [("tuned", "source")]
    with database.transaction() as session:
        (one,) = list_archive_copies(session, CONSOLE)
        assert (one.code, one.team, one.track) == (1.0, "Other", TRACK)
        assert (one.weights or 0) > 0.99
        entries = leaderboard(session, shown_stage(session, TRACK), task=TASK).view.entries
        assert all(entry.rank for entry in entries)
        assert [trouble.submission for trouble in troubles(session, CONSOLE)] == ["tuned"]
    with refused(ProblemCode.FORBIDDEN), database.transaction() as session:
        list_archive_copies(session, teams[0])


def test_near_copies_are_shown_with_how_alike_their_archives_are(
    database: Database, teams: tuple[Principal, Principal], tmp_path: Path
) -> None:
    for by, name in zip(teams, ("source", "same"), strict=True):
        play_model(database, tmp_path, by, name, weights=1, acts=1)
    with database.transaction() as session:
        (one,) = compare_archives(session, CONSOLE, list_near_copies(session, CONSOLE))
    assert (one.code, round(one.weights or 0, 2)) == (1.0, 1.0)
