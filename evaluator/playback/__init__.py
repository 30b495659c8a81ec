"""Playback files of finished episodes, made by re-simulating their records. Workers call `process`."""
