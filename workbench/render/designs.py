"""Pictures of the descents of a search, and of a Pareto front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.render.canvas import new_figure, save_figure
from workbench.render.plots import LINE_COLOURS, tidy


@dataclass(frozen=True, eq=False)
class Course:
    """One descent of a search. ``values`` (n,) are those of the figure at its evaluations, NaN if a constraint was
    broken or there was no figure. ``optimum`` is the number of its end, 0 for the best."""

    values: NDArray[np.float64]
    optimum: int


def draw_descents(courses: Sequence[Course], path: Path, *, label: str, maximise: bool, title: str = "") -> Path:
    """Draw the best figure so far of every descent. Colours are by the optimum at its end."""
    figure = new_figure(8.0, 4.2)
    axes = figure.subplots()
    best_of = np.fmax.accumulate if maximise else np.fmin.accumulate
    shown: set[int] = set()
    for course in courses:
        if not np.isfinite(course.values).any():
            continue
        kind = min(course.optimum, len(LINE_COLOURS) - 1)
        words = "best optimum" if kind == 0 else f"optimum {kind + 1}"
        if course.optimum > kind:
            words += " and further"
        so_far = best_of(course.values)
        at = np.arange(1, so_far.size + 1)
        axes.plot(at, so_far, color=LINE_COLOURS[kind], linewidth=1.2, alpha=0.7,
                  label=words if kind not in shown else None)
        axes.plot(at[-1], so_far[-1], "o", color=LINE_COLOURS[kind], markersize=4.0)
        shown.add(kind)
    axes.set_xlabel("evaluations of the model in a descent")
    axes.set_ylabel(label)
    axes.set_title(title, fontsize=10)
    if shown:
        axes.legend(frameon=False)
    tidy(axes)
    figure.tight_layout()
    return save_figure(figure, path)


def draw_front(
    members: NDArray[np.float64], confirmed: NDArray[np.float64], present: NDArray[np.float64], path: Path, *,
    labels: tuple[str, str], title: str = "",
) -> Path:
    """Draw the Pareto front (n, 2) of two objectives. Also its chips `confirmed` by full solves (k, 2), and the
    `present` one (2,); NaN values are left out."""
    figure = new_figure(6.5, 5.0)
    axes = figure.subplots()
    axes.plot(members[:, 0], members[:, 1], "o-", color=LINE_COLOURS[0], markersize=4.0, linewidth=1.0,
              label="front, on the model")
    axes.plot(confirmed[:, 0], confirmed[:, 1], "s", color=LINE_COLOURS[1], markersize=8.0, fillstyle="none",
              label="by full solves")
    axes.plot(*present, "x", color=LINE_COLOURS[6], markersize=8.0, label="present chip")
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.set_title(title, fontsize=10)
    axes.legend(frameon=False)
    tidy(axes)
    figure.tight_layout()
    return save_figure(figure, path)
