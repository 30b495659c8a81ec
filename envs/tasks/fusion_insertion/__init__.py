"""Insertion by vision and touch, Track 2: scene, variation, task and environment `ViTac/FusionInsertion-v1`."""
