"""Hypotheses about a ceramic disc."""

from __future__ import annotations

from collections.abc import Iterator

from geometry.names import ELECTRODE_GROUND, ELECTRODE_LIVE, TRANSDUCER
from materials.kinds import Piezoelectric
from workbench.campaign.campaign import DeviceState
from workbench.catalogue.effect import (
    MISTAKEN_DENSITY,
    MISTAKEN_STIFFNESS,
    Device,
    Effect,
    mistaken,
    other_than_stated,
    with_terms,
)
from workbench.fitting.parameter import Parameter
from workbench.model.numbers import LOSS, ParameterName
from workbench.physics import depoled, electrode_mass, partial_electrode, softening, surface_load
from workbench.physics.annulus import Annulus
from workbench.physics.term import Admissible

#: Range of a ceramic's loss factors, in words.
CERAMIC = "from none to a soft ceramic driven hard: data sheets state 0.1 to 2 %"

#: Exponent of each constant: a disc scaled by factor**exponent has the same impedance for every factor.
GAUGE = {**dict.fromkeys(("density", "c11", "c12", "c13", "c33", "c44"), 1.0),
         **dict.fromkeys(("e31", "e33", "e15"), 0.5)}

#: Relative error of the density that was assumed in the fit of a ceramic's constants.
MISTAKEN_GAUGE = Admissible(
    -0.08, 0.08, "1", "nearly twice the 4.8 % between the density stated in Acevedo-Espinosa et al. (RP-UEIS), "
    "7862 kg/m^3, and the 7500 with which their constants resonate where they measured")


def transducer(device: Device) -> Iterator[Effect]:
    """Errors and effects of a ceramic disc."""
    states = device.holding(TRANSDUCER)
    material = states[0].materials[TRANSDUCER]
    assert isinstance(material, Piezoelectric)
    yield from _constants(device, material)
    yield _gauge(material.name)
    yield with_terms("electrode mass", TRANSDUCER, "mass", "the metal on the faces has a mass, and a stiffness of its "
                     "own", states,
                     lambda _: [electrode_mass.ElectrodeMass(ELECTRODE_LIVE, ELECTRODE_GROUND, TRANSDUCER)])
    yield with_terms("rim of the transducer without piezoelectricity", TRANSDUCER, "coupling", "an edge that is not "
                     "poled", states, lambda _: [depoled.DepoledAnnulus(TRANSDUCER, material.name,
                                                                        Annulus("rim without poling"))])
    yield with_terms("electrode that ends before the rim", TRANSDUCER, "geometry", "a face of the transducer is bare "
                     "at its edge", states, lambda state: [partial_electrode.PartialElectrode(
                         TRANSDUCER, material.name, Annulus("bare rim"), upper=_is_live_on_top(state))])
    yield with_terms("load on the face of the transducer", TRANSDUCER, "loss", "a holder or a backing pushes back",
                     states, lambda state: [surface_load.SurfaceLoad(
                         ELECTRODE_GROUND if _is_live_on_top(state) else ELECTRODE_LIVE, TRANSDUCER, "backing")])
    if None not in (drives := {state.drive for state in states}) and len(drives) > 1:
        yield with_terms("softening with the drive", TRANSDUCER, "stiffness", "the ceramic is softer and loses more "
                         "when driven harder", states, lambda _: [softening.Softening(TRANSDUCER, material.name)])


def _is_live_on_top(state: DeviceState) -> bool:
    """Whether the live electrode is on the face below the stack."""
    return state.chip.electrodes.live == "top"


def _loss(material: Piezoelectric, coefficient: str, sign: float) -> dict[str, Admissible]:
    """The range of a loss up to 5 %. The loss has the sign `sign`; 0 allows both."""
    size = 0.05 * abs(complex(getattr(material, coefficient)).real)
    low, high = sorted((0.0, sign * size)) if sign else (-size, size)
    name = f"{material.name}.{coefficient}{LOSS}"
    return {name: Admissible(low, high, ParameterName.parse(name).unit, CERAMIC)}


def _constants(device: Device, material: Piezoelectric) -> Iterator[Effect]:
    """Constants and losses that differ from the stated ones."""
    dielectric = _loss(material, "eps33", 1.0)
    yield other_than_stated(device, "dielectric loss", TRANSDUCER, "loss", "the permittivity has a loss", dielectric)
    yield other_than_stated(device, "complex piezoelectric constant", TRANSDUCER, "loss", "e33 has a phase of its own",
                            {**_loss(material, "e33", 0.0), **dielectric})
    for coefficient in ("c11", "c33", "c44"):
        yield other_than_stated(device, f"loss of {coefficient} of the transducer", TRANSDUCER, "loss",
                                "a further stiffness loss", _loss(material, coefficient, -1.0))
        stiffness = mistaken(f"{material.name}.{coefficient}", complex(getattr(material, coefficient)).real,
                             MISTAKEN_STIFFNESS)
        yield other_than_stated(device, f"{coefficient} of the transducer", TRANSDUCER, "stiffness",
                                "a wrong stiffness", stiffness)
    yield other_than_stated(device, "density of the transducer", TRANSDUCER, "mass", "a wrong density",
                            mistaken(f"{material.name}.density", material.density, MISTAKEN_DENSITY))


def _gauge(material: str) -> Effect:
    """A disc whose constants were fitted with a wrong density. Its spectrum is the right one without a load, and a
    wrong one under a load."""
    name, limit = f"{TRANSDUCER}.gauge", MISTAKEN_GAUGE
    powers = tuple((f"{material}.{coefficient}", power) for coefficient, power in GAUGE.items())
    return Effect("density that the constants were fitted with", TRANSDUCER, "mass", "the disc's constants come from a "
                  "fit with a wrong density, which scales them all",
                  (Parameter(name, 0.0, limit.lowest, limit.highest, None, limit.unit, powers=powers),),
                  admissible={name: limit})
