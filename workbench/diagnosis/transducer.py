"""The hypotheses about a ceramic disc."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from geometry.names import ELECTRODE_GROUND, ELECTRODE_LIVE, TRANSDUCER
from materials.kinds import Piezoelectric
from workbench.diagnosis.campaign import DeviceState, value_of
from workbench.diagnosis.hypothesis import (
    MISTAKEN_DENSITY,
    MISTAKEN_STIFFNESS,
    Device,
    Effect,
    around,
    new_parameter,
    propose_value,
    rims_of,
    terms_by_state,
    with_terms,
)
from workbench.fitting.parameter import UNITS, Parameter
from workbench.parameter_names import LOSS, ParameterName
from workbench.physics import depoled, electrode_mass, partial_electrode, softening, surface_load
from workbench.physics.term import Admissible, Term

#: Loss factors a data sheet's ceramic can have.
CERAMIC = "from none to a soft ceramic driven hard: data sheets state 0.1 to 2 %"


def transducer(device: Device) -> Iterator[Effect]:
    """What a ceramic disc may be, beyond its constants."""
    states = device.holding(TRANSDUCER)
    material = states[0].materials[TRANSDUCER]
    assert isinstance(material, Piezoelectric)
    yield from _constants(device, material)
    yield from _metal(states)
    yield from _rims(states, material.name)
    yield from _backing(states)
    yield from _driven(states, material.name)


def _loss(material: Piezoelectric, coefficient: str, share: float, sign: float) -> Admissible:
    """What a loss may be: up to a share of the real part, of one sign, or (0) of either."""
    size = abs(complex(getattr(material, coefficient)).real)
    low, high = sorted((0.0, sign * share * size)) if sign else (-share * size, share * size)
    return Admissible(low, high, UNITS[coefficient], CERAMIC)


def _constants(device: Device, material: Piezoelectric) -> Iterator[Effect]:
    """Constants and losses that are not as stated."""
    name = material.name
    yield from propose_value(device, "dielectric loss", TRANSDUCER, "loss", f"{name}.eps33{LOSS}",
                             _loss(material, "eps33", 0.05, 1.0), "the permittivity has a loss")
    e33, eps33 = f"{name}.e33{LOSS}", f"{name}.eps33{LOSS}"
    limits = {e33: _loss(material, "e33", 0.05, 0.0), eps33: _loss(material, "eps33", 0.05, 1.0)}
    new = tuple(new_parameter(n, a, value_of(n, device.states)) for n, a in limits.items() if n not in device.known)
    yield Effect("complex piezoelectric constant", TRANSDUCER, "loss", "e33 has a phase of its own", new,
                 releases=tuple(n for n in limits if n in device.known), admissible=limits)
    for coefficient in ("c11", "c33", "c44"):
        yield from propose_value(device, f"loss of {coefficient} of the transducer", TRANSDUCER, "loss",
                                 f"{name}.{coefficient}{LOSS}", _loss(material, coefficient, 0.05, -1.0),
                                 "a further stiffness loss")
        size = complex(getattr(material, coefficient)).real
        yield from propose_value(device, f"{coefficient} of the transducer", TRANSDUCER, "stiffness",
                                 f"{name}.{coefficient}", around(size, MISTAKEN_STIFFNESS, "Pa"), "a wrong stiffness")
    yield from propose_value(device, "density of the transducer", TRANSDUCER, "mass", f"{name}.density",
                             around(material.density, MISTAKEN_DENSITY, "kg/m^3"), "a wrong density")


def _metal(states: Sequence[DeviceState]) -> Iterator[Effect]:
    """The electrodes as bodies of their own."""
    metal_limits = {f"electrodes.{key}": limit for key, limit in electrode_mass.ADMISSIBLE.items()}
    # Grains of silver between those that hold together and those that do not.
    metal_starts = dict(zip(metal_limits, (0.0, 0.4 * electrode_mass.SILVER_STIFFNESS), strict=True))

    def metal(_state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        return (electrode_mass.ElectrodeMass("electrode_live", "electrode_ground", TRANSDUCER),), metal_starts

    terms, values = terms_by_state(states, metal)
    yield Effect("electrode mass", TRANSDUCER, "mass", "the metal on the faces has a mass, and a stiffness of its own",
                 tuple(Parameter(n, metal_starts[n], 0.0, limit.highest, None, limit.unit)
                       for n, limit in metal_limits.items()),
                 admissible=metal_limits, terms=terms, values=values)


def _rims(states: Sequence[DeviceState], name: str) -> Iterator[Effect]:
    """Rims that lack poling or an electrode; `name` is the material's."""
    rims = rims_of(TRANSDUCER)
    depoled_limits = {f"{rim}.depoled_fraction": depoled.ADMISSIBLE["depoled_fraction"] for rim in rims}

    def unpoled(_state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        return (tuple(depoled.DepoledRim(TRANSDUCER, name, beyond, rim) for rim, beyond in rims.items()),
                {**dict.fromkeys(depoled_limits, 0j), **{f"{rim}.permittivity_excess": 0j for rim in rims}})

    yield with_terms("rim of the transducer without piezoelectricity", TRANSDUCER, "coupling",
                     "a rim that is not poled", states, unpoled, depoled_limits)

    bare_limits = {f"{rim}.bare_fraction": partial_electrode.ADMISSIBLE["bare_fraction"] for rim in rims}

    def short(state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        return ((partial_electrode.PartialElectrode(TRANSDUCER, name, tuple(rims.values()), tuple(rims),
                                                    upper=state.chip.electrodes.live == "top"),),
                dict.fromkeys(bare_limits, 0j))

    yield with_terms("electrode that ends before the rim", TRANSDUCER, "geometry", "a face of the transducer is bare "
                     "at its rim", states, short, bare_limits)


def _backing(states: Sequence[DeviceState]) -> Iterator[Effect]:
    """What presses on the face away from the stack."""
    impedance = "backing.normal_impedance"
    limits = {impedance: replace(surface_load.ADMISSIBLE["normal_impedance"], lowest=0.0)}

    def backed(state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        # The face away from the stack.
        face = ELECTRODE_GROUND if state.chip.electrodes.live == "top" else ELECTRODE_LIVE
        return (surface_load.SurfaceLoad(face, TRANSDUCER, "backing"),), {
            impedance: 0.0, "backing.tangential_impedance": 0.0}

    yield with_terms("load on the face of the transducer", TRANSDUCER, "loss", "a holder or a backing pushes back",
                     states, backed, limits)


def _driven(states: Sequence[DeviceState], name: str) -> Iterator[Effect]:
    """What a hard drive does to the material called `name`."""
    drives = {s.drive for s in states if s.drive is not None}
    if len(drives) > 1 and all(s.drive is not None for s in states):
        names_ = (f"{name}.softening", f"{name}.drive_loss")
        limits = {n: softening.ADMISSIBLE[ParameterName.parse(n).coefficient] for n in names_}

        def driven(state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
            assert state.drive is not None
            return ((softening.Softening(TRANSDUCER, name),),
                    {names_[0]: 0.0, names_[1]: 0.0, softening.DRIVE_SQUARED: state.drive**2})

        yield with_terms("softening with the drive", TRANSDUCER, "stiffness", "the ceramic is softer and loses more "
                         "when driven harder", states, driven, limits)
