"""A track of ManiSkill, as an organizer adds it by a file alone."""

FILE = """
name: cubes
folder: Cubes
title: Cubes
summary: Lift a cube.
accepts: [model, log]
tasks:
  pick-cube:
    name: pick-cube
    env_id: ManiSkill/PickCube-v1
    title: Pick a cube
    description: A cube lies on a table.
    success_rule: The cube is at the goal and the arm rests.
    max_steps: 50
    shard_size: 10
    settings: {obs_mode: state, control_mode: pd_ee_delta_pos}
    episode_list:
      list_seed: 0
      offset_option: variant
      blocks:
        - repeats: 20
          starts: [{shape: drawn, offset: [0]}]
"""
