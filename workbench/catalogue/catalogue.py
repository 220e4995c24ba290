"""Hypotheses about a device or its model: errors and further effects.

A hypothesis is a set of further parameters, whose neutral values are zero or the stated value. A parameter that no term
of the base model has comes with its own term, whose coefficient is zero at first. So every hypothesis is a direction in
one model, and its score and its refit use that model. A term declares its parameters and their ranges
(`workbench.physics.term.Term.free`).

To add a hypothesis, write a function that yields it, here or in `transducer`, and list it in :data:`SOURCES`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

from geometry.assumed import PRINTED
from geometry.chip import Chip
from geometry.dimension import ACROSS, SHAPES
from geometry.measure import Straight
from geometry.names import CAVITY, LEVEL, TRANSDUCER, interface, outside, part_name, role_of
from geometry.shapes import possible
from materials.kinds import Fluid, IsotropicSolid
from workbench.campaign.campaign import DeviceState
from workbench.catalogue.effect import (
    MISTAKEN_DENSITY,
    MISTAKEN_STIFFNESS,
    Device,
    Effect,
    filled_with,
    is_liquid,
    is_polymer,
    mistaken,
    neighbours,
    other_than_stated,
    with_terms,
)
from workbench.catalogue.handling import filling, gripped, made_of
from workbench.catalogue.transducer import transducer
from workbench.model.fluid_slopes import fluid_slopes
from workbench.model.numbers import BENCH, BENCH_ELEMENTS, LOSS, ParameterName
from workbench.physics import (
    absorption,
    anisotropy,
    bubbles,
    couplant_shear,
    fluid_temperature,
    loss_laws,
    missing_fluid,
    open_bond,
    port_necks,
    surface_load,
    thin_layer,
)
from workbench.physics.annulus import LARGEST_WIDTH, WIDTHS, Annulus
from workbench.physics.solid import ElasticSolid as SolidTerm
from workbench.physics.term import Admissible, FreeParameter

#: Range of a polymer's loss, in words.
POLYMER = "from none to a rubber"

#: Range of a true thickness, relative to the stated one. Layers spread by hand are hardly known.
SPREAD: Mapping[str, tuple[float, float]] = {"couplant": (0.1, 5.0), "bond": (0.2, 3.0)}
MISTAKEN_THICKNESS, MISTAKEN_RADIUS = (0.8, 1.2), (0.95, 1.05)

#: Unintended shapes of layers by role, in words.
SHAPED: Mapping[tuple[str, str], str] = {
    ("sidewall", "draft"): "the hole of the printed wall grows wider or narrower upwards",
    ("sidewall", "barrel"): "the outer side of the printed wall bulges, or is hollow",
    ("superstrate", "bow"): "the lid is bent: higher on its axis than at its edge, or lower",
    (TRANSDUCER, "dome"): "the disc is not plane-parallel: thicker on its axis than at its edge, or thinner",
}

#: Largest error of a stated shape to either side (m or rad), and its reason.
SHAPE_LIMITS: Mapping[str, tuple[float, str]] = {
    "draft": (math.radians(5.0), "a hole printed layer on layer: a tenth of a line of 0.4 mm wider at its top than "
              "at the first layer, which is pressed out, is 3 degrees of a wall of 0.7 mm"),
    "barrel": (1e-4, "a printed side: within a quarter of a line of 0.4 mm of where it is meant to be"),
    "bow": (2e-5, "a lid of glass or polymer bent by glue that shrinks: no more than 0.4 of the layer of glue"),
    "dome": (1e-5, "lapped discs are sold as plane-parallel to 10 um, and no more than 0.4 of the gel on them"),
}

#: Largest depth of a bend, relative to the thinnest layer beside the bent face. With 0.5 that layer could vanish if
#: its thickness is wrong too.
TAKEN_UP = 0.4

#: Names of the gas in the gaps of a layer: in the model, and in the registry.
GAPS, AIR = "gas in gaps", "air/us_standard_1976"

#: Widths of the annulus without liquid at the wall of a cavity, relative to the cavity's radius. A chip with a wider
#: one would not be used.
NOT_FULL = (0.04, 0.1, 0.18, 0.28)

#: Reason why a straight chip lacks a hypothesis.
NO_AXIS = "which is made for chips that turn about an axis"

#: Largest open width of a joint, relative to the joint's width.
LARGEST_OPENING = 0.9


def effects(device: Device) -> tuple[Effect, ...]:
    """All hypotheses about a device, except those that move a fixed parameter."""
    return effects_and_others(device)[0]


def effects_and_others(device: Device) -> tuple[tuple[Effect, ...], tuple[str, ...]]:
    """The hypotheses about a device, and the reasons for those left out. A hypothesis is left out if it needs a layer
    without a profile, needs an axis, or cannot be built."""
    usable, others = list[Effect](), list[str]()
    for effect in (effect for source in SOURCES for effect in _made(source, device, others)):
        profiled = _profiled(device, effect)
        if set(effect.names) & set(device.fixed):
            continue
        if _needs_axis(device, effect):
            others.append(f"{effect.name}, {NO_AXIS}")
        elif profiled:
            others.append(f"{effect.name}, because it acts on a part of the {profiled}, whose outline is a profile")
        else:
            usable.append(effect)
    return tuple(usable), tuple(others)


def _made(source: Callable[[Device], Iterator[Effect]], device: Device, others: list[str]) -> Iterator[Effect]:
    """The hypotheses of one source; `others` gets the reason for a failure."""
    try:
        yield from source(device)
    except ValueError as error:
        others.append(f"further hypotheses about {source.__name__.replace('_', ' ')}, because {error}")


def _needs_axis(device: Device, effect: Effect) -> bool:
    """Whether an effect needs an axis that a state lacks."""
    return any(term.needs_axis for state in _straight(device) for term in effect.terms.get(state.name, ()))


def _straight(device: Device) -> list[DeviceState]:
    return [state for state in device.states if isinstance(state.chip.measure, Straight)]


def _profiled(device: Device, effect: Effect) -> str:
    """The layer with a profile that rules out an effect, or ""."""
    for state in device.states:
        profiled = {layer.region for layer in state.chip.layers if layer.profile is not None}
        profiled |= {CAVITY} if profiled else set()  # the profiled layers enclose it
        for integral in (each for term in effect.terms.get(state.name, ()) for each in term.integrals()):
            across = set(integral.place.split("|")) & set(integral.opposite.split("|"))
            own = {*integral.place.split("|")} if integral.radius_fraction or integral.skin else across
            for region in own & profiled:
                return region
    return ""


# --------------------------------------------------------------------------------------------------------------------
# Cavity


def cavity_fluid(device: Device) -> Iterator[Effect]:
    """Other properties of the cavity's liquid, and gas in it."""
    states = device.filled
    fluid = states[0].fluid if states else None
    if fluid is None:
        return
    absorbing, known = absorption.BulkAbsorption(CAVITY, fluid.name), fluid.diffusivity_of_sound
    # A liquid with stated viscosities absorbs in the base model.
    yield with_terms("fluid absorption", CAVITY, "loss", "the liquid absorbs more sound than its viscosities say",
                     states if known is None else (), lambda _: [absorbing],
                     free=tuple(replace(each, neutral=known or 0.0) for each in absorbing.free()))
    yield with_terms("small bubbles in the cavity", CAVITY, "stiffness", "gas far below its resonance softens the "
                     "liquid", states, lambda _: [bubbles.WoodBubbles(CAVITY, fluid.name, "wood")])
    if fluid.shear_viscosity is not None:
        yield with_terms("resonant bubbles in the cavity", CAVITY, "loss", "bubbles of one size about their resonance",
                         states, lambda _: [bubbles.ResonantBubbles(CAVITY, fluid.name, "bubbles")])
    slopes = {state.name: found for state in states if state.fluid is not None
              and (found := fluid_slopes(state.fluid, partial(device.load_fluid, state.fluid.name))) is not None}
    if len(slopes) == len(states):
        yield with_terms("fluid temperature", CAVITY, "stiffness", "the liquid is warmer or colder than stated", states,
                         lambda state: [fluid_temperature.FluidTemperature(CAVITY, state.materials[CAVITY].name)],
                         lambda state: slopes[state.name])
    yield other_than_stated(device, "fluid sound speed", CAVITY, "stiffness", "the liquid is another than stated", {
        f"{fluid.name}.sound_speed": Admissible(0.9, 1.1, "1", "of the stated speed: a tenth of another liquid in it")},
        relative=True)


def meniscus(device: Device) -> Iterator[Effect]:
    """Gas at the side wall of the cavity, where the ports are."""
    states = device.filled
    if states and states[0].fluid is not None:
        yield _missing(device, "cavity not full", "the liquid does not reach the wall that the ports are in", states,
                       CAVITY, states[0].fluid, Annulus("cavity rim", limit=NOT_FULL[-1], widths=NOT_FULL[:-1]))


def _missing(
    device: Device, name: str, about: str, states: Sequence[DeviceState], region: str, fluid: Fluid, rim: Annulus
) -> Effect:
    """Gas in an annulus at the edge of a fluid's region."""
    air = device.load_fluid(AIR)
    return with_terms(name, region, "geometry", about, states,
                      lambda _: [missing_fluid.MissingFluid(region, fluid.name, GAPS, rim)],
                      lambda _: {f"{GAPS}.density": air.density, f"{GAPS}.sound_speed": air.sound_speed})


def ports(device: Device) -> Iterator[Effect]:
    """Openings in the side wall of a cavity with a liquid."""
    def necks(state: DeviceState) -> list[port_necks.PortNecks]:
        return [port_necks.PortNecks(interface(CAVITY, region), region, CAVITY, state.materials[CAVITY].name,
                                     "port necks") for region in _touched(state) if role_of(region) == "sidewall"]

    found = with_terms("port necks", CAVITY, "coupling", "ports open the side wall: their liquid swings with the "
                       "cavity's pressure", device.filled, necks)
    if found.terms:
        yield found


def _touched(state: DeviceState) -> list[str]:
    """Solids in contact with the cavity."""
    pairs = (boundary.split("|") for boundary in state.device.section.boundary_names())
    found = [side for pair in pairs if CAVITY in pair for side in pair]
    return [side for side in dict.fromkeys(found) if isinstance(state.materials.get(side), IsotropicSolid)]


def soaked(device: Device) -> Iterator[Effect]:
    """Solids whose constants change as they absorb the cavity's liquid."""
    if not device.filled or len(device.filled) == len(device.states):
        return
    done: set[str] = set()
    for region in dict.fromkeys(solid for state in device.filled for solid in _touched(state)):
        material = device.filled[0].materials[region]
        if isinstance(material, IsotropicSolid) and is_polymer(material) and material.name not in done:
            done.add(material.name)
            yield _swollen(device, material, region)


def _swollen(device: Device, material: IsotropicSolid, region: str) -> Effect:
    wet, shear = f"{material.name}, wet", material.shear_modulus.real
    regions = filled_with(device.filled[0], material.name)
    free = (
        FreeParameter(f"{wet}.shear_modulus", 0.0, Admissible(
            -0.2 * shear, 0.0, "Pa", "swollen polymers soften: PLA by up to a fifth in water")),
        FreeParameter(f"{wet}.shear_modulus{LOSS}", 0.0, Admissible(-0.1 * shear, 0.0, "Pa", POLYMER)),
        FreeParameter(f"{wet}.density", 0.0, Admissible(
            0.0, 0.1 * material.density, "kg/m^3", "from none to a tenth of the volume of a printed part filled")),
    )
    return with_terms(f"liquid taken up by {material.name}", region, "mass", "the solid is heavier and softer once the "
                      "cavity has been filled", device.filled, lambda _: [SolidTerm(r, wet) for r in regions],
                      lambda _: {f"{wet}.bulk_modulus": 0.0}, free=free)


def top(device: Device) -> Iterator[Effect]:
    """A load or a contact on top of the stack."""
    for region in dict.fromkeys(_highest(state) for state in device.states):
        if region != TRANSDUCER:
            yield _loaded(device, region)


def _loaded(device: Device, region: str) -> Effect:
    load = surface_load.SurfaceLoad(part_name(outside(region), LEVEL), region, f"load on the {region}")
    return with_terms(load.name, region, "loss", "something lies on the chip, or presses on it", device.states,
                      lambda state: [load] if _highest(state) == region else [])


def _highest(state: DeviceState) -> str:
    return state.chip.layers[-1].region


# --------------------------------------------------------------------------------------------------------------------
# Layers


def couplant(device: Device) -> Iterator[Effect]:
    """Other properties of a gel between transducer and substrate."""
    found: dict[str, Fluid] = {}
    for state in device.states:
        for region, material in state.materials.items():
            if isinstance(material, Fluid) and is_liquid(material) and region != CAVITY:
                found.setdefault(region, material)
    for region, fluid in found.items():
        yield from _gel(device, region, fluid)


def _gel(device: Device, region: str, fluid: Fluid) -> Iterator[Effect]:
    def shearing(state: DeviceState) -> list[couplant_shear.CouplantShear]:
        # The two solids may differ between states.
        below, above = neighbours(state, region)
        return [couplant_shear.CouplantShear(region, fluid.name, interface(below, region), interface(region, above),
                                             below, above)] if below and above else []

    states = device.holding(region)
    viscous = with_terms(f"shear through the {region}", region, "coupling", "the layer is viscous and carries shear",
                         states, shearing)
    if viscous.terms:
        yield viscous
    yield _missing(device, f"{region} missing at its rim", "the layer does not reach its edge everywhere", states,
                   region, fluid, Annulus(f"{region} rim"))
    mixed = bubbles.WoodBubbles(region, fluid.name, f"{region} bubbles")
    stirred = Admissible(0.0, 0.05, "1", "from none to gel that was stirred")
    yield with_terms(f"bubbles in the {region}", region, "stiffness", "gas in the layer softens it", states,
                     lambda _: [mixed], free=tuple(replace(each, admissible=stirred) for each in mixed.free()))


def bonds(device: Device) -> Iterator[Effect]:
    """Thin solid layers that are more compliant than their material."""
    for region in dict.fromkeys(r for s in device.states for r in s.materials if role_of(r) == "bond"):
        material = device.holding(region)[0].materials[region]
        if isinstance(material, IsotropicSolid):
            for upper in (False, True):
                yield from _springs(device, region, material.name, upper=upper)


def _springs(device: Device, region: str, material: str, *, upper: bool) -> Iterator[Effect]:
    states = device.holding(region)
    other = neighbours(states[0], region)[upper]
    name = f"{region} at the {other}"
    if other:
        yield with_terms(f"imperfect {name}", region, "stiffness", "the layer gives way there more than its material "
                         "does", states, lambda _: [thin_layer.ImperfectBond(region, material, name, upper)])


def joints(device: Device) -> Iterator[Effect]:
    """Superstrates that are joined to the layer below only in part."""
    for region in dict.fromkeys(r for s in device.states for r in s.materials if role_of(r) == "superstrate"):
        state = device.holding(region)[0]
        below, _ = neighbours(state, region)
        if all(isinstance(state.materials.get(each), IsotropicSolid) for each in (below, region)):
            yield from _open(device, region, below)


def _open(device: Device, region: str, below: str) -> Iterator[Effect]:
    states = device.holding(region)
    # Without a bond, the joint is the lower face of the superstrate.
    joint = below if role_of(below) == "bond" else region
    material = states[0].materials[joint].name
    lower, own = states[0].chip.layer(below), states[0].chip.layer(joint).radius.value
    # Inner and outer radius of the joint, relative to the radius of its layer.
    hole = 0.0 if lower.cavity_radius is None else lower.cavity_radius.value / own
    edge = min(lower.radius.value / own, 1.0)
    skin = 0.0 if joint == below else -open_bond.SKIN

    def widest(widths: Sequence[float]) -> float:
        """The largest of some widths within the limit; without one, the limit."""
        most = LARGEST_OPENING * (edge - hole)
        return max((width for width in widths if width <= most), default=most)

    outside = Annulus(f"{joint} open at its rim", edge, widest((*WIDTHS, LARGEST_WIDTH)))
    yield with_terms(f"{region} bonded on a part of its radius", joint, "geometry", "it is loose at its edge", states,
                     lambda _: [open_bond.OpenBond(joint, material, outside, skin)])
    if hole:
        widths = outside.widths_from(hole)
        inside = Annulus(f"{joint} open around the cavity", hole, widest(widths), True, widths)
        yield with_terms(f"{region} loose around the cavity", joint, "geometry", "it is loose where the cavity begins",
                         states, lambda _: [open_bond.OpenBond(joint, material, inside, skin)])


def solid_hypotheses(device: Device) -> Iterator[Effect]:
    """Wrong stiffness, loss or density of a passive solid."""
    for material, regions in device.materials().values():
        if not isinstance(material, IsotropicSolid):
            continue
        name, region = material.name, regions[0]
        for coefficient in ("bulk_modulus", "shear_modulus"):
            size = getattr(material, coefficient).real
            loss = Admissible(-0.3 * size, 0.0, ParameterName.parse(f"{name}.{coefficient}").unit, POLYMER)
            yield other_than_stated(device, f"{coefficient} loss of {name}", region, "loss", "the solid loses more, or "
                                    "less", {f"{name}.{coefficient}{LOSS}": loss})
            yield other_than_stated(device, f"{coefficient} of {name}", region, "stiffness", "the solid is stiffer or "
                                    "softer than stated",
                                    mistaken(f"{name}.{coefficient}", size, MISTAKEN_STIFFNESS))
        yield other_than_stated(device, f"density of {name}", region, "mass", "a wrong density",
                                mistaken(f"{name}.density", material.density, MISTAKEN_DENSITY))
        if is_polymer(material):
            yield from _polymer(device, name, regions)


def _polymer(device: Device, name: str, regions: Sequence[str]) -> Iterator[Effect]:
    """A loss that depends on frequency, and the anisotropy of prints."""
    middle = float(sum(device.states[-1].chip.band) / 2.0)
    yield with_terms(f"fractional loss of {name}", regions[0], "loss", "a loss that changes with frequency, and the "
                     "stiffness that must change with it", device.states,
                     lambda state: [loss_laws.FractionalLoss(r, name) for r in filled_with(state, name)],
                     lambda _: {f"{name}.loss_frequency": middle})
    if {role_of(region) for region in regions} & set(PRINTED):
        yield with_terms(f"anisotropy of {name}", regions[0], "stiffness", "a printed solid is stiffer along its "
                         "layers than across", device.states,
                         lambda state: [anisotropy.TransverseIsotropy(r, name) for r in filled_with(state, name)])


def shapes(device: Device) -> Iterator[Effect]:
    """Layers with other shapes than stated."""
    chips = {layer.region: state.chip for state in device.states for layer in state.chip.layers}
    materials = {region: material for state in device.states for region, material in state.materials.items()}
    for region, chip in chips.items():
        role = role_of(region)
        for shape in SHAPES:
            name, about = f"{region}.{shape}", SHAPED.get((role, shape), "")
            made_so = name in possible(chip) and (role not in PRINTED or is_polymer(materials.get(region)))
            if name in device.known or (about and made_so):
                yield other_than_stated(device, f"{shape} of the {region}", region, "geometry",
                                        about or "another shape than stated", {name: mistaken_shape(chip, name)})


def mistaken_shape(chip: Chip, name: str) -> Admissible:
    """The range of the shape ``<region>.<shape>`` about its stated value."""
    region, _, shape = name.rpartition(".")
    most, source = SHAPE_LIMITS[shape]
    layers = [layer.region for layer in chip.layers]
    at = layers.index(region)
    # The layers beside a bent face fill the bend.
    beside = {"bow": (at - 1, at + 1), "dome": (at + 1,)}.get(shape, ())
    thinnest = min((chip.layers[k].thickness.value for k in beside if 0 <= k < len(layers)), default=math.inf)
    most = min(most, TAKEN_UP * thinnest)
    stated = chip.layer(region).shapes.get(shape)
    value = 0.0 if stated is None else stated.value
    return Admissible(value - most, value + most, ParameterName.parse(name).unit, source)


def lengths(device: Device) -> Iterator[Effect]:
    """Dimensions that differ from the stated ones."""
    known = {name: dimension for state in device.states for name, dimension in state.chip.dimensions().items()}
    for name, dimension in known.items():
        parsed = ParameterName.parse(name)
        region, what = parsed.owner, parsed.coefficient
        if what in SHAPES or region.startswith(("ports", "electrode")) or (
                what != "thickness" and name not in device.known):
            continue
        across = next((each.replace("_", " ") for each in ACROSS if what.endswith(each)), "")
        about = "a wrong thickness" if what == "thickness" else f"a wrong {across}" if across else (
            "another size than stated")
        yield other_than_stated(device, f"{what} of the {region}", region, "geometry", about,
                                {name: mistaken_length(name, dimension.value)})


def mistaken_length(name: str, value: float) -> Admissible:
    """The range of the dimension ``<region>.<length>``, whose stated `value` is in metres."""
    parsed = ParameterName.parse(name)
    low, high = MISTAKEN_THICKNESS if parsed.is_shape else MISTAKEN_RADIUS
    if parsed.is_thickness:
        low, high = SPREAD.get(role_of(parsed.owner), MISTAKEN_THICKNESS)
    return Admissible(low * value, high * value, parsed.unit,
                      f"{low:g} to {high:g} times the stated value: a mistake that goes unnoticed")


# --------------------------------------------------------------------------------------------------------------------
# Bench


def bench(device: Device) -> Iterator[Effect]:
    """Elements between the electrodes and the instrument."""
    for element, known in BENCH_ELEMENTS.items():
        limit = Admissible(known.low, known.high, known.unit, "leads, contacts and probes of a laboratory bench")
        yield other_than_stated(device, known.text, "bench", "bench", "between the electrodes and the instrument",
                                {BENCH + element: limit})


SOURCES: tuple[Callable[[Device], Iterator[Effect]], ...] = (
    cavity_fluid, meniscus, filling, ports, soaked, top, gripped, couplant, bonds, joints, solid_hypotheses, made_of,
    lengths, shapes, transducer, bench)
