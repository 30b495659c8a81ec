"""The tables of benchmarks/physics.md; each is between `<!-- table NAME -->` and `<!-- end -->`."""

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

Figures = dict[str, Any]
Table = list[list[str]]  # head first
_MARKED = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


# What is measured of a gel and grows with its nodes.
GEL_QUANTITIES = {
    "ms_per_ipc_step": "IPC step",
    "ms_per_newton_iteration": "Newton iteration",
    "ms_per_factorisation": "factorisation",
    "set_up_ms": "set-up",
    "solver_mb": "memory",
}


class DocumentError(ValueError):
    """The document lacks a table or names one that nobody makes; the message says which."""


def fill_tables(document: str, figures: Figures) -> str:
    """Return the document with every marked table replaced."""
    marked = [match[1] for match in _MARKED.findall(document)]
    if sorted(marked) != sorted(TABLES):
        raise DocumentError(f"Expected one mark for each of {sorted(TABLES)}, found {sorted(marked)}.")
    return _MARKED.sub(lambda match: match[1] + markdown(TABLES[match[2]](figures)) + match[3], document)


def markdown(table: Table) -> str:
    """Return a table with its head."""
    head, *rows = (f"| {' | '.join(row)} |\n" for row in table)
    return head + "|" + "---|" * len(table[0]) + "\n" + "".join(rows)


def _table(rows: Iterable[Figures], columns: Mapping[str, Callable[[Figures], object]]) -> Table:
    """Return a table with a row for each of some figures.

    Args:
        rows: the figures.
        columns: by heading, what stands in a row.
    """
    return [[*columns], *([str(cell(row)) for cell in columns.values()] for row in rows)]


def _speed(figures: Figures) -> Table:
    f = figures["speed"]
    return [
        ["CPU time", "of one thread"],
        ["per IPC step of env steps, mean", f"{f['mean_ms']:.1f} ms"],
        ["median", f"{f['median_ms']:.1f} ms"],
        ["99th percentile", f"{f['p99_ms']:.0f} ms"],
        [
            "Newton iterations per IPC step, mean (most)",
            f"{f['mean_newton_iterations']:.1f} ({f['max_newton_iterations']})",
        ],
        ["of them with an earlier matrix's factors", f"{f['mean_reusing_iterations']:.1f}"],
        ["reset, mean", f"{f['mean_reset_ms']:.0f} ms"],
        [
            f"all {f['episodes']} episodes with their resets, {f['ipc_steps']:,} IPC steps",
            f"{f['physics_cpu_s']:.1f} s",
        ],
    ]


def _pieces(figures: Figures) -> Table:
    total = figures["speed"]["mean_ms"]
    rows = [[p["piece"], f"{p['ms']:.2f} ms", f"{100 * p['ms'] / total:.0f} %"] for p in figures["pieces"]]
    return [["piece", "per IPC step", "of the mean"], *rows]


def _convergence(figures: Figures) -> Table:
    f = figures["convergence"]
    return [
        ["IPC steps", f"{f['ipc_steps']:,}"],
        [
            "solved at once / after division / after escaping a saddle",
            f"{f['converged']:,} / {f['divided']} / {f['escaped_saddle']}",
        ],
        ["not solved", str(f["not_converged"])],
        ["largest nodal residual (median)", f"{f['largest_residual_n']:.1e} N ({f['median_residual_n']:.1e} N)"],
        ["largest net force left on the peg", f"{f['largest_net_force_n']:.1e} N"],
        ["largest net torque left on the peg", f"{f['largest_net_torque_n_m']:.1e} N m"],
        ["smallest gap", f"{f['smallest_gap_m'] * 1e6:.1f} micrometres"],
        ["smallest det F", f"{f['smallest_det_f']:.2f}"],
    ]


def _agreement(figures: Figures) -> Table:
    return _table(
        figures["agreement"],
        {
            "env step": lambda f: f["env_step"],
            "episodes": lambda f: f["episodes"],
            "median difference": lambda f: f"{f['median_mm']:.5f} mm",
            "largest": lambda f: f"{f['largest_mm']:.2f} mm",
            "within 0.03 mm, of those certain to 0.03 mm": lambda f: (
                f"{100 * f['part_within']:.1f} % of {f['certain_episodes']}"
            ),
        },
    )


def _misses(figures: Figures) -> Table:
    return _table(
        figures["misses"],
        {
            "episode": lambda f: f["episode"],
            "env step": lambda f: f["env_step"],
            "difference": lambda f: f"{f['deviation_mm']:.3f} mm",
            "lowest corner of the peg, here / reference": lambda f: (
                f"{f['lowest_corner_mm']:.2f} / {f['reference_lowest_corner_mm']:.2f} mm"
            ),
        },
    )


def _logs(figures: Figures) -> Table:
    return _table(
        figures["logs"],
        {
            "env step": lambda f: f["env_step"],
            "episodes": lambda f: f["episodes"],
            "offsets differ by at most [mm, deg]": lambda f: f"{f['largest_offset_difference']:.0e}",
            "`surface_diff` differs, median": lambda f: f"{f['median_mm']:.2f} mm",
            "larger of both": lambda f: f"{f['larger_median_mm']:.2f} mm",
            "tactile flag: log / here / both": lambda f: _counts(f, "tactile_movement_too_large"),
            "success: log / here / both": lambda f: _counts(f, "is_success"),
        },
    )


def _counts(f: Figures, flag: str) -> str:
    return f"{f[f'logged_{flag}']} / {f[f'ours_{flag}']} / {f[f'both_{flag}']}"


def _outcomes(figures: Figures) -> Table:
    return _table(
        figures["outcomes"],
        {
            "ended in the log by": lambda f: f["logged"],
            "ends here by": lambda f: f["ours"],
            "episodes": lambda f: f["episodes"],
        },
    )


def _ledger(figures: Figures) -> Table:
    """Return the two settings in use, and of the others those that change a result by a micrometre or more."""
    rows = [f for f in figures["ledger"] if f["setting"] in ("tightest", "standard") or f["largest_mm"] > 1e-3]
    return _table(
        rows,
        {
            "setting": lambda f: f["setting"],
            "per IPC step": lambda f: f"{f['mean_ms']:.1f} ms",
            "not solved": lambda f: f["not_converged"],
            "from the tightest, median": lambda f: f"{f['median_mm']:.1e} mm",
            "largest": lambda f: f"{f['largest_mm']:.1e} mm",
            "reference within 0.03 mm": lambda f: f"{100 * f['truth_part_within']:.1f} %",
        },
    )


def _fuzz(figures: Figures) -> Table:
    return _table(
        figures["fuzz"],
        {
            "task": lambda f: f["task"],
            "seeds": lambda f: f"{f['first_seed']} to {f['first_seed'] + f['episodes'] - 1}",
            "episodes": lambda f: f["episodes"],
            "IPC steps": lambda f: f"{f['ipc_steps']:,}",
            "divided / saddle escaped": lambda f: f"{f['divided']} / {f['escaped_saddle']}",
            "not solved": lambda f: f["not_converged"],
            "intersections / overlooked contacts": lambda f: f"{f['intersections']} / {f['overlooked']}",
            "smallest det F": lambda f: f"{f['smallest_det_f']:.2f}",
            "smallest gap": lambda f: f"{f['smallest_gap_m'] * 1e6:.1f} micrometres",
        },
    )


def _gels(figures: Figures) -> Table:
    """Return a row for the smallest and the largest gel of each family."""
    rows = [
        [family, *_gel(figures["gels"][name])]
        for family, names in figures["gel_families"].items()
        for name in dict.fromkeys((names[0], names[-1]))
    ]
    return [["gel", "nodes", "per IPC step", "one factorisation", "contacts", "matrix and factors"], *rows]


def _gel(f: Figures) -> list[str]:
    return [
        f"{f['nodes']:,}",
        f"{_two_digits(f['ms_per_ipc_step'])} ms",
        f"{_two_digits(f['ms_per_factorisation'])} ms",
        f"{f['active_contacts']:,}",
        f"{_two_digits(f['solver_mb'])} MB",
    ]


def _two_digits(value: float) -> str:
    rounded = float(f"{value:.1e}")
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:.{1 if rounded >= 1 else 2}f}"


def _exponents(figures: Figures) -> Table:
    rows = [
        [family, *(f"{f[quantity]:.2f}" for quantity in GEL_QUANTITIES)]
        for family, f in figures["gel_exponents"].items()
    ]
    return [["power of the nodes", *GEL_QUANTITIES.values()], *rows]


TABLES: dict[str, Callable[[Figures], Table]] = {
    "agreement": _agreement,
    "convergence": _convergence,
    "exponents": _exponents,
    "fuzz": _fuzz,
    "gels": _gels,
    "ledger": _ledger,
    "logs": _logs,
    "misses": _misses,
    "outcomes": _outcomes,
    "pieces": _pieces,
    "speed": _speed,
}
