from pathlib import Path

from vitac.server.submissions.kinds import read_contents


def test_frameworks_are_what_code_imports_and_weights_what_no_code_is(tmp_path: Path) -> None:
    (tmp_path / "net").mkdir()
    (tmp_path / "policy.py").write_text("import numpy as np, json\n# import jax\nname = 'import cv2'\n")
    (tmp_path / "net" / "model.py").write_text("def load():\n    from torch.nn import Linear\n")
    (tmp_path / "net" / "weights.npz").write_bytes(b"0" * 1000)
    (tmp_path / "README.md").write_text("import tensorflow")
    found = read_contents(tmp_path)
    assert (found.frameworks, found.weights_bytes) == (["torch", "numpy"], 1000)
    assert found.code_bytes == sum(len(path.read_bytes()) for path in tmp_path.rglob("*.py"))


def test_code_that_is_no_text_or_endless_is_looked_at_in_part(tmp_path: Path) -> None:
    (tmp_path / "policy.py").write_bytes(b"\xff\xfe\0" * (1 << 18) + b"\nimport torch\n")
    (tmp_path / "link.py").symlink_to("policy.py")
    assert read_contents(tmp_path).frameworks == []
