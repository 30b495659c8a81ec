"""Loads the code of example submissions, and makes what they see."""

import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray


def load(path: Path) -> ModuleType:
    """A file of an example as a module."""
    spec = importlib.util.spec_from_file_location(f"example_{path.parents[1].name}_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@contextmanager
def imported(folder: Path) -> Iterator[SimpleNamespace]:
    """All modules of a submission by their names, imported as in the sandbox: its folder is on the path."""
    names = [path.stem for path in folder.glob("*.py")]
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        try:
            yield SimpleNamespace(**{name: importlib.import_module(name) for name in names})
        finally:
            for name in names:
                sys.modules.pop(name, None)


def flow(motion: NDArray[np.float64], noise: float = 0.0, seed: int = 0) -> NDArray[np.float32]:
    """Markers of one sensor that move by an affine map [constant, along u, along v], shape [2, 128, 2]; 70 are seen."""
    random = np.random.default_rng(seed)
    place = random.uniform([10, 10], [310, 230], (70, 2))
    columns = np.concatenate([np.ones((70, 1)), (place - [160, 125]) / 100], axis=1)
    both = np.stack(
        [place, place + columns @ motion + random.normal(0, noise, (70, 2)) if noise else place + columns @ motion]
    )
    return np.concatenate([both, np.repeat(both[:, -1:], 58, axis=1)], axis=1).astype(np.float32)
