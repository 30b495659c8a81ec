"""Peg insertion, Track 1: scene, variation, task and environment `ViTac/PegInsertion-v1`."""
