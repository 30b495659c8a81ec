import os
from pathlib import Path

import pytest
from vitac.evaluator.sensors import package
from vitac.evaluator.sensors.manifest import SensorRejected
from vitac.evaluator.sensors.package import design_document


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("gel.stl", "sensor.yaml", "submission.yaml"):
        (tmp_path / name).write_text("x")
    return tmp_path


@pytest.mark.parametrize("name", ["design.pdf", "Team_Track3_Design_Document.md", "DESIGN.PDF"])
def test_document_is_found_by_its_ending(folder: Path, name: str) -> None:
    (folder / name).write_bytes(b"abc")
    found = design_document(folder)
    assert (found.path.name, found.n_bytes, found.suffix) == (name, 3, Path(name).suffix.lower())


def test_readme_and_folders_are_no_documents(folder: Path) -> None:
    (folder / "README.md").write_text("x")
    (folder / "folder.md").mkdir()
    (folder / "design.md").write_text("x")
    assert design_document(folder).path.name == "design.md"


@pytest.mark.parametrize("names", [(), ("a.pdf", "b.md"), ("notes.txt",)])
def test_none_and_several_documents_are_refused(folder: Path, names: tuple[str, ...]) -> None:
    for name in names:
        (folder / name).write_text("x")
    with pytest.raises(SensorRejected, match="Expected one design document"):
        design_document(folder)


@pytest.mark.parametrize("missing", ["gel.stl", "sensor.yaml"])
def test_missing_file_of_the_sensor_is_named(folder: Path, missing: str) -> None:
    (folder / missing).unlink()
    with pytest.raises(SensorRejected, match=f"{missing} is missing"):
        design_document(folder)


@pytest.mark.parametrize("n_bytes", [0, 5])
def test_empty_and_large_documents_are_refused(folder: Path, n_bytes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(package, "MAX_DOCUMENT_BYTES", 4)
    (folder / "design.pdf").write_bytes(b"x" * n_bytes)
    with pytest.raises(SensorRejected, match=f"has {n_bytes} bytes, expected 1 to 4"):
        design_document(folder)


def test_size_of_a_document_is_limited_to_the_byte(folder: Path) -> None:
    document = folder / "design.pdf"
    document.touch()
    os.truncate(document, package.MAX_DOCUMENT_BYTES)
    assert design_document(folder).n_bytes == 20 * 2**20
    os.truncate(document, package.MAX_DOCUMENT_BYTES + 1)
    with pytest.raises(SensorRejected, match=r"has 20971521 bytes, expected 1 to 20971520"):
        design_document(folder)


def test_files_in_capitals_are_found_and_hidden_ones_are_no_document(tmp_path: Path) -> None:
    for name in ("SENSOR.yaml", "gel.STL", "Design.MD", "._Design.md"):
        (tmp_path / name).write_text("x")
    assert design_document(tmp_path).path.name == "Design.MD"
