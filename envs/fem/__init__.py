"""Finite elements, affine bodies and incremental potential contact, solved step by step to convergence.

`scene.Scene` is the entry; the model it solves is written term by term in `neo_hookean`, `affine_body`, `barrier`,
`mollifier`, `friction` and `inertia`, summed in `assembly` and solved in `newton`.
"""

SOLVER_VERSION = "3"
"""Changes whenever the same actions may give other states: physics, settings of the profile, order of operations."""
