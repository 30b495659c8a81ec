"""Writes evaluator/package_sets.yaml, the packages that policies see, from requirements/*.lock; called by lock.sh."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
TARGET = ROOT / "evaluator" / "package_sets.yaml"
ELSEWHERE = ("sys_platform == 'win32'", "sys_platform == 'emscripten'", "sys_platform == 'darwin'")
TORCH_NEEDS = ("filelock", "fsspec", "jinja2", "markupsafe", "mpmath", "networkx", "sympy")
"""What torch imports beyond the base set."""
LOCKED = re.compile(r"^(?P<name>[A-Za-z0-9._-]+)==(?P<version>\S+)(?: ; (?P<marker>[^\\]+?))?\s*\\?$", re.MULTILINE)
HEADING = """\
# The packages that policies see, by set, with their versions: several where Python's version decides.
# Written by setup/package_sets.py from requirements/*.lock.
"""


def locked(name: str) -> dict[str, list[str]]:
    """Return the versions that a lock file has for Linux, by package."""
    versions: dict[str, list[str]] = {}
    for found in LOCKED.finditer((ROOT / "requirements" / f"{name}.lock").read_text()):
        if found["marker"] not in ELSEWHERE:
            versions.setdefault(found["name"], []).append(found["version"])
    return versions


def document() -> str:
    """Return the text of package_sets.yaml."""
    torch = locked("torch")
    (version,) = re.findall(r"^torch=(\S+)$", (ROOT / "setup" / "additions.sh").read_text(), re.MULTILINE)
    sets = {
        "base": locked("base"),
        "torch": {"torch": [version], **{name: torch[name] for name in TORCH_NEEDS}},
        "sb3": {"stable-baselines3": torch["stable-baselines3"]},
    }
    lines = [HEADING]
    for title, packages in sets.items():
        lines.append(f"{title}:\n")
        lines += [f"  {name}: [{', '.join(map(repr, packages[name]))}]\n" for name in sorted(packages)]
    return "".join(lines)


if __name__ == "__main__":
    TARGET.write_text(document())
