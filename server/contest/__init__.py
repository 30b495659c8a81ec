"""The contest: its definition, stages, own tracks and sealed lists."""
