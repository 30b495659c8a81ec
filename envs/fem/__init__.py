"""Finite elements, affine bodies and incremental potential contact, solved step by step to convergence.

`scene.Scene` is the entry; the model it solves is written term by term in `neo_hookean`, `affine_body`, `barrier`,
`mollifier` and `friction`, summed in `assembly` and minimised in `newton`.
"""

SOLVER_VERSION = "1"
"""Changes whenever the same actions may give other states: physics, settings of the profile, order of operations."""
