"""The materials that come along, from their entry files: what each is, how fast its waves are and what it loses."""

from __future__ import annotations

import math
import warnings

from materials import CubicSolid, Fluid, IsotropicSolid, Material, PassivityWarning, Registry, conversions
from materials.registry import PACKAGE_DATA
from workbench.files.tables import read_toml


def _waves(material: Material) -> str:
    """Speeds (m/s) of the waves: of sound; longitudinal and shear; along the poling with the stiffening; in a cubic
    crystal longitudinal along [100] and [110], and both shear waves along [110]."""
    match material:
        case Fluid():
            return f"{material.sound_speed:.0f}"
        case IsotropicSolid():
            speeds = conversions.wave_speeds(material.bulk_modulus, material.shear_modulus, density=material.density)
            return " / ".join(f"{speed:.0f}" for speed in speeds)
        case CubicSolid():
            along = 0.5 * (material.c11 + material.c12) + material.c44
            moduli = (material.c11, along, material.c44, 0.5 * (material.c11 - material.c12))
            return " / ".join(f"{math.sqrt(complex(modulus).real / material.density):.0f}" for modulus in moduli)
    stiffened = complex(material.c33).real + complex(material.e33).real ** 2 / complex(material.absolute_eps33).real
    return f"{math.sqrt(stiffened / material.density):.0f}"


def _losses(material: Material) -> str:
    """Loss tangents: of both waves of a solid; of the stiffness along the poling and of the permittivity there."""
    match material:
        case Fluid():
            return "" if material.shear_viscosity is None else f"{1e3 * material.shear_viscosity:.3g} mPa s"
        case IsotropicSolid():
            tangents = conversions.loss_tangents(material.bulk_modulus, material.shear_modulus)
        case CubicSolid():
            tangents = tuple(-complex(each).imag / complex(each).real for each in (material.c11, material.c44))
        case _:
            stiffness, permittivity = complex(material.c33), complex(material.eps33)
            tangents = (-stiffness.imag / stiffness.real, permittivity.imag / permittivity.real)
    return " / ".join(f"{tangent:.2g}" for tangent in tangents) if any(tangents) else "lossless"


def _thermal(material: Material) -> str:
    """Conductivity in W/(m K), heat capacity in J/(kg K), linear expansion in ppm/K, a dash for what is not known."""
    expansion = None if isinstance(material, Fluid) else material.thermal_expansion
    numbers = (material.thermal_conductivity, material.heat_capacity, None if expansion is None else 1e6 * expansion)
    return " / ".join("-" if number is None else f"{number:.3g}" if number < 1000 else f"{number:.0f}"
                      for number in numbers) if any(number is not None for number in numbers) else ""


def page() -> str:
    """A table of all entries, in Markdown."""
    registry = Registry()
    lines = ["| name | material | density | waves | losses | heat |", "| --- | --- | ---: | ---: | ---: | --- |"]
    for name in registry.names():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PassivityWarning)
            material = registry.load(name)
        title = str(read_toml(PACKAGE_DATA / f"{name}.toml")["title"])
        lines.append(f"| `{name}` | {title} | {material.density:.4g} | {_waves(material)} | {_losses(material)} "
                     f"| {_thermal(material)} |")
    return "\n".join(lines) + "\n"
