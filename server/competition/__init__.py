"""The competition: its definition, stages, own tracks and sealed lists."""
