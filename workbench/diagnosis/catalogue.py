"""The hypotheses: what may be wrong with a device or its model, where, and which numbers that would bring in.

A hypothesis is a set of further parameters, at zero or at their stated value where nothing is missing. Those that no
term of the base model has come with a term that is there from the beginning, with a coefficient of zero; so every
hypothesis is a direction in one and the same model, and its score and its refit need no other.

To add one: a function below that yields it, listed in :data:`SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from geometry.names import (
    CAVITY,
    ELECTRODE_GROUND,
    ELECTRODE_LIVE,
    LEVEL,
    TRANSDUCER,
    interface,
    outside,
    part,
    role_of,
)
from geometry.section import cut_section
from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric
from materials.registry import Registry
from workbench.diagnosis.campaign import DeviceState, value_of
from workbench.files.errors import InputError
from workbench.fitting.parameter import BENCH_ELEMENTS, UNITS, Parameter, bench_parameter
from workbench.parameter_names import BENCH, LOSS, ParameterName
from workbench.physics import (
    absorption,
    anisotropy,
    bubbles,
    couplant_shear,
    depoled,
    electrode_mass,
    fluid_temperature,
    loss_laws,
    missing_couplant,
    partial_electrode,
    softening,
    surface_load,
    thin_layer,
)
from workbench.physics.solid import IsotropicSolid as SolidTerm
from workbench.physics.term import Admissible, Term

#: Loss factors a data sheet's ceramic can have.
CERAMIC = "from none to a soft ceramic driven hard: data sheets state 0.1 to 2 %"
POLYMER = "from none to a rubber"

#: Shares of a stated length between which somebody may have mistaken it: layers spread by hand are hardly known.
SPREAD: Mapping[str, tuple[float, float]] = {"couplant": (0.1, 5.0), "bond": (0.2, 3.0)}
MISTAKEN_THICKNESS, MISTAKEN_RADIUS = (0.8, 1.2), (0.95, 1.05)

#: Roles of the parts that are printed, layer on layer.
PRINTED = {"substrate", "sidewall"}

#: Rims that may lack something begin at these shares of the radius, one in the other: a sharp edge lies between two.
RIMS = (0.5, 0.7, 0.84, 0.92, 0.96, 0.985, 0.995)

#: The gas where a layer is missing: what it is called there, and in the registry.
GAPS, AIR = "gas in gaps", "air/us_standard_1976"

#: A fluid's law is taken at so many kelvin to either side: the parabola meets it there.
STEP = 5.0

#: How far a real coefficient may lie from what is stated.
MISTAKEN_STIFFNESS, MISTAKEN_DENSITY = 0.3, 0.15


#: Gives a state's terms of a hypothesis, and the values that those need.
Make = Callable[[DeviceState], tuple[tuple[Term, ...], Mapping[str, complex]]]


@dataclass(frozen=True, eq=False)
class Effect:
    """One hypothesis.

    ``region`` is where it sits: a region, ``<region>|<region>`` or "bench"; ``kind`` stiffness, mass, loss, geometry,
    coupling or bench. ``parameters`` are what it brings in; ``lifts`` names known parameters that it lets go further
    than what is known of them. ``admissible`` bounds its parameters, with the source. ``terms`` and ``values`` are by
    the name of the state.
    """

    name: str
    region: str
    kind: str
    about: str
    parameters: tuple[Parameter, ...] = ()
    lifts: tuple[str, ...] = ()
    admissible: Mapping[str, Admissible] = field(default_factory=dict)
    terms: Mapping[str, tuple[Term, ...]] = field(default_factory=dict)
    values: Mapping[str, Mapping[str, complex]] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters that it moves."""
        return (*(p.name for p in self.parameters), *self.lifts)


@dataclass(frozen=True, eq=False)
class Device:
    """What the functions below look at: the states of a device, what is known of it, and the materials there are."""

    states: tuple[DeviceState, ...]
    known: Mapping[str, float]
    fixed: tuple[str, ...]
    registry: Registry

    def load_fluid(self, name: str, temperature: float | None = None) -> Fluid:
        """A fluid of the registry; see `materials.registry.Registry.load`."""
        found = self.registry.load(name, temperature=temperature)
        assert isinstance(found, Fluid)
        return found

    def holding(self, region: str) -> tuple[DeviceState, ...]:
        return tuple(state for state in self.states if region in state.materials)

    @property
    def filled(self) -> tuple[DeviceState, ...]:
        """States whose cavity holds a liquid."""
        return tuple(s for s in self.states if s.fluid is not None and _is_liquid(s.fluid))

    def materials(self) -> dict[str, tuple[Material, tuple[str, ...]]]:
        """Every material by name, and the regions it fills in some state."""
        found: dict[str, tuple[Material, tuple[str, ...]]] = {}
        for state in self.states:
            for region, material in state.materials.items():
                _, regions = found.get(material.name, (material, ()))
                found[material.name] = (material, tuple(dict.fromkeys((*regions, region))))
        return found


def _is_liquid(material: Material) -> bool:
    return isinstance(material, Fluid) and material.density > 100.0


def _touched(state: DeviceState) -> list[str]:
    """The solids that the cavity touches."""
    pairs = (boundary.split("|") for boundary in cut_section(state.chip).boundary_names())
    found = [side for pair in pairs if CAVITY in pair for side in pair]
    return [side for side in dict.fromkeys(found) if isinstance(state.materials.get(side), IsotropicSolid)]


def effects(device: Device) -> tuple[Effect, ...]:
    """All hypotheses that make sense for a device; none that moves what is fixed."""
    found = [effect for source in SOURCES for effect in source(device)]
    return tuple(effect for effect in found if not set(effect.names) & set(device.fixed))


def _of(name: str, admissible: Admissible, start: float = 0.0) -> Parameter:
    return Parameter(name, start, admissible.lowest, admissible.highest, None, admissible.unit)


def _added(
    states: Iterable[DeviceState], make: Make
) -> tuple[dict[str, tuple[Term, ...]], dict[str, Mapping[str, complex]]]:
    terms, values = {}, {}
    for state in states:
        terms[state.name], values[state.name] = make(state)
    return terms, values


def _bringing(
    label: str, region: str, kind: str, about: str, states: Iterable[DeviceState], make: Make,
    limits: Mapping[str, Admissible], starts: Mapping[str, float] | None = None,
) -> Effect:
    """The hypothesis that brings terms of its own into `states`, its parameters at nothing or where they start."""
    terms, values = _added(states, make)
    parameters = tuple(_of(name, limit, (starts or {}).get(name, 0.0)) for name, limit in limits.items())
    return Effect(label, region, kind, about, parameters, admissible=limits, terms=terms, values=values)


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
    terms, values = _added(device.filled, absorbing) if known is None else ({}, {})
    yield Effect("fluid absorption", CAVITY, "loss", "the liquid absorbs more sound than its viscosities say",
                 (_of(name, loss, 0.0 if known is None else known),), admissible={name: loss}, terms=terms,
                 values=values)

    wood = {"wood.void_fraction": bubbles.ADMISSIBLE["void_fraction"]}

    yield _bringing("small bubbles in the cavity", CAVITY, "stiffness", "gas far below its resonance softens the "
                    "liquid", device.filled, _small_bubbles(CAVITY, fluid.name, "wood"), wood)

    if fluid.shear_viscosity is not None:
        limits = {"bubbles.void_fraction": bubbles.ADMISSIBLE["void_fraction"],
                  "bubbles.radius": bubbles.ADMISSIBLE["radius"]}

        def resonant(_state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
            return ((bubbles.ResonantBubbles(CAVITY, fluid.name, "bubbles"),),
                    {"bubbles.void_fraction": 0.0, "bubbles.radius": 4e-6,
                     **{f"bubbles.{key}": value for key, value in bubbles.AIR_IN_WATER.items()}})

        yield _bringing("resonant bubbles in the cavity", CAVITY, "loss", "bubbles of one size about their resonance",
                        device.filled, resonant, limits, {"bubbles.radius": 4e-6})

    yield from _warmer(device)
    speed = f"{fluid.name}.sound_speed"
    limit = Admissible(0.9, 1.1, "1", "of the stated speed: a tenth of another liquid in it")
    yield from _mistaken(device, "fluid sound speed", CAVITY, "stiffness", speed, limit,
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
                 tuple(_of(n, a) for n, a in limits.items()), admissible=limits, terms=terms, values=values)


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

        yield _bringing(f"liquid taken up by {material.name}", region, "mass", "the solid is heavier and softer once "
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

        yield _bringing(name, region, "loss", "something lies on the chip, or presses on it", states, loaded, limits)


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
        yield _bringing(f"bubbles in the {region}", region, "stiffness", "gas in the layer softens it",
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

    yield _bringing(f"shear through the {region}", region, "coupling", "the layer is viscous and carries shear",
                    states, viscous, limits)


def _partial(device: Device, region: str, fluid: Fluid) -> Iterator[Effect]:
    """A layer that does not reach its rim everywhere."""
    states = device.holding(region)
    rings = _rims(region)
    limits = {f"{ring}.missing_fraction": missing_couplant.ADMISSIBLE["missing_fraction"] for ring in rings}
    air = device.load_fluid(AIR)

    def missing(_state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        return (tuple(missing_couplant.MissingCouplant(region, fluid.name, GAPS, beyond, ring)
                      for ring, beyond in rings.items()),
                {**dict.fromkeys(limits, 0j), f"{GAPS}.density": air.density, f"{GAPS}.sound_speed": air.sound_speed})

    yield _bringing(f"{region} missing at its rim", region, "geometry", "the layer does not reach its rim everywhere",
                    states, missing, limits)


def _rims(region: str) -> dict[str, float]:
    """Rims of a layer and where they begin, as shares of its radius."""
    return {f"{region} beyond {100 * share:g} %": share for share in RIMS}


def _fluids(device: Device) -> list[tuple[str, Fluid]]:
    """Layers of the stack that are fluids."""
    found: dict[str, Fluid] = {}
    for state in device.states:
        for region, material in state.materials.items():
            if isinstance(material, Fluid) and region != CAVITY and _is_liquid(material):
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

            yield _bringing(f"imperfect {name}", region, "stiffness", "the layer gives way there more than its "
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
            yield from _mistaken(device, f"{coefficient} loss of {material.name}", region, "loss",
                                 f"{material.name}.{coefficient}{LOSS}", loss, "the solid loses more, or less")
            yield from _mistaken(device, f"{coefficient} of {material.name}", region, "stiffness",
                                 f"{material.name}.{coefficient}", _about(size, MISTAKEN_STIFFNESS, "Pa"),
                                 "the solid is stiffer or softer than stated")
        yield from _mistaken(device, f"density of {material.name}", region, "mass", f"{material.name}.density",
                             _about(material.density, MISTAKEN_DENSITY, "kg/m^3"), "a wrong density")
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
    yield _bringing(f"anisotropy of {material.name}", regions[0], "stiffness", "a printed solid is stiffer along its "
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
    yield _bringing(f"fractional loss of {name}", regions[0], "loss", "a loss that changes with frequency, and the "
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
        yield from _mistaken(device, f"{what} of the {region}", region, "geometry", name,
                             mistaken_length(name, dimension.value), text, start=dimension.value)


def mistaken_length(name: str, value: float) -> Admissible:
    """What the dimension ``<region>.<what>`` may be, where a chip's file states `value` (m)."""
    parsed = ParameterName.parse(name)
    low, high = SPREAD.get(role_of(parsed.owner), MISTAKEN_THICKNESS) if parsed.is_thickness else MISTAKEN_RADIUS
    return Admissible(low * value, high * value, "m", f"{low:g} to {high:g} times what is stated: a mistake that goes "
                      "unnoticed")


# --------------------------------------------------------------------------------------------------------------------
# Transducer


def transducer(device: Device) -> Iterator[Effect]:
    """What a ceramic disc may be, beyond its constants."""
    states = device.holding(TRANSDUCER)
    material = states[0].materials[TRANSDUCER]
    assert isinstance(material, Piezoelectric)
    name = material.name

    def loss(coefficient: str, share: float, sign: float) -> Admissible:
        size = abs(complex(getattr(material, coefficient)).real)
        low, high = sorted((0.0, sign * share * size)) if sign else (-share * size, share * size)
        return Admissible(low, high, UNITS[coefficient], CERAMIC)

    yield from _mistaken(device, "dielectric loss", TRANSDUCER, "loss", f"{name}.eps33{LOSS}", loss("eps33", 0.05, 1.0),
                         "the permittivity has a loss")
    e33, eps33 = f"{name}.e33{LOSS}", f"{name}.eps33{LOSS}"
    limits = {e33: loss("e33", 0.05, 0.0), eps33: loss("eps33", 0.05, 1.0)}
    new = tuple(_of(n, a, value_of(n, device.states)) for n, a in limits.items() if n not in device.known)
    yield Effect("complex piezoelectric constant", TRANSDUCER, "loss", "e33 has a phase of its own", new,
                 lifts=tuple(n for n in limits if n in device.known), admissible=limits)
    for coefficient in ("c11", "c33", "c44"):
        yield from _mistaken(device, f"loss of {coefficient} of the transducer", TRANSDUCER, "loss",
                             f"{name}.{coefficient}{LOSS}", loss(coefficient, 0.05, -1.0), "a further stiffness loss")
        size = complex(getattr(material, coefficient)).real
        yield from _mistaken(device, f"{coefficient} of the transducer", TRANSDUCER, "stiffness",
                             f"{name}.{coefficient}", _about(size, MISTAKEN_STIFFNESS, "Pa"), "a wrong stiffness")
    yield from _mistaken(device, "density of the transducer", TRANSDUCER, "mass", f"{name}.density",
                         _about(material.density, MISTAKEN_DENSITY, "kg/m^3"), "a wrong density")

    metal_limits = {f"electrodes.{key}": limit for key, limit in electrode_mass.ADMISSIBLE.items()}
    # Grains of silver between those that hold together and those that do not.
    metal_starts = dict(zip(metal_limits, (0.0, 0.4 * electrode_mass.SILVER_STIFFNESS), strict=True))

    def metal(_state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        return (electrode_mass.ElectrodeMass("electrode_live", "electrode_ground", TRANSDUCER),), metal_starts

    terms, values = _added(states, metal)
    yield Effect("electrode mass", TRANSDUCER, "mass", "the metal on the faces has a mass, and a stiffness of its own",
                 tuple(Parameter(n, metal_starts[n], 0.0, limit.highest, None, limit.unit)
                       for n, limit in metal_limits.items()),
                 admissible=metal_limits, terms=terms, values=values)

    rims = _rims(TRANSDUCER)
    depoled_limits = {f"{rim}.depoled_fraction": depoled.ADMISSIBLE["depoled_fraction"] for rim in rims}

    def unpoled(_state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        return (tuple(depoled.DepoledRim(TRANSDUCER, name, beyond, rim) for rim, beyond in rims.items()),
                {**dict.fromkeys(depoled_limits, 0j), **{f"{rim}.permittivity_excess": 0j for rim in rims}})

    yield _bringing("rim of the transducer without piezoelectricity", TRANSDUCER, "coupling", "a rim that is not poled",
                    states, unpoled, depoled_limits)

    bare_limits = {f"{rim}.bare_fraction": partial_electrode.ADMISSIBLE["bare_fraction"] for rim in rims}

    def short(state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        return ((partial_electrode.PartialElectrode(TRANSDUCER, name, tuple(rims.values()), tuple(rims),
                                                    upper=state.chip.electrodes.live == "top"),),
                dict.fromkeys(bare_limits, 0j))

    yield _bringing("electrode that ends before the rim", TRANSDUCER, "geometry", "a face of the transducer is bare "
                    "at its rim", states, short, bare_limits)

    impedance = "backing.normal_impedance"
    limits = {impedance: replace(surface_load.ADMISSIBLE["normal_impedance"], lowest=0.0)}

    def backed(state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
        # The face away from the stack.
        face = ELECTRODE_GROUND if state.chip.electrodes.live == "top" else ELECTRODE_LIVE
        return (surface_load.SurfaceLoad(face, TRANSDUCER, "backing"),), {
            impedance: 0.0, "backing.tangential_impedance": 0.0}

    yield _bringing("load on the face of the transducer", TRANSDUCER, "loss", "a holder or a backing pushes back",
                    states, backed, limits)

    drives = {s.drive for s in states if s.drive is not None}
    if len(drives) > 1 and all(s.drive is not None for s in states):
        names_ = (f"{name}.softening", f"{name}.drive_loss")
        limits = {n: softening.ADMISSIBLE[ParameterName.parse(n).coefficient] for n in names_}

        def driven(state: DeviceState) -> tuple[tuple[Term, ...], Mapping[str, complex]]:
            assert state.drive is not None
            return ((softening.Softening(TRANSDUCER, name),),
                    {names_[0]: 0.0, names_[1]: 0.0, softening.DRIVE_SQUARED: state.drive**2})

        yield _bringing("softening with the drive", TRANSDUCER, "stiffness", "the ceramic is softer and loses more "
                        "when driven harder", states, driven, limits)


# --------------------------------------------------------------------------------------------------------------------
# Bench


def bench(device: Device) -> Iterator[Effect]:
    """What stands between the electrodes and the instrument."""
    for element, known in BENCH_ELEMENTS.items():
        name = BENCH + element
        limit = Admissible(known.low, known.high, known.unit, "leads, contacts and probes of a laboratory bench")
        if name in device.known:
            yield Effect(known.text, "bench", "bench", "between the electrodes and the instrument", lifts=(name,),
                         admissible={name: limit})
        else:
            found = bench_parameter(name)
            yield Effect(known.text, "bench", "bench", "between the electrodes and the instrument",
                         (Parameter(name, 0.0, found.low, found.high, None, found.unit),), admissible={name: limit})


# --------------------------------------------------------------------------------------------------------------------


def _about(value: float, share: float, unit: str) -> Admissible:
    return Admissible((1.0 - share) * value, (1.0 + share) * value, unit,
                      f"within {100 * share:g} % of what is stated: a mistake that goes unnoticed")


def _mistaken(
    device: Device, label: str, region: str, kind: str, name: str, limit: Admissible, about: str, *,
    relative: bool = False, start: float | None = None,
) -> Iterator[Effect]:
    """The hypothesis that a parameter the model has already is not what is known of it."""
    if name in device.known:
        yield Effect(label, region, kind, about, lifts=(name,), admissible={name: limit})
        return
    if relative:
        parameter = Parameter(name, 1.0, limit.lowest, limit.highest, None, "1", relative=True)
    else:
        value = value_of(name, device.states) if start is None else start
        parameter = Parameter(name, float(min(max(value, limit.lowest), limit.highest)), limit.lowest, limit.highest,
                              None, limit.unit)
    yield Effect(label, region, kind, about, (parameter,), admissible={name: limit})


SOURCES: tuple[Callable[[Device], Iterator[Effect]], ...] = (
    cavity_fluid, soaked, top, couplant, bonds, solids, lengths, transducer, bench)
