"""Checks of passivity: a material stores and loses energy, never creates it.

The power lost per volume is (w/2) x^dagger Im(K) x for every strain and field x, with the 9 x 9 matrix

    K = [[-C, e^T], [e, eps]]        (time factor e^{-i w t}; Acevedo-Espinosa et al. (RP-UEIS), eq. A.4)

so Im K must have no negative eigenvalue. The matrix is built in full, complex piezoelectric constants included; the
paper's inequalities (13) and (14) are the special case of real ones. The stored energy is checked as well: the real
stiffness must be positive definite and the permittivities positive.

Printed constants are rounded, and rounding may move a fit across the boundary of passivity. By Weyl's inequality an
eigenvalue moves by no more than the norm of the change, and no change within the rounding has a larger norm than the
matrix of the roundings. That norm is the tolerance; it follows from the data file alone.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING

from materials.kinds import CubicSolid, Fluid, IsotropicSolid, Material, Piezoelectric, Solid
from workbench.files.errors import InputError
from workbench.files.quantities import VACUUM_PERMITTIVITY

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SIGN_CONVENTION = "time factor e^{-i w t}: loss is a negative imaginary stiffness and a positive imaginary permittivity"


class PassivityWarning(UserWarning):
    """A material would create energy, but within the rounding of its constants."""


def stored_energy_matrix(material: Piezoelectric) -> NDArray[np.complex128]:
    """Matrix K = [[-C, e^T], [e, eps]], 9 x 9, in Pa.

    Rows are the strains 11 22 33 23 13 12 (Voigt, engineering shear) and the fields 1 2 3. The fields have the unit
    sqrt(c33' / eps33'), which gives every entry in Pa without a change of sign of any eigenvalue.
    """
    p = material.parameters()
    signed = {name: -number if name.startswith("c") else number for name, number in p.items()}
    return _assemble(_in_pascal(material, signed), -complex(material.c66))


def _in_pascal(material: Piezoelectric, entries: Mapping[str, complex]) -> dict[str, complex]:
    """The `entries` with the electric ones scaled to Pa."""
    field_unit = math.sqrt(complex(material.c33).real / complex(material.absolute_eps33).real)
    scales = dict.fromkeys(("e31", "e33", "e15"), field_unit)
    scales |= dict.fromkeys(("eps11", "eps33"), VACUUM_PERMITTIVITY * field_unit**2)
    return {name: number * scales.get(name, 1.0) for name, number in entries.items()}


def _assemble(entries: Mapping[str, complex], c66: complex) -> NDArray[np.complex128]:
    """The symmetric 9 x 9 matrix of a poled ceramic."""
    import numpy as np

    matrix = np.zeros((9, 9), dtype=complex)
    matrix[0, 0] = matrix[1, 1] = entries["c11"]
    matrix[0, 1] = matrix[1, 0] = entries["c12"]
    matrix[0, 2] = matrix[1, 2] = matrix[2, 0] = matrix[2, 1] = entries["c13"]
    matrix[2, 2] = entries["c33"]
    matrix[3, 3] = matrix[4, 4] = entries["c44"]
    matrix[5, 5] = c66
    matrix[8, 0] = matrix[8, 1] = matrix[0, 8] = matrix[1, 8] = entries["e31"]
    matrix[8, 2] = matrix[2, 8] = entries["e33"]
    matrix[6, 4] = matrix[7, 3] = matrix[4, 6] = matrix[3, 7] = entries["e15"]
    matrix[6, 6] = matrix[7, 7] = entries["eps11"]
    matrix[8, 8] = entries["eps33"]
    return matrix


def _cubic_moduli(constants: Mapping[str, complex]) -> tuple[complex, complex, complex]:
    """Eigenvalues of a cubic stiffness: compression and both shears."""
    return (constants["c11"] + 2.0 * constants["c12"], constants["c11"] - constants["c12"], constants["c44"])


def dissipation_matrix(material: Solid) -> NDArray[np.float64]:
    """Matrix Im K (Pa); its negative eigenvalues create energy.

    It is 9 x 9 for a piezoelectric solid, diag(-K'', -G'') for an isotropic solid, which loses by K'' in compression
    and by G'' in shear, and that of the three moduli for a cubic solid.
    """
    import numpy as np

    if isinstance(material, CubicSolid):
        return -np.diag([modulus.imag for modulus in _cubic_moduli(material.parameters())])

    if isinstance(material, Piezoelectric):
        return np.asarray(stored_energy_matrix(material).imag)
    return -np.diag([complex(material.bulk_modulus).imag, complex(material.shear_modulus).imag])


def smallest_dissipation(material: Solid) -> float:
    """The smallest eigenvalue (Pa) of the dissipation matrix. A negative one creates energy."""
    import numpy as np

    return float(np.linalg.eigvalsh(dissipation_matrix(material))[0])


def rounding_tolerance(material: Solid, loss_tolerances: Mapping[str, float]) -> float:
    """Largest effect (Pa) of the rounding of losses on the smallest dissipation. `loss_tolerances` bounds the error of
    the imaginary part (SI) of each parameter by name; a missing name is exact."""
    import numpy as np

    bounds = {name: loss_tolerances.get(name, 0.0) for name in material.PARAMETERS}
    if isinstance(material, IsotropicSolid):
        return max(bounds["bulk_modulus"], bounds["shear_modulus"])
    if isinstance(material, CubicSolid):
        return max(bounds["c11"] + 2.0 * bounds["c12"], bounds["c44"])
    rounding = _assemble(_in_pascal(material, bounds), (bounds["c11"] + bounds["c12"]) / 2)
    return float(np.linalg.norm(rounding, 2))


def check_passive(
    material: Material, *, loss_tolerances: Mapping[str, float], source: str, notes: list[str] | None = None
) -> None:
    """Raise if the material cannot be passive, stable matter.

    Args:
        material: any kind; of a fluid only the signs are checked.
        loss_tolerances: as in :func:`rounding_tolerance`.
        source: the origin of the material, for messages.
        notes: a list that collects the warning as text, if given.

    Raises:
        InputError: a number that must be positive is not; a loss has the wrong sign; the stiffness is not positive
            definite; an eigenvalue of the dissipation matrix is negative beyond the tolerance.

    Warns:
        PassivityWarning: an eigenvalue is negative within the tolerance.
    """
    _check_positive(material, source)
    if isinstance(material, Fluid):
        return
    _check_signs(material, loss_tolerances, source)
    _check_stiffness(material, source)
    smallest, allowed = smallest_dissipation(material), rounding_tolerance(material, loss_tolerances)
    arithmetic = _arithmetic_error(material)  # without it, a lossless material would be refused for -1e-7 Pa
    if smallest >= -arithmetic:
        return
    if smallest < -(allowed + arithmetic):
        raise InputError(
            source, "dissipation matrix Im K", f"smallest eigenvalue {smallest / 1e9:.3g} GPa",
            f"no eigenvalue below -{allowed / 1e9:.3g} GPa, the declared rounding and uncertainty of the losses "
            f"({SIGN_CONVENTION})",
        )
    note = (f"{material.name}: used as printed. Its losses are rounded, so an eigenvalue of the dissipation matrix "
            f"is {-smallest / 1e9:.3g} GPa below zero, within the {allowed / 1e9:.3g} GPa of rounding; nothing to do")
    if notes is not None:
        notes.append(note)
        return
    warnings.warn(note, PassivityWarning, stacklevel=6)  # the level of the caller of Registry.load


def _arithmetic_error(material: Solid) -> float:
    """Bound (Pa) on the floating-point error of a dissipation eigenvalue."""
    import numpy as np

    return 9 * float(np.finfo(float).eps) * float(np.linalg.norm(dissipation_matrix(material), 2))


#: Parameters whose real part is positive in any material; the others (c12, c13, e31 ...) may have either sign.
_POSITIVE = (
    "density", "c11", "c33", "c44", "eps11", "eps33", "bulk_modulus", "shear_modulus", "sound_speed", "shear_viscosity",
    "bulk_viscosity", "heat_capacity_ratio", "thermal_conductivity", "heat_capacity", "softening_temperature",
)  # fmt: skip


def _check_positive(material: Material, source: str) -> None:
    thermal = {} if isinstance(material, Fluid) else material.thermal()
    for name, number in (material.parameters() | thermal).items():
        if not (math.isfinite(number.real) and math.isfinite(number.imag)):
            raise InputError(source, name, number, "a finite number")
        # A particle given by its compressibility alone has no shear modulus.
        if name == "shear_modulus" and number == 0:
            continue
        if name in _POSITIVE and number.real <= 0:
            raise InputError(source, name, number.real, "a positive number (SI)")


def _check_signs(
    material: Solid, loss_tolerances: Mapping[str, float], source: str
) -> None:
    """Check the diagonal of Im K for a wrong sign convention."""
    for name, number in material.parameters().items():
        if name in ("c11", "c33", "c44", "bulk_modulus", "shear_modulus"):
            gained, sign = number.imag, "<= 0"
        elif name in ("eps11", "eps33"):
            gained, sign = -number.imag, ">= 0"
        else:
            continue
        if gained > loss_tolerances.get(name, 0.0):
            raise InputError(source, name, f"imaginary part {number.imag:.4g}",
                             f"an imaginary part {sign} ({SIGN_CONVENTION})")


def _check_stiffness(material: Solid, source: str) -> None:
    if isinstance(material, IsotropicSolid):
        return  # positive moduli, already checked, are the whole condition
    import numpy as np

    if isinstance(material, CubicSolid):
        smallest = min(modulus.real for modulus in _cubic_moduli(material.parameters()))
    else:
        smallest = float(np.linalg.eigvalsh(-stored_energy_matrix(material)[:6, :6].real)[0])
    if smallest <= 0:
        raise InputError(source, "stiffness matrix", f"smallest eigenvalue {smallest / 1e9:.4g} GPa",
                         "a positive definite stiffness")


def check_longitudinal_loss(
    moduli: Mapping[str, complex], numbers: Mapping[str, complex], tolerances: Mapping[str, float], file: str
) -> None:
    """Raise if a longitudinal loss is below the part that shear contributes."""
    bulk, shear = complex(moduli["bulk_modulus"]), complex(moduli["shear_modulus"])
    if bulk.imag <= tolerances["bulk_modulus"]:
        return
    whole = bulk + 4 * shear / 3
    raise InputError(file, "longitudinal_speed", f"a loss tangent of {abs(whole.imag) / whole.real:.3g}",
                     f"one of {-4 * shear.imag / 3 / whole.real:.3g} at least, the part of the shear loss "
                     f"({numbers['shear_speed'].real:g} m/s, loss tangent {-shear.imag / shear.real:.3g}): state both")
