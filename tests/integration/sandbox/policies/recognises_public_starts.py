# expect: harmless
# where: episode
"""Knows what to do in every episode whose first observation it has seen before, by its hash; else does nothing.

`known_starts.json` beside it has an action for each hash. See `test_list_fingerprinting`.
"""

import hashlib
import json
from pathlib import Path

import numpy as np

TABLE = Path("known_starts.json")


class Policy:
    def __init__(self):
        self.known = json.loads(TABLE.read_text()) if TABLE.exists() else {}
        self.action = None

    def reset(self, task):
        self.action = None

    def act(self, observation):
        if self.action is None:
            seen = b"".join(observation[key].tobytes() for key in sorted(observation))
            self.action = self.known.get(hashlib.sha256(seen).hexdigest(), [0.0, 0.0, 0.0])
        return np.array(self.action, dtype=np.float32)
