"""`vitac remote connect` at a gate and a service; tests/unit/server/operations/test_remote_gate.py has the lines."""

import re
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from cli_service import cli_service, submission_folder
from gates import gate
from lerobot_server import chunk, lerobot_names, lerobot_serving
from policy_servers import ACTION, openpi, packed, serving
from vitac.cli.client.remote import GateRefused, gate_address
from vitac.server.operations.remote_gate import find_team

__all__ = ["lerobot_names"]
MANIFEST = """track: track_1
tasks: [peg-insertion]
name: dials in
remote: {protocol: openpi, address: connect}
"""


def test_connects_submits_and_prints_the_result(tmp_path: Path) -> None:
    asked: list[str] = []

    def lookup(secret: str) -> str:
        asked.append(secret)
        return find(secret)

    folder = submission_folder(tmp_path / "mine", MANIFEST)
    with (
        gate(find=lookup) as (policies, players),
        serving(openpi(lambda _: packed({"actions": ACTION}))) as server,
        cli_service(tmp_path / "state", remote_gate=players) as service,
        service.playing(),
    ):
        find = partial(find_team, service.database)
        done = service.run("remote", "connect", str(folder), "--remote", server, "--gate", policies)
        assert done.exit_code == 0, done.output
        assert "result hash" in done.stdout
        assert asked[0] == service.environment["VITAC_TOKEN"]
        refused = service.run_with_input(
            "", "remote", "connect", str(folder), "--remote", server, "--gate", policies, token="vitac_" + "x" * 43
        )
        assert isinstance(refused.exception, GateRefused)


POLICY = """
class Policy:
    def reset(self, task): assert task == "peg-insertion"
    def act(self, observation):
        assert list(observation) == ["relative_motion"]
        return [0.0, 0.0, 0.0]
"""


@pytest.mark.slow
def test_a_folders_own_policy_is_asked_where_it_is_and_its_digest_is_sent(tmp_path: Path) -> None:
    manifest = MANIFEST.replace("remote: {protocol: openpi, address: connect}", "observation_keys: [relative_motion]")
    with (
        gate(find=lambda secret: find_team(service.database, secret)) as (policies, players),
        cli_service(tmp_path / "state", remote_gate=players) as service,
        service.playing(),
    ):
        identities = []
        for number, code in enumerate((POLICY, POLICY + "# another one", "class Policy: ...")):
            folder = submission_folder(tmp_path / f"mine{number}", manifest)
            (folder / "policy.py").write_text(code)
            done = service.run("remote", "connect", str(folder), "--gate", policies)
            if number == 2:  # it cannot answer the blank observation of the upload
                assert "'Policy' object has no attribute" in str(done.exception)
                continue
            assert done.exit_code == 0, done.output
            identities.append(re.search(r"submissions/([0-9a-f-]{36})", done.stdout))
    assert identities[0] is not None
    assert identities[1] is not None
    assert identities[0][1] != identities[1][1]


@pytest.mark.usefixtures("lerobot_names")
def test_a_server_of_lerobot_is_asked_where_it_is_and_its_pickles_stay_there(tmp_path: Path) -> None:
    remote = "remote: {protocol: lerobot, policy: {type: act, path: /model}, observations: {s: relative_motion}}"
    folder = submission_folder(
        tmp_path / "mine", MANIFEST.replace("remote: {protocol: openpi, address: connect}", remote)
    )
    heard: list[Any] = []
    with (
        gate(find=lambda secret: find_team(service.database, secret)) as (policies, players),
        lerobot_serving(lambda asked: chunk(ACTION, asked.timestep), heard) as server,
        cli_service(tmp_path / "state", remote_gate=players) as service,
        service.playing(),
    ):
        done = service.run("remote", "connect", str(folder), "--remote", server, "--gate", policies)
        assert done.exit_code == 0, done.output
        assert "result hash" in done.stdout
        refused = service.run("remote", "connect", str(folder), "--remote", server, "--lines", "2", "--gate", policies)
        assert "one client at a time" in refused.output
        refused = service.run("submit", str(folder))
        assert "`vitac remote connect FOLDER --remote grpc://HOST:PORT`" in str(refused.exception)
    assert {len(each.observation) for each in heard if hasattr(each, "observation")} == {5}  # four numbers and a task


@pytest.mark.parametrize(
    ("server", "expected"),
    [("https://arena.example.org", "wss://arena.example.org/remote"), ("http://h:8000", "ws://h:8000/remote")],
)
def test_gate_is_below_the_address_of_the_service(server: str, expected: str) -> None:
    assert gate_address(server) == expected
