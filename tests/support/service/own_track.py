"""The file of a track of an organizer's own with one task and two episodes."""

OWN_TRACK = """
name: pegs
folder: Pegs
title: Pegs
summary: Insert a peg.
accepts: [model, log]
tasks:
  own-pegs:
    name: own-pegs
    env_id: ViTac/PegInsertion-v1
    title: Own pegs
    description: A peg stands above its hole.
    success_rule: The peg is in the hole.
    max_steps: 15
    shard_size: 2
    episode_list:
      list_seed: 0
      offset_option: offset_mm_deg
      blocks:
        - repeats: 2
          starts: [{shape: trapezoid, offset: [1, 2, 3]}]
"""
