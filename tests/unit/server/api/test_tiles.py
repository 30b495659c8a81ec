import json
from datetime import datetime

from made_receipts import KEY, PUBLIC_KEY
from service_client import Service, problem_of
from service_factories import TRACK
from vitac.server.competitions.applying import apply
from vitac.server.competitions.definition import CompetitionDefinition
from vitac.server.principals import CONSOLE
from vitac.server.receipts.log_audit import audit_log
from vitac.server.transparency.entries import FinalBoard
from vitac.server.transparency.log import append
from vitac.server.transparency.notes import OF_WITNESS, VerifierKey, cosign
from vitac.server.transparency.tiles import PublishedLog, read_key

from competitions import make_competition

WITNESS = VerifierKey(name="ants.example/v", kind=OF_WITNESS, public_key=bytes.fromhex(PUBLIC_KEY))


def a_board(at: datetime) -> FinalBoard:
    """Some entry."""
    return FinalBoard(issued_at=at, competition="cup", track=TRACK, stage="only", entries=0, board_sha256="0" * 64)


def test_everybody_reads_the_log_as_files(service: Service) -> None:
    """260 entries, the competition's file and the commitment of its sealed list first."""
    with service.database.transaction() as session:
        definition = CompetitionDefinition.model_validate(
            make_competition(witnesses=[str(WITNESS)], contact="someone@example.org")
        )
        apply(session, CONSOLE, definition, confirmed=None)
        for _ in range(258):
            append(session, a_board)
    get = service.client.get

    def fetch(path: str) -> bytes | None:
        answer = get(f"/log/{path}")
        return answer.content if answer.is_success else None

    log = PublishedLog(fetch, read_key(fetch))
    found = audit_log(log)
    assert (found.findings, found.entries) == ([], {"competition": 1, "sealed_list": 1, "board": 258})
    assert not any(b"someone@example.org" in entry for entry in log.entries()), "an entry stays for good"
    for path, seconds in (("tile/0/000", 31_536_000), ("tile/entries/001.p/4", 31_536_000), ("checkpoint", 2)):
        assert f"max-age={seconds}" in get(f"/log/{path}").headers["cache-control"]
    for path in ("tile/0/001", "tile/0/001.p/5", "tile/0/1", "tile/9/000.p/1", "tile/entries/x000/000", "tile/1/000"):
        problem_of(get(f"/log/{path}"), 404, "not_found")
    note = str(log.checkpoint.with_signatures([cosign(KEY, WITNESS.name, log.checkpoint, 7)]))
    plain = {"Content-Type": "text/plain"}
    assert service.client.post("/log/cosignatures", content=note.encode(), headers=plain).json() == {"signatures": 1}
    assert get("/log/checkpoint").text == note
    assert json.loads(get("/log/witnessed.json").text) == [note]
    problem_of(service.client.post("/log/cosignatures", content=b"hello", headers=plain), 422, "invalid_request")
