"""Submits many short submissions from many teams, again and again until each has been accepted."""

import io
import threading
import time
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field

import httpx

TEAMS = 40
THREADS = 3
KINDS = 4
"""So many policies act differently; each submission is one of them with a comment of its own."""

EPISODES = 2
MANIFEST = "track: chaos\ntasks: [chaos-insertion]\nname: short {number}\n"
POLICY = """
# submission {number}
import numpy as np

class Policy:
    def reset(self, task):
        self.steps = 0

    def act(self, observation):
        self.steps += 1
        moved = observation["marker_flow"][:, 1] - observation["marker_flow"][:, 0]
        sum_px = moved.mean(axis=(0, 1)).sum()
        return np.clip(sum_px * np.ones(3) / 20 + {kind} * self.steps / 50, -1, 1).astype(np.float32)
"""


def archive(number: int) -> bytes:
    """The zip of one submission."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        for name, text in (("submission.yaml", MANIFEST), ("policy.py", POLICY)):
            content = text.format(number=number, kind=number % KINDS)
            file.writestr(zipfile.ZipInfo(f"Chaos/{name}", (2025, 1, 1, 0, 0, 0)), content)
    return buffer.getvalue()


@dataclass(kw_only=True)
class ManySubmissions:
    """Submissions 0 to count - 1, sent by a few threads.

    Attributes:
        address: of the service.
        count: how many.
        accepted: id by number, once the service has accepted it.
        refusals: answers and errors that led to another try, by status or name.
        unexpected: answers that the service should never give.
    """

    address: str
    count: int
    accepted: dict[int, str] = field(default_factory=dict)
    refusals: dict[str, int] = field(default_factory=dict)
    unexpected: list[str] = field(default_factory=list)
    _tokens: list[str] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _stopping: threading.Event = field(default_factory=threading.Event)
    _threads: list[threading.Thread] = field(default_factory=list)

    def register_teams(self) -> None:
        """Before anything is disturbed: a registration cannot be repeated."""
        for number in range(TEAMS):
            answer = httpx.post(f"{self.address}/api/v1/teams", json={"name": f"Team {number}"}, timeout=60)
            answer.raise_for_status()
            self._tokens.append(answer.json()["token"]["secret"])

    def start(self) -> None:
        numbers = iter(range(self.count))
        self._threads = [threading.Thread(target=self._send, args=[numbers], daemon=True) for _ in range(THREADS)]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        self._stopping.set()
        for thread in self._threads:
            thread.join()

    def _send(self, numbers: Iterator[int]) -> None:
        while True:
            with self._lock:
                number = next(numbers, None)
            if number is None:
                return
            while not self._stopping.is_set() and not self._is_accepted(number):
                time.sleep(0.5)

    def _is_accepted(self, number: int) -> bool:
        headers = {"Authorization": f"Bearer {self._tokens[number % TEAMS]}", "Content-Type": "application/zip"}
        url = f"{self.address}/api/v1/submissions?track=chaos"
        try:
            answer = httpx.post(url, content=archive(number), headers=headers, timeout=30)
        except httpx.HTTPError as error:
            self._note(type(error).__name__)
            return False
        if answer.status_code not in (200, 202):
            code = _code_of(answer)
            self._note(f"{answer.status_code} {code}")
            if code is None or answer.status_code not in (429, 503, 507):
                self.unexpected.append(f"{answer.status_code} {answer.text[:300]}")
            return False
        with self._lock:
            self.accepted[number] = answer.json()["id"]
        return True

    def _note(self, what: str) -> None:
        with self._lock:
            self.refusals[what] = self.refusals.get(what, 0) + 1


def _code_of(answer: httpx.Response) -> str | None:
    """The code of a problem; None of an answer that is none."""
    try:
        return str(answer.json()["code"])
    except (ValueError, KeyError, TypeError):
        return None
