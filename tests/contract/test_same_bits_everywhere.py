"""Between action and observation only operations whose bits are the same on every machine may be used.

BLAS and LAPACK differ between their kernels, and a libm's transcendental functions between versions and CPUs; +, -, *,
/ and sqrt are exactly rounded everywhere, and `deterministic_math` is made of these.
"""

import ast
from pathlib import Path

import pytest

ENVS = Path(__file__).resolve().parents[2] / "envs"
FORBIDDEN_NAMES = {
    *("dot", "vdot", "inner", "matmul", "einsum", "tensordot", "linalg", "norm", "svd"),
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "asin", "acos", "atan", "atan2", "hypot"),
    *("exp", "expm1", "log", "log2", "log10", "log1p", "power", "pow", "cbrt", "sinh", "cosh", "tanh"),
    *("normal", "standard_normal", "exponential", "standard_exponential"),  # of a generator: libm far out
}
# Pictures are drawn from states; nothing of them reaches a state or an observation. A measured pose is privileged. The
# response of the markers serves the figures of a sensor alone, which are rounded.
OUTSIDE_THE_PATH = (
    *("drawing/", "playback_files/", "scene/measured_pose.py", "scene/perspective.py", "vision/still.py"),
    "tactile/response.py",
)
MODULES = sorted(
    name
    for name in (path.relative_to(ENVS).as_posix() for path in ENVS.rglob("*.py"))
    if not name.startswith(OUTSIDE_THE_PATH)
)


def offences(source: str) -> list[str]:
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            found.append(f"line {node.lineno}: the @ operator")
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow) and not _exact_power(node):
            found.append(f"line {node.lineno}: a power that is not a small whole number")
        if isinstance(node, ast.Attribute) and node.attr in FORBIDDEN_NAMES:
            found.append(f"line {node.lineno}: {ast.unparse(node)}")
        if isinstance(node, ast.ImportFrom) and node.module in ("math", "numpy", "scipy"):
            found += [f"line {node.lineno}: {alias.name}" for alias in node.names if alias.name in FORBIDDEN_NAMES]
    return found


def _exact_power(node: ast.BinOp) -> bool:
    """Squares and cubes, which are multiplications, and powers of a whole number."""
    squared = isinstance(node.right, ast.Constant) and node.right.value in (2, 3)
    return squared or (isinstance(node.left, ast.Constant) and isinstance(node.left.value, int))


def test_modules_keep_to_exactly_rounded_operations() -> None:
    assert len(MODULES) > 100
    assert {module: found for module in MODULES if (found := offences((ENVS / module).read_text()))} == {}


@pytest.mark.parametrize(
    "source",
    [
        "a @ b",
        "np.dot(a, b)",
        "np.linalg.norm(a)",
        "math.sin(x)",
        "from math import cos",
        "x ** 0.5",
        "a.dot(b)",
        "random.normal(0, 1)",
    ],
)
def test_offence_is_seen(source: str) -> None:
    assert len(offences(source)) >= 1


@pytest.mark.parametrize(
    "source", ["a * b", "np.sqrt(a)", "x ** 2", "2**20", "from math import radians", "sine_cosine(x)"]
)
def test_exactly_rounded_operation_is_allowed(source: str) -> None:
    assert offences(source) == []
