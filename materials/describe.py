"""A material as text for people: every number with its unit, uncertainty, source and conditions."""

from __future__ import annotations

from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric
from materials.value import Value


def describe(material: Material) -> str:
    """Several lines: name, kind, source, then one line for each number in SI units and what is known about it."""
    lines = [f"{material.name}: {type(material).__name__}, source {material.source}"]
    for name, number in material.parameters().items():
        known = material.values.get(name)
        lines.append(f"  {name:<22} {_number(number):<28} {'' if known is None else _remarks(known)}".rstrip())
    match material:
        case IsotropicSolid():
            lines.append(f"  compressibility        {material.compressibility:.6g} 1/Pa")
        case Fluid():
            lines.append(f"  temperature            {_optional(material.temperature)} K")
            lines.append(f"  diffusivity of sound   {_optional(material.diffusivity_of_sound)} m^2/s")
        case Piezoelectric():
            lines.append(f"  c66                    {_number(material.c66)}")
    lines.append(f"  slowest wave           {material.slowest_wave_speed():.6g} m/s")
    return "\n".join(lines)


def _number(value: complex) -> str:
    value = complex(value)
    return f"{value.real:.6g}" if value.imag == 0.0 else f"{value.real:.6g} {value.imag:+.4g} i"


def _optional(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.6g}"


def _remarks(value: Value) -> str:
    parts = [f"given in {value.unit}" if value.unit else "", value.source, value.conditions, value.note]
    if value.uncertainty is not None:
        parts.insert(1, f"+- {value.uncertainty:.3g}")
    return "; ".join(part for part in parts if part)
