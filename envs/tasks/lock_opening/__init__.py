"""Lock opening, Track 1: scene, variation, task and environment `ViTac/LockOpening-v1`."""
