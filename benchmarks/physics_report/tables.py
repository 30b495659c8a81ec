"""The tables of docs/physics.md from measured figures; each stands between `<!-- table NAME -->` and `<!-- end -->`."""

import re
from collections.abc import Callable
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


def with_tables(document: str, figures: Figures) -> str:
    """Return the document with every marked table made anew."""
    marked = [match[1] for match in _MARKED.findall(document)]
    if sorted(marked) != sorted(TABLES):
        raise DocumentError(f"Expected one mark for each of {sorted(TABLES)}, found {sorted(marked)}.")
    return _MARKED.sub(lambda match: match[1] + markdown(TABLES[match[2]](figures)) + match[3], document)


def markdown(table: Table) -> str:
    """Return a table with its head."""
    head, *rows = (f"| {' | '.join(row)} |\n" for row in table)
    return head + "|" + "---|" * len(table[0]) + "\n" + "".join(rows)


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
    rows = [
        [
            str(f["env_step"]),
            str(f["episodes"]),
            f"{f['median_mm']:.5f} mm",
            f"{f['largest_mm']:.2f} mm",
            f"{100 * f['part_within']:.1f} % of {f['certain_episodes']}",
        ]
        for f in figures["agreement"]
    ]
    return [
        ["env step", "episodes", "median difference", "largest", "within 0.03 mm, of those certain to 0.03 mm"],
        *rows,
    ]


def _misses(figures: Figures) -> Table:
    rows = [
        [
            str(f["episode"]),
            str(f["env_step"]),
            f"{f['deviation_mm']:.3f} mm",
            f"{f['lowest_corner_mm']:.2f} / {f['reference_lowest_corner_mm']:.2f} mm",
            ", ".join(f"{value:.3f}" for value in f["in_parts_mm"]),
        ]
        for f in figures["misses"]
    ]
    head = [
        "episode",
        "env step",
        "difference",
        "lowest corner of the peg, here / reference",
        "in 2, 4, 8, 16 parts [mm]",
    ]
    return [head, *rows]


def _logs(figures: Figures) -> Table:
    rows = [
        [
            str(f["env_step"]),
            str(f["episodes"]),
            f"{f['largest_offset_difference']:.0e}",
            f"{f['median_mm']:.2f} mm",
            f"{f['larger_median_mm']:.2f} mm",
            *(f"{f[f'logged_{flag}']} / {f[f'ours_{flag}']} / {f[f'both_{flag}']}" for flag in _LOGGED_FLAGS),
        ]
        for f in figures["logs"]
    ]
    head = [
        "env step",
        "episodes",
        "offsets differ by at most [mm, deg]",
        "`surface_diff` differs, median",
        "larger of both",
    ]
    return [[*head, "tactile flag: log / here / both", "success: log / here / both"], *rows]


_LOGGED_FLAGS = ("tactile_movement_too_large", "is_success")


def _outcomes(figures: Figures) -> Table:
    rows = [[f["logged"], f["ours"], str(f["episodes"])] for f in figures["outcomes"]]
    return [["ended in the log by", "ends here by", "episodes"], *rows]


def _ledger(figures: Figures) -> Table:
    rows = [
        [
            f["setting"],
            f"{f['mean_ms']:.1f} ms",
            f"{f['mean_newton_iterations']:.1f}",
            str(f["not_converged"]),
            f"{f['median_mm']:.1e} mm",
            f"{f['largest_mm']:.1e} mm",
            str(f["elsewhere"]),
            f"{f['truth_median_mm']:.1e} mm",
            f"{100 * f['truth_part_within']:.1f} %",
        ]
        for f in figures["ledger"]
    ]
    head = ["setting", "per IPC step", "Newton iterations", "not solved", "from the tightest, median", "largest"]
    return [[*head, "beyond 0.03 mm", "from the reference, median", "within 0.03 mm"], *rows]


def _fuzz(figures: Figures) -> Table:
    rows = [
        [
            f["task"],
            f"{f['first_seed']} to {f['first_seed'] + f['episodes'] - 1}",
            str(f["episodes"]),
            f"{f['ipc_steps']:,}",
            f"{f['divided']} / {f['escaped_saddle']}",
            str(f["not_converged"]),
            f"{f['intersections']} / {f['overlooked']}",
            f"{f['smallest_det_f']:.2f}",
            f"{f['smallest_gap_m'] * 1e6:.1f} micrometres",
        ]
        for f in figures["fuzz"]
    ]
    head = [
        "task",
        "seeds",
        "episodes",
        "IPC steps",
        "divided / saddle escaped",
        "not solved",
        "intersections / overlooked contacts",
    ]
    return [[*head, "smallest det F", "smallest gap"], *rows]


def _unsolved(figures: Figures) -> Table:
    rows = [
        [f["task"], str(f["seed"]), str(f["env_step"]), str(f["number"]), f"{f['residual_n']:.0e} N"]
        for run in figures["fuzz"]
        for f in run["unsolved"]
    ]
    return [["task", "seed", "env step", "IPC step in it", "force left"], *(rows or [["none", "", "", "", ""]])]


def _gels(figures: Figures) -> Table:
    gels = figures["gels"]
    rows = []
    for family, names in figures["gel_families"].items():
        rows += [[family if name == names[0] else "", *_gel(gels[name])] for name in names]
    head = ["gel", "nodes / free / tetrahedra", "set-up", "per IPC step", "per Newton iteration", "one factorisation"]
    return [[*head, "iterations per IPC step", "contacts", "matrix and factors"], *rows]


def _gel(f: Figures) -> list[str]:
    return [
        f"{f['nodes']:,} / {f['free_nodes']:,} / {f['tetrahedra']:,}",
        f"{_two_digits(f['set_up_ms'])} ms",
        f"{_two_digits(f['ms_per_ipc_step'])} ms",
        f"{_two_digits(f['ms_per_newton_iteration'])} ms",
        f"{_two_digits(f['ms_per_factorisation'])} ms",
        f"{f['newton_iterations_per_ipc_step']:.1f}",
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
    "unsolved": _unsolved,
}
