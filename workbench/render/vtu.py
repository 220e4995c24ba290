"""A field as a VTU file for ParaView: all regions, biquadratic cells, complex amplitudes as two real arrays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from inputs import replacing
from workbench.render.canvas import pyvista

if TYPE_CHECKING:
    from workbench.fields import Fields


def write_vtu(fields: Fields, path: Path, *, extra: Mapping[str, NDArray[Any]] | None = None) -> Path:
    """Write every array of `fields` and the `extra` nodal arrays (N, ...) to `path`, all at once; returns `path`.

    r is VTK's x and z its y, in metres; vectors get a third component of zero. Complex `name` becomes `name_real` and
    `name_imag` (time factor e^{-i w t}); what a region does not carry is NaN there, and a field that no region carries
    is left out. Cell array `region` is the index of its name in field array `region_names`; field arrays `frequency`
    (Hz) and `voltage` (V, complex as two) are kept.

    Raises:
        ValueError: a suffix other than .vtu, or an extra array of another length or that hides a field.
    """
    if path.suffix.lower() != ".vtu":
        raise ValueError(f"cannot write {path.name!r}: the suffix is {path.suffix!r}; expected .vtu")
    mesh = fields.mesh
    arrays: dict[str, NDArray[Any]] = {
        "displacement": fields.displacement, "potential": fields.potential, "pressure": fields.pressure,
        "velocity": fields.velocity, "stress": fields.stress, "energy_density": fields.energy_density,
    }
    for name, values in (extra or {}).items():
        if name in arrays:
            raise ValueError(f"extra array {name!r} has the name of a field")
        if len(values) != len(mesh.points):
            raise ValueError(f"extra array {name!r} has {len(values)} rows; the mesh has {len(mesh.points)} points")
        arrays[name] = values
    module = pyvista()
    flat = np.column_stack([mesh.points, np.zeros(len(mesh.points))])
    grid = module.UnstructuredGrid({module.CellType.BIQUADRATIC_QUAD: mesh.cells}, flat)
    for name, values in arrays.items():
        # A field that lives nowhere has no range, which makes readers complain.
        if np.isnan(values).all():
            continue
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
