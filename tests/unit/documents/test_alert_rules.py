"""Prometheus itself reads the alerts, and each fires on the figures of its incident and on no others.

Needs promtool, which Debian's package `prometheus` has.
"""

import json
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

PROMTOOL = shutil.which("promtool")
pytestmark = pytest.mark.skipif(PROMTOOL is None, reason="promtool is not installed")

UP = 'up{job="vitac-arena", instance="a"}'
QUEUED = 'vitac_shards{state="queued"}'
READY, REFUSING, LOST = (f'vitac_workers{{state="{state}"}}' for state in ("ready", "refusing", "lost"))
EPISODES = 'vitac_episodes_total{task="peg-insertion"}'
RETRIES = 'vitac_shard_retries_total{reason="broke"}'
REQUESTS = 'vitac_request_seconds_count{status="2xx"}'
FAILED = 'vitac_request_seconds_count{status="5xx"}'
WITNESS = 'vitac_witness_behind_seconds{witness="ants.example/v"}'
CLAIMED_IN_TIME, CLAIMED_LATE, CLAIMED = (f'vitac_claim_seconds_bucket{{le="{le}"}}' for le in ("0.1", "1.0", "+Inf"))
HEALTHY = {
    UP: "1x480", "vitac_database_up": "1x480", QUEUED: "5x480", READY: "2x480", REFUSING: "0x480", LOST: "0x480",
    EPISODES: "0+50x480", RETRIES: "0+0x480", "vitac_shards_given_up_total": "0x480",
    "vitac_shard_idle_seconds": "4x480", "vitac_evaluations_unserved": "0x480",
    "vitac_oldest_evaluation_seconds": "90x480", WITNESS: "30x480", REQUESTS: "0+100x480", FAILED: "0+0x480",
    CLAIMED_IN_TIME: "0+100x480", CLAIMED_LATE: "0+100x480", CLAIMED: "0+100x480", "vitac_server_disk_bytes": "100x480",
    "vitac_server_disk_free_bytes": "40x480", 'vitac_worker_disk_bytes{host="h"}': "100x480",
    'vitac_worker_disk_free_bytes{host="h"}': "40x480",
}  # fmt: skip
"""Samples every 15 s for two hours, as Prometheus writes them: a value, its change and how often."""
REFUSES = " ".join(["1 1 1 1 0"] * 96)
"""A worker that refuses looks again every minute, as another process of the list."""
INCIDENTS: dict[str, Mapping[str, str]] = {
    "VitacDatabaseDown": {"vitac_database_up": "0x480"},
    "VitacServerDown": {UP: "0x480"},
    "VitacNoWorkers": {READY: "0x480"},
    "VitacQueueStands": {EPISODES: "9+0x480"},
    "VitacWitnessBehind": {WITNESS: "4000x480"},
    "VitacShardStands": {"vitac_shard_idle_seconds": "61x480"},
    "VitacEvaluationsUnserved": {"vitac_evaluations_unserved": "1x480"},
    "VitacQueueOld": {"vitac_oldest_evaluation_seconds": "14401x480"},
    "VitacWorkersRefuse": {REFUSING: REFUSES},
    "VitacWorkersLost": {LOST: "1x480"},
    "VitacShardRetries": {RETRIES: "0+1x480"},
    "VitacShardsGivenUp": {"vitac_shards_given_up_total": "0x400 1x80"},
    "VitacClaimsSlow": {CLAIMED_IN_TIME: "0+90x480"},
    "VitacRequestsFail": {FAILED: "0+2x480"},
    "VitacDiskFull": {'vitac_worker_disk_free_bytes{host="h"}': "9x480"},
}
AT = "110m"


@pytest.fixture(scope="module")
def rules(repository: Path) -> Path:
    return repository / "docs" / "monitoring" / "alerts.yaml"


def promtool(*arguments: str | Path) -> str:
    assert PROMTOOL is not None
    done = subprocess.run([PROMTOOL, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def expected_alert(rule: dict[str, Any]) -> dict[str, Any]:
    own = {
        "VitacServerDown": {"job": "vitac-arena", "instance": "a"},
        "VitacWitnessBehind": {"witness": "ants.example/v"},
    }
    labels = own.get(rule["alert"], {})
    summary = rule["annotations"]["summary"]
    for name, value in labels.items():
        summary = summary.replace(f"{{{{ $labels.{name} }}}}", value)
    return {"exp_labels": {**rule["labels"], **labels}, "exp_annotations": {"summary": summary}}


def test_prometheus_reads_the_alerts(rules: Path) -> None:
    assert f"{len(INCIDENTS)} rules found" in promtool("check", "rules", rules)


def test_each_alert_fires_in_its_incident_and_none_in_a_healthy_service(rules: Path, tmp_path: Path) -> None:
    known = {rule["alert"]: rule for rule in yaml.safe_load(rules.read_text())["groups"][0]["rules"]}
    assert known.keys() == INCIDENTS.keys()
    tests = [scenario(HEALTHY, {name: [] for name in known})]
    tests += [
        scenario({**HEALTHY, **changed}, {name: [expected_alert(known[name])]}) for name, changed in INCIDENTS.items()
    ]
    content = {"rule_files": [str(rules)], "evaluation_interval": "15s", "tests": tests}
    (tmp_path / "tests.json").write_text(json.dumps(content))  # JSON is YAML
    promtool("test", "rules", tmp_path / "tests.json")


def scenario(series: Mapping[str, str], expected: Mapping[str, list[dict[str, Any]]]) -> dict[str, Any]:
    return {
        "interval": "15s",
        "input_series": [{"series": name, "values": values} for name, values in series.items()],
        "alert_rule_test": [
            {"eval_time": AT, "alertname": name, "exp_alerts": alerts} for name, alerts in expected.items()
        ],
    }
