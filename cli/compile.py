"""`vitac compile`: fills the cache of compiled kernels, so that nothing is compiled where it can only be read."""

from .terminal.compiling import compiling_shown


def command() -> None:
    """Compile the physics of all tactile tasks: play an env step of each, with all that it can observe.

    The folder is VITAC_CACHE_DIR, else one in your cache folder; later it need not be writable. Machine code is for one
    kind of CPU: for others, set NUMBA_CPU_NAME=generic and NUMBA_CPU_FEATURES= here and where it runs.
    """
    import vitac.envs  # noqa: F401 - registers the environments
    from vitac.envs.kernel_cache import CacheNotWritable, cache_root, shared_directory
    from vitac.envs.tasks.definition import Family
    from vitac.envs.tasks.registry import task_definitions

    folder = shared_directory()
    if folder is None:
        raise CacheNotWritable(f"Expected a folder that can be written to, got {cache_root()}; set VITAC_CACHE_DIR.")
    with compiling_shown():
        for env_id, task in task_definitions().items():
            if task.family is Family.TACTILE:
                _play(env_id, is_drawn=task.perspective is not None)
    print(f"Compiled kernels are in {folder}.")


def _play(env_id: str, *, is_drawn: bool) -> None:
    import gymnasium

    env = gymnasium.make(env_id, privileged=True, render_mode="rgb_array" if is_drawn else None)
    env.reset(seed=1)
    env.step(env.action_space.sample() * 0)
    if is_drawn:
        env.render()
    env.close()
