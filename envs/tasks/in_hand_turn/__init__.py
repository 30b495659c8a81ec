"""A held rod is turned in the hand by pressing it against an edge: scene, task and `ViTac/InHandTurn-v1`."""
