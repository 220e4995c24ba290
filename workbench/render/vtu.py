"""A field as a VTU file for ParaView.

It has all regions, Lagrange cells of the fields' order, and complex amplitudes as two real arrays. VTK assumes that the
nodes of a Lagrange cell are equally spaced, so values are written at such points, not at the Gauss-Lobatto nodes.
Probes and plots along a line then show the solution itself.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.acoustics.nodal import NodalMesh
from workbench.fem.elements import Lagrange, polynomials
from workbench.files.writing import replacing

if TYPE_CHECKING:
    from workbench.acoustics.fields import Fields


def write_vtu(fields: Fields, path: Path) -> Path:
    """Write every array of `fields` to `path`, atomically.

    r is VTK's x and z its y, in metres; vectors get a third component of zero. Complex `name` becomes `name_real` and
    `name_imag` (time factor e^{-i w t}). A field is NaN in a region without it, and is left out if no region has it.
    Cell array `region` is the index of its name in field array `region_names`; field arrays are `frequency` (Hz) and
    `voltage` (V, complex as two).

    Raises:
        ValueError: a suffix other than .vtu.
    """
    if path.suffix.lower() != ".vtu":
        raise ValueError(f"cannot write {path.name!r}: the suffix is {path.suffix!r}; expected .vtu")
    mesh = fields.mesh
    arrays: dict[str, NDArray[Any]] = {
        "displacement": fields.displacement, "potential": fields.potential, "pressure": fields.pressure,
        "velocity": fields.velocity, "stress": fields.stress, "energy_density": fields.energy_density,
    }
    import pyvista

    flat = np.column_stack([_equally_spaced(mesh, mesh.points), np.zeros(len(mesh.points))])
    along_r, along_z = np.array(Lagrange(mesh.order).indices).T
    nodes = mesh.cells[:, along_r, along_z]
    # Each cell begins with the number of its nodes.
    cells = np.column_stack([np.full(len(nodes), nodes.shape[1]), nodes])
    kinds = np.full(len(nodes), pyvista.CellType.LAGRANGE_QUADRILATERAL)
    grid = pyvista.UnstructuredGrid(cells.ravel(), kinds, flat)
    for name, at_nodes in arrays.items():
        # A field without any value has no range, and readers would report an error.
        if np.isnan(at_nodes).all():
            continue
        values = _equally_spaced(mesh, at_nodes)
        padded = np.column_stack([values, np.zeros(len(values))]) if values.shape[1:] == (2,) else values
        if np.iscomplexobj(padded):
            grid.point_data[f"{name}_real"], grid.point_data[f"{name}_imag"] = padded.real.copy(), padded.imag.copy()
        else:
            grid.point_data[name] = padded
    grid.cell_data["region"] = mesh.region
    grid.field_data["region_names"] = list(mesh.regions)
    grid.field_data["frequency"] = [fields.frequency]
    grid.field_data["voltage_real"], grid.field_data["voltage_imag"] = [fields.voltage.real], [fields.voltage.imag]
    with replacing(path) as whole:
        grid.save(whole)
    return path


def _equally_spaced(mesh: NodalMesh, values: NDArray[Any]) -> NDArray[Any]:
    """Nodal `values` (N, ...) interpolated at equally spaced points, (N, ...)."""
    weights = polynomials(mesh.order, np.linspace(0.0, 1.0, mesh.order + 1))
    result = np.empty_like(values)
    # Neighbouring cells agree on an edge, since its values depend only on its own nodes.
    result[mesh.cells] = np.einsum("ia,jb,mij...->mab...", weights, weights, values[mesh.cells], optimize=True)
    return result
