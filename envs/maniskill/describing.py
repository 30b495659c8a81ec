"""Writes `catalogue.yaml` from the installed ManiSkill: `python -m vitac.envs.maniskill.describing [ID ...]`.

Every registered environment is tried in a process of its own; run it where a Vulkan driver is installed.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import yaml

from .definition import CATALOGUE_FILE, MODES
from .env import flattened, parts_of_state

_TIME_LIMIT_S = 300.0


def main(arguments: Sequence[str] | None = None) -> None:
    """Describe the named environments, or all, and write the catalogue; others keep their entries."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.one:
        sys.stdout.write("\n" + json.dumps(_described(chosen.one)))
        return
    content = yaml.safe_load(CATALOGUE_FILE.read_text(encoding="utf-8")) if CATALOGUE_FILE.exists() else {}
    usable, refused = content.get("environments", {}), content.get("refused", {})
    for env_id in chosen.ids or _registered():
        usable.pop(env_id, None)
        refused.pop(env_id, None)
        described = _described_apart(env_id)
        if isinstance(described, str):
            refused[env_id] = described
        else:
            usable[env_id] = described
        sys.stderr.write(f"{env_id}: {described if isinstance(described, str) else 'usable'}\n")
    made_with = {name: version(name) for name in ("mani-skill", "sapien")}
    written = {
        "made_with": made_with,
        "environments": dict(sorted(usable.items())),
        "refused": dict(sorted(refused.items())),
    }
    CATALOGUE_FILE.write_text(
        yaml.safe_dump(written, sort_keys=False, default_flow_style=None, width=120), encoding="utf-8"
    )


def _registered() -> list[str]:
    import mani_skill.envs  # noqa: F401 - registers them
    from mani_skill.utils.registration import REGISTERED_ENVS

    return sorted(REGISTERED_ENVS)


def _described_apart(env_id: str) -> dict[str, Any] | str:
    """Return the description of an environment, or the reason why it cannot be a task."""
    command = [sys.executable, "-P", "-m", __spec__.name, "--one", env_id]
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter and module
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, timeout=_TIME_LIMIT_S
        )
    except subprocess.TimeoutExpired:
        return f"It was not made within {_TIME_LIMIT_S:.0f} s."
    if done.returncode != 0:
        return _reason(done.stderr)
    described: dict[str, Any] | str = json.loads(done.stdout.rpartition("\n")[2])
    return described


def _reason(errors: str) -> str:
    """Return why an environment was not made, from what Python printed."""
    if "download_asset" in errors or ".maniskill/data" in errors:
        return "It needs files that ManiSkill downloads."
    last = next(reversed(errors.strip().splitlines()), "its process was ended")
    return f"It cannot be made: {last.strip().partition('. ')[0].rstrip('.')[:100]}."


def _described(env_id: str) -> dict[str, Any] | str:
    import gymnasium
    import mani_skill.envs  # noqa: F401 - registers them
    from mani_skill.utils.registration import REGISTERED_ENVS

    assets = REGISTERED_ENVS[env_id].asset_download_ids
    if assets:
        return f"It needs files that ManiSkill downloads: {', '.join(assets)}."
    settings: dict[str, Any] = {"sim_backend": "physx_cpu", "render_backend": "cpu"}
    made = gymnasium.make(env_id, obs_mode="state_dict", **settings)
    env: Any = made.unwrapped
    if not isinstance(made.action_space, gymnasium.spaces.Box):
        return "It has several robots with an action each."
    observation, _ = env.reset(seed=0)
    *_, info = env.step(made.action_space.sample())
    if "success" not in info:
        return "Its info has no success."
    modes = _control_modes(env)
    if not modes:
        return "None of its control modes has actions in [-1, 1]."
    observations: dict[str, Any] = {"state": [f"{name} {size}" for name, size in parts_of_state(observation)]}
    robot = env.agent.uid
    made.close()
    for mode in MODES[1:]:
        made = gymnasium.make(env_id, obs_mode=mode, **settings)
        pictures, _ = made.unwrapped.reset(seed=0)
        observations[mode] = [
            f"{key} {value.dtype} {'x'.join(map(str, value.shape))}" for key, value in flattened(pictures).items()
        ]
        made.close()
    return {"robot": robot, "control_modes": modes, "observations": observations}


def _control_modes(env: Any) -> dict[str, int]:
    """Return the size of an action in each control mode whose actions are in [-1, 1]."""
    spaces: Mapping[str, Any] = getattr(env.agent.action_space, "spaces", {})
    sizes = {}
    for mode in env.agent.supported_control_modes:
        env.agent.set_control_mode(mode)
        space = spaces.get(mode, env.agent.action_space)
        if (space.low == -1).all() and (space.high == 1).all():
            sizes[mode] = int(space.shape[-1])
    return sizes


if __name__ == "__main__":
    main()
