"""Peg insertion into a plate that moves: scene, variation, task and environment `ViTac/MovingHole-v1`."""
