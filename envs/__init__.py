"""Gymnasium environments and the tactile simulation under them; importing this package registers the `ViTac/*` ids."""

import gymnasium

ENVIRONMENTS = {
    "ViTac/LockOpening-v1": "vitac.envs.tasks.lock_opening.env:LockOpeningEnv",
    "ViTac/PegInsertion-v1": "vitac.envs.tasks.peg_insertion.env:PegInsertionEnv",
}
"""Entry point of every id; a string, so that registering does not import the simulation."""

for _id, _entry_point in ENVIRONMENTS.items():
    if _id not in gymnasium.registry:
        gymnasium.register(_id, entry_point=_entry_point)
