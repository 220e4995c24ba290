"""A trial of drawing off screen, for ``workbench doctor``."""

from __future__ import annotations

import numpy as np

from workbench.render.canvas import DrawnShape, photograph, vtk_modules


def drawn_window() -> str:
    """The class of the window in which VTK drew a triangle.

    Raises RuntimeError if the picture is empty, or as :func:`vtk_modules`.
    """
    triangle = DrawnShape(np.eye(3), np.array([[0, 1, 2]]), "black")
    if photograph([triangle], azimuth=45.0, elevation=35.0, width=64, height=48).min() > 128:
        raise RuntimeError("the picture of a black triangle is white")
    return str(vtk_modules("vtkRenderingCore")[0].vtkRenderWindow().GetClassName())
