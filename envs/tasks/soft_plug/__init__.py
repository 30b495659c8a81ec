"""Pushing an elastic plug into a tight hole without bending or crushing it: `ViTac/SoftPlug-v1`."""
