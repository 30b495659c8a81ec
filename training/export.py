"""Makes a submission of a training run: its best student with the policy that plays it."""

import io
import shutil
from pathlib import Path

import numpy as np
from vitac.errors import VitacError

from .episodes import TASK
from .files import load, write_bytes, write_text
from .learners import part
from .learning.student import make_weights
from .run import Folder, RoundResult
from .submission import policy

LARGEST_BYTES = 2_000_000
"""Largest file of weights."""

_SUBMISSION = f"""track: track_1
tasks: [{TASK}]
name: trained student
entry_point: policy:Policy
observation_keys: [marker_flow, relative_motion]
"""


class NotExportable(VitacError):
    """A run cannot be made a submission; the message says why."""


def export(folder: Folder, chosen: RoundResult, destination: Path) -> Path:
    """Write the submission of a round and return its folder.

    Args:
        folder: of the run.
        chosen: the round.
        destination: a folder that is not there yet.

    Raises:
        NotExportable: the destination is there already, or the weights are too large.
    """
    if destination.exists():
        raise NotExportable(f"{destination} is there already; expected a new folder.")
    state = load(folder.networks(chosen.number))
    kept = {**make_weights(part(state, "student")), "belief": state["belief"]}
    packed = io.BytesIO()
    np.savez_compressed(packed, **{name: array.astype(np.float16) for name, array in kept.items()})  # type: ignore[arg-type]
    if len(packed.getvalue()) > LARGEST_BYTES:
        size = len(packed.getvalue())
        raise NotExportable(
            f"The weights take {size} bytes, expected at most {LARGEST_BYTES}; train a smaller student."
        )
    track = destination / "Track_1"
    write_bytes(track / "weights.npz", packed.getvalue())
    write_text(track / "submission.yaml", _SUBMISSION)
    shutil.copyfile(str(policy.__file__), track / "policy.py")
    return destination
