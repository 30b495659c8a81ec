import hashlib
import os
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from cutting_proxy import CuttingProxy
from databases import opened_database
from service_client import MANIFEST, POLICY, Service, running_service, serving
from sqlalchemy import func, select
from vitac.cli.client import pieces
from vitac.cli.client.answers import RequestRefused, ServiceUnreachable
from vitac.cli.client.http import Client
from vitac.cli.client.pieces import CHUNK_BYTES, MISPLACED, PAUSES_S, PieceSender
from vitac.server.api.app import create_app
from vitac.server.database.models import PartialUpload
from worker_fakes import eventually

MEGABYTE = 1_000_000
N_CUTS = 20
CUT_AT = 7 * MEGABYTE


@pytest.fixture
def service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Service]:
    """A service whose clients pause shortly, and so often that none gives up while a busy machine stores a part."""
    monkeypatch.setattr(pieces, "PAUSES_S", (0.01,) * 10_000)
    with opened_database() as database, running_service(database, tmp_path / "state") as service:
        yield service


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    path = tmp_path / "big.zip"
    with zipfile.ZipFile(path, "w") as writer:
        writer.writestr("Track_1/submission.yaml", MANIFEST)
        writer.writestr("Track_1/policy.py", POLICY)
        writer.writestr("Track_1/weights.bin", os.urandom(12 * MEGABYTE))
    return path


def client_at(address: tuple[str, int], service: Service) -> Client:
    return Client(server=f"http://{address[0]}:{address[1]}", token=service.token)


def arrived_before_the_cut(service: Service) -> int:
    """How much counts of the only upload, cut after 7 MB: 4 MiB at once, the rest when the service has seen the cut."""

    def received_bytes() -> int:
        with service.database.transaction() as session:
            return session.scalar(select(func.max(PartialUpload.received_bytes))) or 0

    eventually(lambda: received_bytes() > CUT_AT - MEGABYTE, limit_s=120.0)
    return received_bytes()


def rest_from(start: int, archive: Path) -> list[int]:
    """Positions that one sending of the rest tells."""
    size = archive.stat().st_size
    return [*range(start, size, CHUNK_BYTES), size]


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.slow
def test_an_upload_survives_cuts_at_random_places(service: Service, archive: Path) -> None:
    cuts = [int(cut) for cut in np.random.default_rng(20).integers(1, MEGABYTE, N_CUTS)]
    positions: list[int] = []
    with CuttingProxy(target=service.address, cuts=cuts).running() as proxy:
        made = client_at(proxy.address, service).upload(archive, track="track_1", on_position=positions.append)
    assert proxy.n_cut == N_CUTS
    assert made["archive_sha256"] == sha256(archive)
    assert positions[-1] == archive.stat().st_size


def test_a_command_that_was_killed_goes_on_where_it_ended(service: Service, archive: Path) -> None:
    class Killed(BaseException):
        pass

    def kill(position: int) -> None:
        if position > CUT_AT:
            raise Killed

    client = client_at(service.address, service)
    with pytest.raises(Killed):
        client.upload(archive, track="track_1", on_position=kill)
    arrived = arrived_before_the_cut(service)
    positions: list[int] = []
    made = client.upload(archive, track="track_1", on_position=positions.append)
    assert made["archive_sha256"] == sha256(archive)
    assert positions == rest_from(arrived, archive)


def test_an_upload_goes_on_at_another_server_process(service: Service, archive: Path) -> None:
    arrived: list[int] = []

    def replace_server() -> None:
        arrived.append(arrived_before_the_cut(service))
        proxy.target = service.address

    positions: list[int] = []
    with serving(create_app(service.settings, services=service.services)) as first:
        proxy = CuttingProxy(target=first, cuts=[CUT_AT], on_cut=replace_server)
        with proxy.running():
            made = client_at(proxy.address, service).upload(archive, track="track_1", on_position=positions.append)
    assert made["archive_sha256"] == sha256(archive)
    assert positions[0] == 0
    assert positions[positions.index(arrived[0]) :] == rest_from(arrived[0], archive)


def test_a_small_submission_takes_three_requests(service: Service, tmp_path: Path) -> None:
    path = tmp_path / "small.zip"
    with zipfile.ZipFile(path, "w") as writer:
        writer.writestr("Track_1/submission.yaml", MANIFEST)
        writer.writestr("Track_1/policy.py", POLICY)
    asked: list[str] = []

    def noted(self: Client, method: str, *arguments: Any, **options: Any) -> httpx.Response:
        asked.append(method)
        return send(self, method, *arguments, **options)

    send = Client.send
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Client, "send", noted)
        client_at(service.address, service).upload(path, track="track_1", on_position=lambda _: None)
    assert asked == ["POST", "PATCH", "POST"]


def sender_to(answers: Callable[[str], httpx.Response], tmp_path: Path, pauses: list[float]) -> PieceSender:
    path = tmp_path / "file"
    path.write_bytes(b"12345")

    def send(method: str, path: str, **_: Any) -> httpx.Response:
        return answers(method)

    return PieceSender(send=send, file=path, metadata={}, on_position=lambda _: None, pause=pauses.append)


class LosingService:
    """Makes the submission, but so many of its answers are lost; then it may refuse once, with a code."""

    def __init__(self, lost: int, then: str | None = None) -> None:
        self.asked: list[str] = []
        self._lost = lost
        self._then = then

    def answer(self, method: str, path: str, **_: Any) -> httpx.Response:
        self.asked.append(f"{method} {path}")
        if method == "PATCH":
            return httpx.Response(204)
        if not path.endswith("/submission"):
            return httpx.Response(201, headers={"Location": "/api/v1/uploads/u", "Upload-Offset": "0"})
        if self._lost:
            self._lost -= 1
            raise ServiceUnreachable("cut")
        if self._then is not None:
            code, self._then = self._then, None
            raise RequestRefused(status=404, code=code, detail="no", request_id=None)
        return httpx.Response(200, json={"id": "made"})


@pytest.mark.parametrize("lost", [1, 3])
def test_a_lost_answer_to_the_last_request_costs_no_second_upload(tmp_path: Path, lost: int) -> None:
    service = LosingService(lost)
    assert sender_of(service.answer, tmp_path).run() == {"id": "made"}
    assert service.asked == [
        "POST /api/v1/uploads",
        "PATCH /api/v1/uploads/u",
        *["POST /api/v1/uploads/u/submission"] * (lost + 1),
    ]


@pytest.mark.parametrize("code", sorted(MISPLACED))
def test_an_upload_that_is_gone_meanwhile_is_begun_again(tmp_path: Path, code: str) -> None:
    service = LosingService(1, then=code)
    assert sender_of(service.answer, tmp_path).run() == {"id": "made"}
    one_upload = ["POST /api/v1/uploads", "PATCH /api/v1/uploads/u", "POST /api/v1/uploads/u/submission"]
    assert service.asked == [*one_upload, "POST /api/v1/uploads/u/submission", *one_upload]


def sender_of(send: Callable[..., httpx.Response], tmp_path: Path) -> PieceSender:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    return PieceSender(send=send, file=path, metadata={}, on_position=lambda _: None, pause=lambda _: None)


def test_gives_up_after_so_many_failures_without_progress(tmp_path: Path) -> None:
    def answer(method: str) -> httpx.Response:
        if method == "POST":
            return httpx.Response(201, headers={"Location": "/api/v1/uploads/u", "Upload-Offset": "0"})
        raise ServiceUnreachable("cut")

    pauses: list[float] = []
    with pytest.raises(ServiceUnreachable):
        sender_to(answer, tmp_path, pauses).run()
    assert len(pauses) == len(PAUSES_S)


def test_a_service_that_is_down_at_the_start_is_waited_for_as_after_a_cut(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def answer(_: str) -> httpx.Response:
        raise ServiceUnreachable("Nobody answers.")

    pauses: list[float] = []
    with pytest.raises(ServiceUnreachable):
        sender_to(answer, tmp_path, pauses).run()
    assert len(pauses) == len(PAUSES_S)
    assert capsys.readouterr().err == "Nobody answers. Trying again for about a minute.\n"


def test_progress_starts_the_count_of_failures_anew(tmp_path: Path) -> None:
    offsets = iter(offset for offset in range(5) for _ in range(len(PAUSES_S)))

    def answer(method: str) -> httpx.Response:
        if method == "POST":
            return httpx.Response(201, headers={"Location": "/api/v1/uploads/u", "Upload-Offset": str(next(offsets))})
        raise ServiceUnreachable("cut")

    pauses: list[float] = []
    with pytest.raises(StopIteration):
        sender_to(answer, tmp_path, pauses).run()
    assert len(pauses) == 5 * len(PAUSES_S)


@pytest.mark.parametrize("code", ["archive_rejected", "too_many_uploads", "invalid_credentials", "not_found"])
def test_a_refusal_that_does_not_go_away_is_not_tried_again(tmp_path: Path, code: str) -> None:
    def answer(_: str) -> httpx.Response:
        raise RequestRefused(status=400, code=code, detail="No.", request_id=None)

    pauses: list[float] = []
    with pytest.raises(RequestRefused):
        sender_to(answer, tmp_path, pauses).run()
    assert pauses == []


@pytest.mark.parametrize("status", [408, 502, 503, 504])
def test_what_a_proxy_answers_for_a_service_that_restarts_is_tried_again(tmp_path: Path, status: int) -> None:
    answers = iter([RequestRefused(status=status, code="no_code", detail="Bad Gateway", request_id=None)])

    def answer(method: str) -> httpx.Response:
        for error in answers:
            raise error
        headers = {"Location": "/api/v1/uploads/u", "Upload-Offset": "5"}
        return httpx.Response(201, headers=headers, json={"id": "1"})

    pauses: list[float] = []
    assert sender_to(answer, tmp_path, pauses).run() == {"id": "1"}
    assert len(pauses) == 1
