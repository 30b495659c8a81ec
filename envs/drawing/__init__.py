"""Pictures of episodes, drawn on the CPU without a display: scene, stress, marker flow. `vitac show` calls it.

Nothing that simulates imports this package, and it needs the extra `show` (matplotlib, pillow).
"""
