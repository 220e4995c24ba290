"""A picture of the packages and of who imports whom, from the import statements themselves.

    .venv/bin/python docs/architecture.py out/architecture.png

Every module belongs to a group of :data:`GROUPS`. Imports that go round in a circle are an error.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Mapping
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("geometry", "materials", "workbench")

#: The groups of the picture: packages, or rooms of `workbench` that are used together.
GROUPS: Mapping[str, tuple[str, ...]] = {
    "files": ("workbench.files",),
    "geometry": ("geometry",),
    "materials": ("materials",),
    "physics": ("workbench.physics",),
    "results": ("workbench.results",),
    "fem": ("workbench.fem",),
    "model": ("workbench.model",),
    "reduced": ("workbench.reduced",),
    "acoustics": ("workbench.acoustics",),
    "readers": ("workbench.readers",),
    "instruments": ("workbench.instruments",),
    "simulation": ("workbench.simulation",),
    "jobs": ("workbench.jobs",),
    "bench": ("workbench.bench",),
    "search": ("workbench.search",),
    "fitting, reproduction": ("workbench.fitting", "workbench.reproduction"),
    "render": ("workbench.render",),
    "campaign, catalogue": ("workbench.campaign", "workbench.catalogue"),
    "diagnosis": ("workbench.diagnosis",),
    "design": ("workbench.design",),
    "report": ("workbench.report",),
    "live view": ("workbench.app",),
    "installation": ("workbench.installation",),
    "commands": ("workbench.commands", "workbench.cli", "workbench.__main__"),
}

#: What a notebook shows of a result is drawn when it is asked for: the one import against the arrows.
FOR_NOTEBOOKS = ("workbench.results.notebook", "workbench.render")


def module_name(path: Path) -> str:
    """The full name of the module in a file."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def group_of(module: str) -> str | None:
    """The group of a module; None for the public names of `workbench` itself, which load what they name when used."""
    found = [group for group, members in GROUPS.items()
             if any(module == member or module.startswith(f"{member}.") for member in members)]
    return found[0] if found else None


def imports(tree: ast.AST) -> Iterator[str]:
    """Modules that a module imports, inside functions too; not what is for type checkers alone."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        else:
            yield from imports(node)


def arrows() -> dict[str, set[str]]:
    """What every group imports.

    Raises:
        CycleError: imports in a circle.
        LookupError: a module belongs to no group.
    """
    found: dict[str, set[str]] = {group: set() for group in GROUPS}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            module = module_name(path)
            own = group_of(module)
            if own is None:
                if module == "workbench":
                    continue
                raise LookupError(f"{module} belongs to no group of GROUPS")
            for name in imports(ast.parse(path.read_text(encoding="utf-8"))):
                if name.split(".")[0] in PACKAGES and not (
                        module == FOR_NOTEBOOKS[0] and name.startswith(FOR_NOTEBOOKS[1])):
                    other = group_of(name)
                    found[own] |= {other} - {own, None}  # type: ignore[arg-type]
    TopologicalSorter(found).prepare()
    return found


def reduced(graph: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The arrows that no chain of others replaces."""
    def below(group: str) -> set[str]:
        return set().union(*({other} | below(other) for other in graph[group]))

    return {group: {other for other in others if not any(other in below(third) for third in others - {other})}
            for group, others in graph.items()}


def levels(graph: Mapping[str, set[str]]) -> dict[str, int]:
    """How many arrows lie below every group, at most."""
    found: dict[str, int] = {}
    for group in TopologicalSorter(graph).static_order():
        found[group] = 1 + max((found[other] for other in graph[group]), default=-1)
    return found


#: Passes over the rows, down and up, after which nothing changes places any more.
SWEEPS = 24

#: A box, or a place that an arrow goes through on its way past a row: whose it is, where it leads, and the row.
Node = tuple[str, str, int]


def arranged(graph: Mapping[str, set[str]], level: Mapping[str, int]) -> tuple[dict[Node, float], list[list[Node]]]:
    """Where every node stands along its row, from 0 to 1, and the nodes that every arrow goes through.

    Rows are put in the order of the means of what each node is joined with (Sugiyama, Tagawa and Toda 1981), so that
    few arrows cross; an arrow has a place of its own in every row that it passes, so that it goes through no box.
    """
    routes = [[(group, "", level[group]),
               *((group, other, height) for height in range(level[group] - 1, level[other], -1)),
               (other, "", level[other])] for group, others in graph.items() for other in sorted(others)]
    rows: dict[int, list[Node]] = {}
    for node in dict.fromkeys([*((group, "", level[group]) for group in graph), *(n for r in routes for n in r)]):
        rows.setdefault(node[2], []).append(node)
    joined: dict[Node, list[Node]] = {node: [] for row in rows.values() for node in row}
    for route in routes:
        for upper, lower in pairwise(route):
            joined[upper].append(lower)
            joined[lower].append(upper)

    def spread() -> dict[Node, float]:
        return {node: (k + 0.5) / len(row) for row in rows.values() for k, node in enumerate(row)}

    for sweep in range(SWEEPS):
        step = 1 if sweep % 2 else -1
        for height in sorted(rows)[::step]:
            place = spread()
            means = {node: [place[other] for other in joined[node] if other[2] == height - step]
                     for node in rows[height]}
            rows[height].sort(key=lambda node: sum(means[node]) / len(means[node]) if means[node] else place[node])
    return spread(), routes


def draw(path: Path) -> Path:
    """Write the picture; an arrow points from who imports to what is imported."""
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path as Curve

    graph = reduced(arrows())
    level = levels(graph)
    place, routes = arranged(graph, level)
    width, height, half = 12.0, 1.3, 0.24
    rows = max(level.values()) + 1
    figure = Figure(figsize=(9.5, 1.05 * rows + 0.3), dpi=110)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for route in routes:
        points = [(width * place[node], height * node[2]) for node in route]
        # Past a row an arrow is upright, between rows it bends.
        ends = [points[0][1] - half, *(each[1] for each in points[1:-1]), points[-1][1] + half]
        along, codes = [(points[0][0], ends[0])], [Curve.MOVETO]
        for ((x, _), (u, _)), (high, low) in zip(pairwise(points), pairwise(ends), strict=True):
            middle = 0.5 * (high + low)
            along += [(x, middle), (u, middle), (u, low)]
            codes += [Curve.CURVE4] * 3
        axes.add_patch(FancyArrowPatch(path=Curve(along, codes), arrowstyle="-|>", mutation_scale=11.0,
                                       color="#6b7a8c", linewidth=1.0, shrinkA=0.0, shrinkB=0.0))
    for group, row in level.items():
        axes.text(width * place[group, "", row], height * row, group, ha="center", va="center", fontsize=10.5,
                  bbox={"boxstyle": "round,pad=0.45", "facecolor": "#e8f1fa", "edgecolor": "#0072b2"})
    axes.set_xlim(0.0, width)
    axes.set_ylim(-0.6, height * (rows - 1) + 0.6)
    axes.axis("off")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
    return path


if __name__ == "__main__":
    print(draw(Path(sys.argv[1] if len(sys.argv) > 1 else "out/architecture.png")))
