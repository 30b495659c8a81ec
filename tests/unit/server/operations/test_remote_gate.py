"""Policies that dial in, and what becomes of the lines; tests/unit/cli/client/test_remote.py has the command."""

import threading
from contextlib import ExitStack

import numpy as np
import pytest
from gates import gate
from policy_servers import ACTION, openpi, packed, serving
from vitac.cli.client.remote import GateRefused, connected
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.verdicts import EpisodeCut, PolicyFailed, VerdictCode
from vitac.evaluator.remote.description import RemoteProtocol, RemoteServer
from vitac.evaluator.remote.line import inner_address
from vitac.evaluator.remote.session import RemoteSession
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.sync.server import ServerConnection

OBSERVATION = {"x": np.zeros(1, np.float32)}
OPENPI = RemoteServer(protocol=RemoteProtocol.OPENPI)


def play(address: str, team: str = "Team A", steps: int = 3, limits: Limits | None = None) -> list[float]:
    with (
        RemoteSession(inner_address(address, team), OPENPI, limits) as session,
        session.episode(task="t", action_shape=(3,)) as policy,
    ):
        return [float(policy.act(OBSERVATION)[0]) for _ in range(steps)]


HONEST = openpi(lambda _: packed({"actions": ACTION}))


def test_a_policy_that_dials_in_plays_one_session_after_the_other() -> None:
    with gate() as (policies, players), serving(HONEST) as server:
        with connected(policies, "of Team A", server, lines=1):
            assert play(players) == [1.0] * 3
            assert play(players) == [1.0] * 3
        with connected(policies, "of Equipe / é", server, lines=2):
            assert play(players, "Equipe / é") == [1.0] * 3


def test_a_cut_costs_its_episode_and_the_next_one_plays_on_a_new_line() -> None:
    asked = iter(range(100))

    def cut_the_third(connection: ServerConnection) -> None:
        connection.send(packed({}))
        for _ in connection:
            if next(asked) == 2:
                return
            connection.send(packed({"actions": ACTION}))

    with (
        gate() as (policies, players),
        serving(cut_the_third) as server,
        connected(policies, "of Team A", server, lines=1),
        RemoteSession(inner_address(players, "Team A"), OPENPI) as session,
    ):
        with pytest.raises(EpisodeCut), session.episode(task="t", action_shape=(3,)) as policy:
            _ = [policy.act(OBSERVATION) for _ in range(5)]
        with session.episode(task="t", action_shape=(3,)) as policy:
            assert [float(policy.act(OBSERVATION)[0]) for _ in range(5)] == [1.0] * 5


def test_nobody_waits_longer_than_the_gate_for_a_policy_that_is_not_there() -> None:
    with gate(wait_s=0.5) as (policies, players), serving(HONEST) as server:
        with connected(policies, "of Team B", server, lines=1), pytest.raises(PolicyFailed) as caught:
            play(players)  # of team A, whose policy is not connected
        assert caught.value.verdict is VerdictCode.LINE_LOST
        assert "no policy of the team was connected" in caught.value.message


def test_a_policy_that_leaves_ends_the_session_at_once() -> None:
    def silent(connection: ServerConnection) -> None:
        connection.send(packed({}))
        next(iter(connection))
        left.set()
        for _ in connection:
            pass

    left = threading.Event()
    with gate(wait_s=0.5) as (policies, players), serving(silent) as server:
        lines = connected(policies, "of Team A", server, lines=1)
        lines.__enter__()
        leaving = threading.Thread(target=lambda: (left.wait(), lines.__exit__(None, None, None)))
        leaving.start()
        with pytest.raises(EpisodeCut):
            play(players)
        leaving.join()


def test_a_token_that_is_none_is_refused_and_a_team_has_so_many_lines() -> None:
    with gate() as (policies, _):
        with pytest.raises(GateRefused, match="Expected a token"), connected(policies, "no", "ws://x:1", lines=1):
            pass
        headers = {"Authorization": "Bearer of Team A"}
        with ExitStack() as lines:
            held = [lines.enter_context(connect(policies, additional_headers=headers)) for _ in range(17)]
            assert {line.recv() for line in held[:16]} == {"waiting"}
            with pytest.raises(ConnectionClosed, match="has 16 lines that wait"):
                held[16].recv()
