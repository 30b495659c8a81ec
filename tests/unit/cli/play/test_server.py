"""The page of `vitac play` over HTTP: what it shows, plays and refuses."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from vitac.cli.play.server import PlayServer
from vitac.training.demonstrations.collecting import read_demonstrations
from vitac.training.demonstrations.hand_play import HandPlay


@pytest.fixture
def page(tmp_path: Path) -> Iterator[httpx.Client]:
    played = HandPlay("peg-insertion", tmp_path)
    with played.storing(), PlayServer(played) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        with httpx.Client(base_url=server.address, timeout=60) as client:
            yield client
        server.shutdown()
        thread.join()


def ask(page: httpx.Client, what: str, **content: Any) -> dict[str, Any]:
    found: dict[str, Any] = page.post(what, json=content).raise_for_status().json()
    return found


def test_an_episode_is_played_to_its_end_and_the_next_one_begins(page: httpx.Client, tmp_path: Path) -> None:
    state = ask(page, "state")
    assert (state["episode"], state["env_step"], state["max_steps"], state["end"]) == (1, 0, 8, None)
    assert [each["name"] for each in state["actions"]] == ["x", "y", "theta"]
    assert state["control_rate_hz"] == 4.0
    while state["end"] is None:
        state = ask(page, "step", action=[0.0, 0.0, 0.0])
    assert state["played"] == len(list(read_demonstrations(tmp_path / "peg-insertion" / "demonstrations.jsonl"))) == 1
    assert state["end"].endswith(".")
    assert ask(page, "next")["episode"] == 2


def test_episodes_with_a_look_at_the_scene_count_for_no_rate(page: httpx.Client) -> None:
    scene = ask(page, "scene")
    assert set(scene) == {"fixed", "held", "limits_mm"}
    state = ask(page, "state")
    while state["end"] is None:
        state = ask(page, "step", action=[0.0, 0.0, 0.0])
    assert state["played"] == 0


def test_what_does_not_fit_is_answered_with_a_sentence(page: httpx.Client) -> None:
    for what, content in (("step", {"action": [2.0, 0.0, 0.0]}), ("step", {}), ("fly", {}), ("step", {"action": "up"})):
        refused = page.post(what, json=content)
        assert refused.status_code == 422
        assert refused.json()["error"]
    assert ask(page, "state")["env_step"] == 0


def test_page_and_its_script_are_there_with_the_secret_only(page: httpx.Client) -> None:
    assert 'src="page.js"' in page.get("").text
    script = page.get("page.js")
    assert script.headers["content-type"].startswith("text/javascript")
    assert "default-src 'none'" in script.headers["content-security-policy"]
    root = str(page.base_url).rsplit("/", 2)[0]
    for address in ("/", "/page.js", "/guess/page.js"):
        assert httpx.get(root + address).status_code == 404
    assert httpx.post(f"{root}/guess/step", json={"action": [0, 0, 0]}).status_code == 404
    assert page.get("../command.py").status_code == 404
