"""What a witness signs, and what it refuses, also after it was killed and started again."""

from pathlib import Path

import pytest
from made_logs import FILES_ADDRESS, LOG_KEY, Files, make_entries, opened, publish
from made_receipts import a_result
from vitac.server.receipts.witness import HistoryRewritten, Witness, WitnessUnusable
from vitac.server.transparency.merkle import ProofRejected
from vitac.server.transparency.notes import Checkpoint, NoteRejected, VerifierKey
from vitac.server.transparency.tiles import PublishedLog, TileMissing

NAME = "ants.example/v"
ENTRIES = make_entries(300)


def sign(folder: Path, files: Files) -> Checkpoint:
    """What a witness that has just been started signs."""
    return Witness(folder, NAME).observe(opened(files), FILES_ADDRESS)


def test_a_log_that_grows_is_signed_by_a_key_that_stays(tmp_path: Path) -> None:
    key = Witness(tmp_path, NAME).key
    for size in (3, 3, 256, 300):
        signed = sign(tmp_path, publish(ENTRIES[:size]))
        assert [by for by, _ in signed.find_witnesses([key])] == [key]
        assert (signed.size, Witness(tmp_path).key) == (size, key)
    assert (tmp_path / "key").stat().st_mode & 0o077 == 0, "nobody else reads the key"


def test_a_log_that_was_rewritten_is_never_signed_again_and_the_proof_of_it_is_stored(tmp_path: Path) -> None:
    sign(tmp_path, publish(ENTRIES[:200]))
    forked = make_entries(300, lambda number: a_result(9000 + number) if number > 150 else None)
    for files, reason in (
        (publish(ENTRIES[:199]), "was rolled back"),
        (publish(forked[:200]), "shows another history"),
        (publish(forked), "shows another history"),
    ):
        with pytest.raises(HistoryRewritten, match=reason) as refused:
            sign(tmp_path, files)
        evidence = sorted(tmp_path.glob("*.rewritten"))
        assert str(evidence[-1]) in str(refused.value) or any(str(path) in str(refused.value) for path in evidence)
        for path in (*evidence, *tmp_path.glob("*.checkpoint")):
            Checkpoint.parse(path.read_text()).require_signature(LOG_KEY)
    assert len(evidence) == 3
    assert sign(tmp_path, publish(ENTRIES)).size == 300, "the log that it has signed is signed further"


def test_what_tiles_do_not_prove_is_not_signed(tmp_path: Path) -> None:
    files, larger = publish(ENTRIES[:200]), publish(ENTRIES)
    with pytest.raises(ProofRejected, match="do not have the root"):
        sign(tmp_path, files | {"tile/0/000.p/200": larger["tile/0/000"][32 : 201 * 32]})
    sign(tmp_path, files)
    with pytest.raises(TileMissing):
        sign(tmp_path, {name: content for name, content in larger.items() if name != "tile/0/000"})
    with pytest.raises(NoteRejected, match="of another log"):
        PublishedLog(
            publish(ENTRIES, key=bytes(32)).get, VerifierKey.parse(str(Witness(tmp_path).known_key(FILES_ADDRESS)))
        )


def test_a_witness_has_one_name(tmp_path: Path) -> None:
    with pytest.raises(WitnessUnusable, match="no key yet: name it"):
        Witness(tmp_path)
    with pytest.raises(WitnessUnusable, match="is no name"):
        Witness(tmp_path, "a+b")
    Witness(tmp_path, NAME)
    with pytest.raises(WitnessUnusable, match=r"has the name ants\.example/v"):
        Witness(tmp_path, "bees.example/v")
    (tmp_path / "file").touch()
    with pytest.raises(WitnessUnusable, match="cannot be used as the folder"):
        Witness(tmp_path / "file", NAME)
