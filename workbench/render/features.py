"""Features of a round chip as seen from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from geometry.chip import Chip
from geometry.features import Feature
from workbench.render.canvas import new_figure, role_colour, save_figure

#: Side of the picture in inches.
_SIDE = 6.0
_OUTLINE = "#303030"
#: Colour of a feature on the upper face of its layer, and on the lower one.
_COLOURS = {"top": "#d55e00", "bottom": "#0072b2"}


def draw_features(chip: Chip, path: Path) -> Path:
    """Draw the outlines of a chip's layers and its features.

    The angle is counted from the right, against the clock.
    """
    from matplotlib.patches import Circle, Patch

    figure = new_figure(_SIDE, _SIDE)
    axes = figure.add_subplot()
    for layer in sorted(chip.layers, key=lambda each: -each.outer_radius):
        axes.add_patch(Circle((0.0, 0.0), 1e3 * layer.outer_radius, facecolor=role_colour(layer.region), alpha=0.25,
                              edgecolor=_OUTLINE, linewidth=0.6))
    for feature in chip.features:
        _draw(axes, feature)
    # Room for the legend in a corner, and for the sizes.
    reach = 1.3e3 * max(layer.outer_radius for layer in chip.layers)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="x (mm)", ylabel="y (mm)",
             title=f"{chip.name}, from above")
    handles = [Patch(color=colour, label=f"on the {face} of its layer")
               for face, colour in _COLOURS.items() if any(each.face == face for each in chip.features)]
    axes.legend(handles=handles, loc="upper left", frameon=False)
    return save_figure(figure, path)


def _draw(axes: object, feature: Feature) -> None:
    """Draw a feature with its size beside it."""
    from matplotlib.axes import Axes
    from matplotlib.patches import Circle

    assert isinstance(axes, Axes)
    x, y = 1e3 * feature.distance * np.array([np.cos(feature.angle), np.sin(feature.angle)])
    colour, radius = _COLOURS[feature.face], 0.5e3 * feature.diameter
    # A gap is an open circle.
    is_gap = feature.kind == "gap"
    axes.add_patch(Circle((x, y), radius, color=colour, fill=not is_gap, hatch="//" if is_gap else None))
    size = f"gap, {feature.size}" if is_gap else feature.size
    axes.annotate(f"{size}\n{feature.region}", (x, y - radius), (0, -4), textcoords="offset points",
                  ha="center", va="top", fontsize=9)
