from dataclasses import replace

from service_factories import claim, make_manifest, make_principal, shard_ids, submit
from vitac.server.database.engine import Database
from vitac.server.database.models import Shard
from vitac.server.evaluations.provenance import known_manifest


def test_what_a_task_is_played_with_is_known_from_any_team_but_with_a_sensor_from_the_same_evaluation(
    database: Database,
) -> None:
    with database.transaction() as session:
        shards = [shard_ids(session, submit(session, make_principal(session, team))) for team in ("Team A", "Team B")]
    first, again, others = (claim(database, shard) for shard in (*shards[0][:2], shards[1][0]))
    with database.transaction() as session:
        assert known_manifest(session, others) is None
    with database.transaction() as session:
        session.get_one(Shard, first.work_id).manifest = make_manifest().model_dump(mode="json")
    with database.transaction() as session:
        assert known_manifest(session, others) == known_manifest(session, again) == make_manifest()
        assert known_manifest(session, replace(others, sensor_sha256=64 * "a")) is None
        assert known_manifest(session, replace(again, sensor_sha256=64 * "b")) == make_manifest()
        assert known_manifest(session, replace(again, evaluator_version="0+other")) is None
        assert known_manifest(session, replace(again, task="lock-opening")) is None
        assert known_manifest(session, replace(again, commitment=64 * "c")) is None
