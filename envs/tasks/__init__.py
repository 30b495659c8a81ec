"""Tasks: one folder each, with its scene, goal, variation and environment; `task_env` has what all share."""
