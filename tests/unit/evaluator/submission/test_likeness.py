import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from vitac.evaluator.submission.likeness import ArchiveLikeness, compare_sketches, make_sketch

CODE = """
class Policy:
    def reset(self, task):
        self.step = 0

    def act(self, observation):
        self.step += 1
        return self.weights @ observation["relative_motion"] / self.step
"""
OTHER = """
import math
GAIN = 0.5
class Policy:
    def reset(self, task): pass
    def act(self, seen): return [GAIN * math.tanh(value) for value in seen["marker_flow"][0][1].mean(axis=0)]
"""


def archive(path: Path, code: str, weights: np.ndarray, name: str = "weights.npz") -> Path:
    content = io.BytesIO()
    if name.endswith(".npz"):
        np.savez(content, layer=weights)
    elif name.endswith(".json"):
        content.write(json.dumps([round(float(value), 4) for value in weights.ravel()]).encode())
    else:
        content.write(b"head" + weights.astype("<f4").tobytes())
    with zipfile.ZipFile(path, "w") as opened:
        opened.writestr("Track_1/policy.py", code)
        opened.writestr(f"Track_1/{name}", content.getvalue())
    return path


def trained(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((40, 30))


def likeness(first: Path, second: Path) -> ArchiveLikeness:
    return compare_sketches(make_sketch(first), make_sketch(second))


@pytest.mark.parametrize("name", ["weights.npz", "weights.json", "weights.bin"])
def test_weights_with_a_little_noise_are_alike_and_those_of_another_seed_are_not(tmp_path: Path, name: str) -> None:
    source = archive(tmp_path / "a.zip", CODE, trained(1), name)
    noisy = archive(tmp_path / "b.zip", CODE, trained(1) + 1e-2 * trained(2), name)
    other = archive(tmp_path / "c.zip", CODE, trained(3), name)
    assert (likeness(source, noisy).weights or 0) > 0.999
    assert abs(likeness(source, other).weights or 0) < 0.2


def test_half_precision_is_read_as_such(tmp_path: Path) -> None:
    first, second = (archive(tmp_path / f"{n}.zip", CODE, trained(1).astype(np.float16) * n) for n in (1, 2))
    assert likeness(first, second).weights == pytest.approx(1)


def test_code_is_compared_without_comments_and_layout(tmp_path: Path) -> None:
    source = archive(tmp_path / "a.zip", CODE, trained(1))
    changed = CODE.replace("    ", "  ").replace("self.step = 0", "self.step = 0  # a comment\n")
    assert likeness(source, archive(tmp_path / "b.zip", changed, trained(2))).code == 1
    assert (likeness(source, archive(tmp_path / "c.zip", OTHER, trained(2))).code or 0) < 0.3


def test_what_cannot_be_compared_is_said(tmp_path: Path) -> None:
    small = archive(tmp_path / "a.zip", "this is no python (", np.zeros((2, 2)))
    assert likeness(small, small).weights is None
    assert likeness(small, archive(tmp_path / "b.zip", CODE, trained(1))).code == 0


def test_an_array_of_objects_is_not_unpickled(tmp_path: Path) -> None:
    content = io.BytesIO()
    np.save(content, np.array([{}, []], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as opened:
        opened.writestr("Track_1/weights.npy", content.getvalue() * 100)
    found = compare_sketches(make_sketch(tmp_path / "a.zip"), make_sketch(tmp_path / "a.zip"))
    assert found == ArchiveLikeness(code=None, weights=found.weights)
