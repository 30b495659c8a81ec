"""Compiles the physics before the first evaluation, for all workers. Run by `demo` in a process of its own."""

from __future__ import annotations


def warm_up(track: str) -> None:
    """Run one env step of each task, so that Numba compiles and caches its kernels."""
    import gymnasium
    import vitac.envs  # noqa: F401 - registers the environments
    from vitac.evaluator.tracks import load_track

    for task in load_track(track).tasks.values():
        env = gymnasium.make(task.env_id)
        env.reset(seed=1, options=dict(task.episodes[0].options))
        env.step(env.action_space.sample() * 0)
        env.close()
