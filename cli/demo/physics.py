"""Compiles the physics ahead of the first evaluation, so that its workers find it ready. Run by `demo` in a process."""

from __future__ import annotations


def warm_up() -> None:
    """Play one env step of each task: Numba compiles what it needs and keeps it on disk."""
    import gymnasium
    import vitac.envs  # noqa: F401 - registers the environments
    from vitac.evaluator.tracks import load_track

    for task in load_track("track_1").tasks.values():
        env = gymnasium.make(task.env_id)
        env.reset(seed=1, options=dict(task.episodes[0].options))
        env.step(env.action_space.sample() * 0)
        env.close()
