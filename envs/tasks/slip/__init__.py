"""Holding a part of unknown weight and friction under a growing load: scene, task and environment `ViTac/Slip-v1`."""
