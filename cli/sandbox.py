"""`vitac sandbox`: prints what a policy runs with on this machine, as measured inside the sandbox."""

from typing import TYPE_CHECKING

from .terminal.output import AsJson, print_json, print_table

if TYPE_CHECKING:
    from vitac.evaluator.agent.description import SandboxDescription


def command(as_json: AsJson = False) -> None:
    """Print what a policy finds in the sandbox: Python, packages, BLAS, threads, CPU."""
    from vitac.evaluator.agent.description import describe_sandbox

    description = describe_sandbox()
    if as_json:
        print_json(description.model_dump())
        return
    print_table(("what", "found"), facts(description), none="")
    print()
    print_table(("package", "version"), list(description.packages.items()), none="")


def facts(description: "SandboxDescription") -> list[tuple[str, str]]:
    """Return what is no package, as rows."""
    return [
        ("Python", description.python),
        ("C library", description.c_library),
        ("CPU", f"{description.machine} with {', '.join(description.simd) or 'no vector extensions'}"),
        ("BLAS of NumPy", description.blas),
        *description.threads.items(),
    ]
