"""`vitac sandbox`: prints what a policy runs with on this machine, as measured inside the sandbox."""

from typing import TYPE_CHECKING

from .terminal.output import AsJson, print_json, print_table

if TYPE_CHECKING:
    from vitac.evaluator.agent.description import SandboxDescription


def command(as_json: AsJson = False) -> None:
    """Print what a policy finds in the sandbox: Python, packages, BLAS, threads, CPU."""
    from vitac.evaluator.agent.description import describe_sandbox

    found = describe_sandbox()
    if as_json:
        print_json(found.model_dump())
        return
    print_table(("what", "found"), facts(found), none="")
    print()
    print_table(("package", "version"), list(found.packages.items()), none="")


def facts(found: "SandboxDescription") -> list[tuple[str, str]]:
    """Return what is no package, as rows."""
    return [
        ("Python", found.python),
        ("C library", found.c_library),
        ("CPU", f"{found.machine} with {', '.join(found.simd) or 'no vector extensions'}"),
        ("BLAS of NumPy", found.blas),
        *found.threads.items(),
    ]
