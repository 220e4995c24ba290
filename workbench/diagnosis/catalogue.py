"""The hypotheses: what may be wrong with a device or its model, where, and which numbers that would bring in.

A hypothesis is a set of further parameters, at zero or at their stated value where nothing is missing. Those that no
term of the base model has come with a term that is there from the beginning, with a coefficient of zero; so every
hypothesis is a direction in one and the same model, and its score and its refit need no other.

To add one: a function below, or in `transducer`, that yields it, listed in :data:`SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

from geometry.names import CAVITY, LEVEL, TRANSDUCER, interface, outside, part, role_of
from materials.kinds import Fluid, IsotropicSolid
from workbench.diagnosis.campaign import DeviceState
from workbench.diagnosis.hypothesis import (
    MISTAKEN_DENSITY,
    MISTAKEN_STIFFNESS,
    Device,
    Effect,
    Make,
    around,
    is_liquid,
    new_parameter,
    propose_value,
    rims_of,
    terms_by_state,
    with_terms,
)
from workbench.diagnosis.transducer import transducer
from workbench.files.errors import InputError
from workbench.fitting.parameter import BENCH_ELEMENTS, Parameter, bench_parameter
from workbench.parameter_names import BENCH, LOSS, ParameterName
from workbench.physics import (
    absorption,
    anisotropy,
    bubbles,
    couplant_shear,
    fluid_temperature,
    loss_laws,
    missing_couplant,
    surface_load,
    thin_layer,
)
from workbench.physics.solid import IsotropicSolid as SolidTerm
from workbench.physics.term import Admissible, Term

#: Losses a polymer can have.
POLYMER = "from none to a rubber"

#: Shares of a stated length between which somebody may have mistaken it: layers spread by hand are hardly known.
SPREAD: Mapping[str, tuple[float, float]] = {"couplant": (0.1, 5.0), "bond": (0.2, 3.0)}
MISTAKEN_THICKNESS, MISTAKEN_RADIUS = (0.8, 1.2), (0.95, 1.05)

#: Roles of the parts that are printed, layer on layer.
PRINTED = {"substrate", "sidewall"}

#: The gas where a layer is missing: what it is called there, and in the registry.
GAPS, AIR = "gas in gaps", "air/us_standard_1976"

#: A fluid's law is taken at so many kelvin to either side: the parabola meets it there.
STEP = 5.0


def effects(device: Device) -> tuple[Effect, ...]:
    """All hypotheses that make sense for a device; none that moves what is fixed."""
    found = [effect for source in SOURCES for effect in source(device)]
    return tuple(effect for effect in found if not set(effect.names) & set(device.fixed))


def _touched(state: DeviceState) -> list[str]:
    """The solids that the cavity touches."""
    pairs = (boundary.split("|") for boundary in state.device.section.boundary_names())
    found = [side for pair in pairs if CAVITY in pair for side in pair]
    return [side for side in dict.fromkeys(found) if isinstance(state.materials.get(side), IsotropicSolid)]


def _small_bubbles(region: str, fluid: str, name: str) -> Make:
    """Wood's bubbles in a fluid, none yet."""
    known = {f"{name}.{key}": complex(bubbles.AIR_IN_WATER[key]) for key in ("ambient_pressure", "heat_capacity_ratio")}
    return lambda _state: ((bubbles.WoodBubbles(region, fluid, name),), {f"{name}.void_fraction": 0j, **known})


# --------------------------------------------------------------------------------------------------------------------
# Cavity


def cavity_fluid(device: Device) -> Iterator[Effect]:
    """What a liquid in the cavity may be or hold."""
    if not device.filled:
        return
    fluid = device.filled[0].fluid
    assert fluid is not None
    name = f"{fluid.name}.diffusivity_of_sound"
    loss = Admissible(0.0, 3e-2, "m^2/s", "from a pure liquid (water: 4e-6) to a loss factor of 0.1 at 1 MHz, a "
                      "suspension or a gel")

    def absorbing(_state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        return (absorption.BulkAbsorption(CAVITY, fluid.name),), {name: 0.0}

    known = fluid.diffusivity_of_sound
    terms, values = terms_by_state(device.filled, absorbing) if known is None else ({}, {})
    yield Effect("fluid absorption", CAVITY, "loss", "the liquid absorbs more sound than its viscosities say",
                 (new_parameter(name, loss, 0.0 if known is None else known),), admissible={name: loss}, terms=terms,
                 values=values)

    wood = {"wood.void_fraction": bubbles.ADMISSIBLE["void_fraction"]}

    yield with_terms("small bubbles in the cavity", CAVITY, "stiffness", "gas far below its resonance softens the "
                     "liquid", device.filled, _small_bubbles(CAVITY, fluid.name, "wood"), wood)

    if fluid.shear_viscosity is not None:
        limits = {"bubbles.void_fraction": bubbles.ADMISSIBLE["void_fraction"],
                  "bubbles.radius": bubbles.ADMISSIBLE["radius"]}

        def resonant(_state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
            return ((bubbles.ResonantBubbles(CAVITY, fluid.name, "bubbles"),),
                    {"bubbles.void_fraction": 0.0, "bubbles.radius": 4e-6,
                     **{f"bubbles.{key}": value for key, value in bubbles.AIR_IN_WATER.items()}})

        yield with_terms("resonant bubbles in the cavity", CAVITY, "loss", "bubbles of one size about their resonance",
                         device.filled, resonant, limits, {"bubbles.radius": 4e-6})

    yield from _warmer(device)
    speed = f"{fluid.name}.sound_speed"
    limit = Admissible(0.9, 1.1, "1", "of the stated speed: a tenth of another liquid in it")
    yield from propose_value(device, "fluid sound speed", CAVITY, "stiffness", speed, limit,
                             "the liquid is another than stated", relative=True)


def _warmer(device: Device) -> Iterator[Effect]:
    """A liquid whose temperature is stated wrongly, by as much in all states."""
    terms: dict[str, tuple[Term, ...]] = {}
    values: dict[str, Mapping[str, complex]] = {}
    for state in device.filled:
        fluid = state.fluid
        assert fluid is not None
        slopes = fluid_slopes(fluid, partial(device.load_fluid, fluid.name))
        if slopes is None:
            return
        terms[state.name] = (fluid_temperature.FluidTemperature(CAVITY, fluid.name),)
        values[state.name] = {f"{fluid.name}.temperature_offset": 0j, **{k: complex(v) for k, v in slopes.items()}}
        name = f"{fluid.name}.temperature_offset"
    limits = {name: fluid_temperature.ADMISSIBLE["temperature_offset"]}
    yield Effect("fluid temperature", CAVITY, "stiffness", "the liquid is warmer or colder than stated",
                 tuple(new_parameter(n, a) for n, a in limits.items()), admissible=limits, terms=terms, values=values)


def fluid_slopes(fluid: Fluid, law: Callable[[float], Fluid]) -> dict[str, float] | None:
    """The parameters of `fluid_temperature.FluidTemperature` but the offset, from a `law` of the temperature (K).

    None where it has no law so far to both sides.
    """
    if fluid.temperature is None:
        return None
    try:
        colder, warmer = law(fluid.temperature - STEP), law(fluid.temperature + STEP)
    except InputError:
        return None
    found: dict[str, float] = {}
    for kind, here, below, above in (("density", fluid.density, colder.density, warmer.density),
                                     ("speed", fluid.sound_speed, colder.sound_speed, warmer.sound_speed)):
        found[f"{fluid.name}.{kind}_slope"] = (above - below) / (2.0 * STEP * here)
        found[f"{fluid.name}.{kind}_bend"] = (above + below - 2.0 * here) / (2.0 * STEP**2 * here)
    return found


def soaked(device: Device) -> Iterator[Effect]:
    """Solids that take up the liquid: other constants in the filled states than in the empty ones."""
    dry = [s for s in device.states if s not in device.filled]
    if not device.filled or not dry:
        return
    touched = dict.fromkeys(solid for state in device.filled for solid in _touched(state))
    done: set[str] = set()
    for region in touched:
        material = device.filled[0].materials[region]
        assert isinstance(material, IsotropicSolid)
        if material.name in done or _is_hard(material):
            continue
        done.add(material.name)
        regions = [r for r, m in device.filled[0].materials.items() if m.name == material.name]
        wet = f"{material.name}, wet"
        limits = {
            f"{wet}.shear_modulus": Admissible(-0.2 * material.shear_modulus.real, 0.0, "Pa", "swollen polymers "
                                               "soften: PLA by up to a fifth in water"),
            f"{wet}.shear_modulus{LOSS}": Admissible(-0.1 * material.shear_modulus.real, 0.0, "Pa", POLYMER),
            f"{wet}.density": Admissible(0.0, 0.1 * material.density, "kg/m^3", "from none to a tenth of the volume of "
                                         "a printed part filled"),
        }

        def swollen(
            _state: DeviceState, regions: Sequence[str] = tuple(regions), wet: str = wet
        ) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
            return (tuple(SolidTerm(r, wet) for r in regions),
                    {f"{wet}.bulk_modulus": 0.0, f"{wet}.shear_modulus": 0.0, f"{wet}.density": 0.0})

        yield with_terms(f"liquid taken up by {material.name}", region, "mass", "the solid is heavier and softer once "
                         "the cavity has been filled", device.filled, swollen, limits)


def top(device: Device) -> Iterator[Effect]:
    """What lies on the stack, or holds it from above."""
    for region in dict.fromkeys(state.chip.layers[-1].region for state in device.states):
        if region == TRANSDUCER:
            continue
        states = tuple(state for state in device.states if state.chip.layers[-1].region == region)
        name = f"load on the {region}"
        limits = {f"{name}.normal_impedance": replace(surface_load.ADMISSIBLE["normal_impedance"], lowest=0.0)}

        def loaded(
            _state: DeviceState, region: str = region, name: str = name
        ) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
            return ((surface_load.SurfaceLoad(part(outside(region), LEVEL), region, name),),
                    {f"{name}.normal_impedance": 0.0, f"{name}.tangential_impedance": 0.0})

        yield with_terms(name, region, "loss", "something lies on the chip, or presses on it", states, loaded, limits)


def _is_hard(material: IsotropicSolid) -> bool:
    return abs(material.shear_modulus) > 1e10


# --------------------------------------------------------------------------------------------------------------------
# Layers


def couplant(device: Device) -> Iterator[Effect]:
    """What a gel between transducer and substrate may be."""
    for region, fluid in _fluids(device):
        name = f"{region} bubbles"
        limits = {f"{name}.void_fraction": Admissible(0.0, 0.05, "1", "from none to gel that was stirred")}
        yield from _shearing(device, region, fluid)
        yield from _partial(device, region, fluid)
        yield with_terms(f"bubbles in the {region}", region, "stiffness", "gas in the layer softens it",
                         device.holding(region), _small_bubbles(region, fluid.name, name), limits)


def _shearing(device: Device, region: str, fluid: Fluid) -> Iterator[Effect]:
    """Shear across a fluid layer between two solids, which may be others in another state."""
    states = [state for state in device.holding(region) if all(_neighbours(state, region))]
    if not states:
        return
    root, modulus = f"{fluid.name}.gel_viscosity_root", f"{fluid.name}.gel_shear_modulus"
    limits = {root: couplant_shear.ADMISSIBLE["gel_viscosity_root"]}

    def viscous(state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        below, above = _neighbours(state, region)
        term = couplant_shear.CouplantShear(region, fluid.name, interface(below, region), interface(region, above),
                                            below, above)
        return (term,), {root: 0.0, modulus: 0.0, f"{region}.thickness": state.chip.layer(region).thickness.value}

    yield with_terms(f"shear through the {region}", region, "coupling", "the layer is viscous and carries shear",
                     states, viscous, limits)


def _partial(device: Device, region: str, fluid: Fluid) -> Iterator[Effect]:
    """A layer that does not reach its rim everywhere."""
    states = device.holding(region)
    rings = rims_of(region)
    limits = {f"{ring}.missing_fraction": missing_couplant.ADMISSIBLE["missing_fraction"] for ring in rings}
    air = device.load_fluid(AIR)

    def missing(_state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        return (tuple(missing_couplant.MissingCouplant(region, fluid.name, GAPS, beyond, ring)
                      for ring, beyond in rings.items()),
                {**dict.fromkeys(limits, 0j), f"{GAPS}.density": air.density, f"{GAPS}.sound_speed": air.sound_speed})

    yield with_terms(f"{region} missing at its rim", region, "geometry", "the layer does not reach its rim everywhere",
                     states, missing, limits)


def _fluids(device: Device) -> list[tuple[str, Fluid]]:
    """Layers of the stack that are fluids."""
    found: dict[str, Fluid] = {}
    for state in device.states:
        for region, material in state.materials.items():
            if isinstance(material, Fluid) and region != CAVITY and is_liquid(material):
                found.setdefault(region, material)
    return list(found.items())


def _neighbours(state: DeviceState, region: str) -> tuple[str, str]:
    """The layers below and above one, "" where there is none."""
    order = ["", *(layer.region for layer in state.chip.layers), ""]
    at = order.index(region)
    return order[at - 1], order[at + 1]


def bonds(device: Device) -> Iterator[Effect]:
    """Thin solid layers that hold less than their material does."""
    for region in dict.fromkeys(r for s in device.states for r in s.materials if role_of(r) == "bond"):
        states = device.holding(region)
        material = states[0].materials[region]
        if not isinstance(material, IsotropicSolid):
            continue
        for other, upper in zip(_neighbours(states[0], region), (False, True), strict=True):
            if not other:
                continue
            name = f"{region} at the {other}"
            limits = {f"{name}.{key}": limit for key, limit in thin_layer.ADMISSIBLE.items()}

            def springs(
                state: DeviceState, region: str = region, material: str = material.name, name: str = name,
                upper: bool = upper, limits: Mapping[str, Admissible] = limits
            ) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
                return ((thin_layer.ImperfectBond(region, material, name, upper),),
                        {**dict.fromkeys(limits, 0j), f"{region}.thickness": state.chip.layer(region).thickness.value})

            yield with_terms(f"imperfect {name}", region, "stiffness", "the layer gives way there more than its "
                             "material does", states, springs, limits)


def solids(device: Device) -> Iterator[Effect]:
    """Stiffness, loss and mass of every passive solid that are not as stated."""
    for material, regions in device.materials().values():
        if not isinstance(material, IsotropicSolid):
            continue
        region = regions[0]
        for coefficient in ("bulk_modulus", "shear_modulus"):
            size = getattr(material, coefficient).real
            loss = Admissible(-0.3 * size, 0.0, "Pa", POLYMER)
            yield from propose_value(device, f"{coefficient} loss of {material.name}", region, "loss",
                                     f"{material.name}.{coefficient}{LOSS}", loss, "the solid loses more, or less")
            yield from propose_value(device, f"{coefficient} of {material.name}", region, "stiffness",
                                     f"{material.name}.{coefficient}", around(size, MISTAKEN_STIFFNESS, "Pa"),
                                     "the solid is stiffer or softer than stated")
        yield from propose_value(device, f"density of {material.name}", region, "mass", f"{material.name}.density",
                                 around(material.density, MISTAKEN_DENSITY, "kg/m^3"), "a wrong density")
        if not _is_hard(material):
            yield from _dispersive(device, material, regions)
            if {role_of(region) for region in regions} & PRINTED:
                yield from _printed(device, material, regions)


def _printed(device: Device, material: IsotropicSolid, regions: Sequence[str]) -> Iterator[Effect]:
    """A printed polymer whose layers make it another solid across than along."""
    names = (f"{material.name}.axial_excess", f"{material.name}.shear_excess")
    limits = {name: anisotropy.ADMISSIBLE[ParameterName.parse(name).coefficient] for name in names}

    def across(state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        held = [r for r in regions if r in state.materials and state.materials[r].name == material.name]
        return (tuple(anisotropy.TransverseIsotropy(r, material.name) for r in held),
                {names[0]: 0.0, names[1]: 0.0, f"{material.name}.lateral_excess": 0.0})

    states = [s for s in device.states if any(m.name == material.name for m in s.materials.values())]
    yield with_terms(f"anisotropy of {material.name}", regions[0], "stiffness", "a printed solid is stiffer along its "
                     "layers than across", states, across, limits)


def _dispersive(device: Device, material: IsotropicSolid, regions: Sequence[str]) -> Iterator[Effect]:
    """A loss that grows with frequency, and the dispersion that goes with it."""
    name = material.name
    loss = f"{name}.shear_fractional_loss"
    exponent = f"{name}.loss_exponent"
    limits = {loss: loss_laws.ADMISSIBLE["shear_fractional_loss"], exponent: loss_laws.ADMISSIBLE["loss_exponent"]}
    middle = float(sum(device.states[-1].chip.band) / 2.0)

    def law(state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        held = [r for r in regions if r in state.materials and state.materials[r].name == name]
        return (tuple(loss_laws.FractionalLoss(r, name) for r in held),
                {loss: 0.0, f"{name}.bulk_fractional_loss": 0.0, exponent: 0.3, f"{name}.loss_frequency": middle})

    states = [s for s in device.states if any(m.name == name for m in s.materials.values())]
    yield with_terms(f"fractional loss of {name}", regions[0], "loss", "a loss that changes with frequency, and the "
                     "stiffness that must change with it", states, law, limits, {exponent: 0.3})


def lengths(device: Device) -> Iterator[Effect]:
    """Dimensions that are not as stated."""
    known = {name: dimension for state in device.states for name, dimension in state.chip.dimensions().items()}
    for name, dimension in known.items():
        parsed = ParameterName.parse(name)
        region, what = parsed.owner, parsed.coefficient
        if region.startswith(("ports", "electrode")) or (what != "thickness" and name not in device.known):
            continue
        text = "a wrong thickness" if what == "thickness" else "a wrong radius"
        yield from propose_value(device, f"{what} of the {region}", region, "geometry", name,
                                 mistaken_length(name, dimension.value), text, start=dimension.value)


def mistaken_length(name: str, value: float) -> Admissible:
    """What the dimension ``<region>.<what>`` may be, where a chip's file states `value` (m)."""
    parsed = ParameterName.parse(name)
    low, high = SPREAD.get(role_of(parsed.owner), MISTAKEN_THICKNESS) if parsed.is_thickness else MISTAKEN_RADIUS
    return Admissible(low * value, high * value, "m", f"{low:g} to {high:g} times what is stated: a mistake that goes "
                      "unnoticed")


# --------------------------------------------------------------------------------------------------------------------
# Bench


def bench(device: Device) -> Iterator[Effect]:
    """What stands between the electrodes and the instrument."""
    for element, known in BENCH_ELEMENTS.items():
        name = BENCH + element
        limit = Admissible(known.low, known.high, known.unit, "leads, contacts and probes of a laboratory bench")
        if name in device.known:
            yield Effect(known.text, "bench", "bench", "between the electrodes and the instrument", releases=(name,),
                         admissible={name: limit})
        else:
            found = bench_parameter(name)
            yield Effect(known.text, "bench", "bench", "between the electrodes and the instrument",
                         (Parameter(name, 0.0, found.low, found.high, None, found.unit),), admissible={name: limit})


SOURCES: tuple[Callable[[Device], Iterator[Effect]], ...] = (
    cavity_fluid, soaked, top, couplant, bonds, solids, lengths, transducer, bench)
