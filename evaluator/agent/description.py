"""What a policy runs with, as measured inside the sandbox; called by `vitac sandbox` and by workers at their start."""

from typing import Final

import numpy as np
from pydantic import ValidationError

from ..strict_model import StrictModel
from .probe_folder import probe_folder
from .verdicts import PolicyFailed, SandboxFailed

_POLICY: Final = """
import importlib.metadata, json, os, platform, re
import numpy

build = numpy.show_config(mode="dicts")
blas = build["Build Dependencies"]["blas"]
packages = {
    re.sub("[-_.]+", "-", each.metadata["Name"]).lower(): each.version for each in importlib.metadata.distributions()
}
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
FOUND = {
    "python": platform.python_version(),
    "machine": platform.machine(),
    "c_library": " ".join(platform.libc_ver()),
    "cores": len(os.sched_getaffinity(0)),
    "blas": f"{blas['name']} {blas['version']}",
    "threads": {name: os.environ.get(name, "not set") for name in THREADS},
    "simd": build["SIMD Extensions"]["baseline"] + build["SIMD Extensions"].get("found", []),
    "packages": dict(sorted(packages.items())),
}


class Policy:
    def reset(self, task):
        print(json.dumps(FOUND))

    def act(self, observation):
        return [0]
"""


class SandboxDescription(StrictModel):
    """What a policy finds in the sandbox of a machine.

    `simd` are the CPU's vector extensions that NumPy uses, `cores` those that the process may run on, `threads` the
    environment variables that bound the threads of numerical libraries, `packages` versions by name.
    """

    python: str
    machine: str
    c_library: str
    cores: int
    blas: str
    threads: dict[str, str]
    simd: tuple[str, ...]
    packages: dict[str, str]


def describe_sandbox() -> SandboxDescription:
    """Return what a policy finds in this machine's sandbox, by running a program in it.

    Raises:
        SandboxFailed: the sandbox does not work here.
    """
    from .session import PolicySession  # the server reads descriptions only

    with probe_folder() as folder:
        (folder / "policy.py").write_text(_POLICY)
        try:
            with (
                PolicySession(folder) as session,
                session.episode(task="description", action_shape=(1,)) as policy,
            ):
                policy.act({"value": np.zeros(1, dtype=np.float32)})
                return SandboxDescription.model_validate_json(policy.output)
        except (PolicyFailed, ValidationError) as error:
            raise SandboxFailed(f"The sandbox could not be described: {error}") from error
