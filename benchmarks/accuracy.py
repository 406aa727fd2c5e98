"""The error of a march over its cost: RMSE of loops against Runge and Kutta's method, over time per simulated second.

The errors are those of a study; all programs that do the same march agree to 1e-9, so that they share them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

FIGURE = Path(__file__).with_name("error_over_cost.png")
TABLE = Path(__file__).parents[1] / "studies" / "numerics" / "tables" / "integrators.md"
PRESETS = {"paper_like": "o", "paper_like_fast": "s", "lbnl": "D", "g36": "^"}
"""Presets and their markers."""
PROGRAMS = {"fastcoil, kernel": "fastcoil's kernel", "C": "C", "JAX": "JAX"}
"""Contenders in the figure, and their names there."""
MARCHES = {"printed": "fastcoil, lagged", "converged": "fastcoil, quasistatic"}
"""Marches, and their names in the table of the study, where they have one step a second."""
HEAD = ("march", *PRESETS, *PROGRAMS.values())
TEXT = (
    "Median error of the RMSE of single loops, %, against Runge and Kutta's method at 0.25 s, from "
    f"[the study of numerics](../{'/'.join(TABLE.parts[-4:])}), and time of a simulated second of one loop, ns, on one "
    "thread at a sample time of 30 s.  Limit cycles amplify any difference: with `paper_like` and `paper_like_fast` no "
    "method comes closer than 1 %.\n"
)

Errors = Mapping[str, Mapping[str, float]]
"""Median errors, %, by march and preset."""
Costs = Mapping[tuple[str, str], float]
"""Time per simulated second on one thread, ns, by program and march."""


def read_errors() -> Errors:
    """Return the errors in the table of the study."""
    lines = [line.strip("| ").split(" | ") for line in TABLE.read_text(encoding="utf-8").splitlines() if "|" in line]
    steps = {(row[0], row[1]): dict(zip(lines[0], row, strict=True)) for row in lines[2:]}
    return {
        march: {preset: float(steps[name, "1"][preset].rpartition(", ")[2]) for preset in PRESETS}
        for march, name in MARCHES.items()
    }


def rows(errors: Errors, costs: Costs) -> Iterator[tuple[object, ...]]:
    """Yield one row per march: its errors with each preset, and its time with each program."""
    for march, by_preset in errors.items():
        times = (f"{costs[name, march]:.1f}" if (name, march) in costs else "" for name in PROGRAMS)
        yield march, *(f"{error:g}" for error in by_preset.values()), *times


def draw(errors: Errors, costs: Costs, path: Path) -> None:
    """Draw the median error of each march, %, over its time with each program."""
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D

    figure, ax = plt.subplots(figsize=(8.0, 4.2), layout="constrained")
    programs = [name for name in PROGRAMS if (name, "printed") in costs]
    for colour, program in enumerate(programs):
        x = [costs[program, march] for march in MARCHES]
        for preset, marker in PRESETS.items():
            y = [errors[march][preset] for march in MARCHES]
            ax.plot(x, y, color=f"C{colour}", linewidth=0.8, alpha=0.5)
            for point, fill in zip(zip(x, y, strict=True), ("none", "full"), strict=True):
                ax.plot(*point, color=f"C{colour}", marker=marker, fillstyle=fill)
    ax.set(yscale="log", xlim=(0.0, None), xlabel="time per simulated second of a loop, one thread, ns")
    ax.set_ylabel("median error of the RMSE, %")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.grid(alpha=0.3)
    keys = [Line2D([], [], color=f"C{k}", label=PROGRAMS[program]) for k, program in enumerate(programs)]
    grey = {"color": "0.3", "linestyle": ""}
    keys += [Line2D([], [], marker=marker, label=preset, **grey) for preset, marker in PRESETS.items()]
    keys += [Line2D([], [], marker="o", fillstyle="none", label="march as printed", **grey)]
    keys += [Line2D([], [], marker="o", label="converged march", **grey)]
    figure.legend(handles=keys, loc="outside right upper", frameon=False)
    figure.savefig(path, format="png", dpi=150)
    plt.close(figure)
