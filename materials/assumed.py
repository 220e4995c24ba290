"""The assumed loss of a lossless ceramic in a simulation.

Many sources print no loss, and a resonance without loss has no finite height. The assumed values are those that makers
print for the two classes of lead zirconate titanate (types I to VI of MIL-STD-1376B): mechanical quality factor Q_m of
the radial mode of a disc and dielectric loss tan delta at 1 kHz, both at small signals,

- hard (type I, PZT-4): Q_m 500, tan delta 0.004 (makers: 400 to 800 and 0.003 to 0.005),
- soft (type II, PZT-5A; type VI, PZT-5H): Q_m 75, tan delta 0.02 (makers: 60 to 80 and 0.015 to 0.025),

as in the data sheets of SP-4 and SP-5A (Sparkler Ceramics) and of PIC255 (PI Ceramic: 80 and 0.020). They apply to
every stiffness at constant field, c (1 - i / Q_m), and to the permittivities at constant strain, eps (1 + i tan delta),
e^{-i w t}; the piezoelectric constants e stay real.

A polymer without a loss stays without one, since no such classes exist; a finding names it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from materials.kinds import IsotropicSolid, Material, Piezoelectric


@dataclass(frozen=True)
class AssumedLoss:
    """A mechanical quality factor and a dielectric loss tangent."""

    mechanical_q: float
    dielectric_loss_tangent: float


#: Assumed losses by class of ceramic (`materials.kinds.CERAMICS`).
ASSUMED = {"hard": AssumedLoss(500.0, 0.004), "soft": AssumedLoss(75.0, 0.02)}

#: The assumed class of a ceramic whose source does not state it.
UNSTATED = "soft"

#: Young's modulus (Pa) between polymers (PEEK 4 GPa, phenolic resin 8 GPa) and metals and glasses (lead 16 GPa,
#: magnesium 45 GPa, glass 60 GPa and more).
STIFFEST_POLYMER = 10e9


def is_lossless(material: Material) -> bool:
    """Whether every number of a material is real."""
    return not any(number.imag for number in material.parameters().values())


def with_assumed_loss(material: Material) -> tuple[Material, str]:
    """The material with the assumed loss and a note, if lossless. Only piezoelectric materials change; others return as
    they are, with an empty note."""
    if not isinstance(material, Piezoelectric) or not is_lossless(material):
        return material, ""
    loss = ASSUMED[material.ceramic or UNSTATED]
    changed: dict[str, Any] = {}
    for name, number in material.parameters().items():
        if name.startswith("c"):
            changed[name] = number * (1.0 - 1j / loss.mechanical_q)
        elif name.startswith("eps"):
            changed[name] = number * (1.0 + 1j * loss.dielectric_loss_tangent)
    named = material.ceramic or f"{UNSTATED} (its entry does not state it)"
    return replace(material, **changed), (
        f"{material.name} states no loss; the assumed loss is that of a {named} ceramic, Q_m {loss.mechanical_q:g} "
        f"and tan delta {loss.dielectric_loss_tangent:g}. Heights and widths of resonances depend on it: state "
        "mechanical_q and dielectric_loss_tangent in an entry of your own, or fit the disc")


def lossless_polymer(material: Material) -> str:
    """The finding on a polymer whose source states no loss, or "".

    Glasses, metals and crystals without a loss have none that matters in a chip.
    """
    if not isinstance(material, IsotropicSolid) or not material.shear_modulus or not is_lossless(material):
        return ""
    bulk, shear = complex(material.bulk_modulus).real, complex(material.shear_modulus).real
    if 9.0 * bulk * shear / (3.0 * bulk + shear) > STIFFEST_POLYMER:
        return ""
    return (f"{material.name} is a polymer whose entry states no loss, and it is modelled without one: Q, the heights "
            "of resonances and the energies at resonance are upper bounds. State a loss (q, loss_tangent or "
            "attenuation) in an entry of your own, or fit it: `workbench fit polymer`")
