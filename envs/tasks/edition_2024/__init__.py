"""The 2024 edition of the challenge: `ViTac/PegInsertion2024-v1` and `ViTac/LockOpening2024-v1`."""
