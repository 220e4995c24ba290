"""Tables of materials, of versions of a fit, and of differences."""

from __future__ import annotations

from collections.abc import Iterable

from materials import Fluid, Registry, differences
from materials.history import Version, load_quietly
from materials.kinds import Material
from materials.versions import read_withdrawal
from workbench.files.errors import InputError
from workbench.report.page import TextTable, Value, in_unit, table


def materials_table(registry: Registry) -> TextTable:
    """Every material of a registry, with its kind, its density, and notes."""
    return table("name | kind | density (kg/m^3):.6g | remarks", (
        _material_row(registry, name) for name in registry.names()))


def _material_row(registry: Registry, name: str) -> tuple[Value, ...]:
    """One spoiled file does not hide the others."""
    try:
        material, withdrawn = load_quietly(registry, name), read_withdrawal(registry.find(name)[1])
    except InputError:
        return name, "faulty", None, "see `workbench materials check`"
    remarks = []
    if material.fit is not None:
        low, high = material.fit.band
        remarks.append(f"fitted, {low / 1e6:.4g} to {high / 1e6:.4g} MHz")
    if withdrawn is not None:
        remarks.append("withdrawn")
    if not isinstance(material, Fluid) and not any(number.imag for number in material.parameters().values()):
        remarks.append("lossless")
    return name, type(material).__name__, material.density, "; ".join(remarks)


def versions_table(versions: Iterable[Version]) -> TextTable:
    """The versions of a saved fit, with their dates and residuals."""
    rows: list[tuple[Value, ...]] = []
    for version in versions:
        fit = None if version.material is None else version.material.fit
        figures = (None, None, None) if fit is None else (fit.date, fit.mape_percent / 100.0, fit.algorithm)
        withdrawn = version.withdrawal
        remark = version.fault if withdrawn is None else f"withdrawn on {withdrawn.date}: {withdrawn.reason}"
        rows.append((version.name, *figures, remark))
    return table("version | fitted on | MAPE (%):.3g | algorithm | remarks", rows)


def differences_table(first: Material, second: Material) -> TextTable:
    """Every number of two materials (SI), and how far apart they are."""
    columns = ("SI", first.name, second.name, "difference (%)", "in standard uncertainties")
    return TextTable(columns, tuple(
        (row.parameter, f"{row.first:.6g}", f"{row.second:.6g}", in_unit(row.percent, "", "+.3f"),
         in_unit(row.deviations, "", "+.2f")) for row in differences(first, second)))
