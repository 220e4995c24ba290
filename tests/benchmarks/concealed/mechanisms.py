"""What can be hidden in a device: each mechanism draws its size, from not to be seen to strong.

A mechanism takes the random generator, the design and the true numbers so far, and returns an :class:`Effect`: how the
truth is told, and what of the device it changes, either true numbers (``values``) or defects of
:mod:`device` (``defects``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from concealed.design import Design
from concealed.device import LIQUIDS, PLA, PZT, REFERENCE_TEMPERATURE, WALLS, Values, liquid, registry_solid


@dataclass(frozen=True)
class Effect:
    """``region`` as the workbench names it, "bench" for the port; ``kind`` stiffness, mass, loss, geometry, coupling,
    bench or other; ``parameters`` in SI. ``catalogued`` is False for what no hypothesis of the workbench describes.
    ``detectability`` in standard deviations is filled in when the spectra are there."""

    name: str
    region: str
    kind: str
    parameters: Mapping[str, float]
    catalogued: bool = True
    values: Values = field(default_factory=dict)
    defects: Values = field(default_factory=dict)
    detectability: float = math.nan


Draw = Callable[[np.random.Generator, Design, Values], Effect]


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))


def conceal(name: str, region: str, kind: str, defects: Values, *, told: Values | None = None,
            catalogued: bool = True) -> Effect:
    """An effect of some defects, told by them unless the truth is `told` otherwise."""
    return Effect(name, region, kind, dict(defects) if told is None else dict(told), catalogued, {}, dict(defects))


def _moved(name: str, region: str, kind: str, truth: Values, parameter: str, value: float) -> Effect:
    return Effect(name, region, kind, {parameter: value, f"{parameter} without it": truth[parameter]},
                  values={parameter: value})


# --------------------------------------------------------------------------------------------------------------------
# Cavity


def fluid_absorption(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    factor = _log(rng, 3e-5, 3e-2)
    viscosity = factor * 2.2e9 / (2.0 * math.pi * float(np.mean(design.frequency)))
    return conceal("fluid absorption", "cavity", "loss", {"cavity.bulk_viscosity": viscosity},
                   told={"cavity.bulk_viscosity": viscosity, "diffusivity_of_sound": viscosity / 997.0,
                         "loss_factor": factor})


def cavity_bubbles(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    return conceal("small bubbles in the cavity", "cavity", "stiffness",
                   {"cavity.void_fraction": _log(rng, 1e-8, 1e-5)})


def resonant_bubbles(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    return conceal("resonant bubbles in the cavity", "cavity", "loss",
                   {"cavity.void_fraction": _log(rng, 1e-9, 1e-6), "cavity.bubble_radius": _log(rng, 2e-6, 8e-6)})


def fluid_temperature(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    return conceal("fluid temperature", "cavity", "stiffness",
                   {"temperature.offset": _sign(rng) * _log(rng, 1.0, 10.0)})


def port_necks(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    return conceal("port necks", "cavity", "other", {
        "port necks.share": _log(rng, 1e-3, 0.2), "port necks.length": rng.uniform(2e-4, 6e-4),
        "port necks.resistance": _log(rng, 3e4, 1e6)})


# --------------------------------------------------------------------------------------------------------------------
# Gel


def gel_bubbles(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    return conceal("bubbles in the couplant", "couplant", "stiffness", {"gel.void_fraction": _log(rng, 1e-6, 1e-3)})


def gel_shear(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    return conceal("gel viscosity", "couplant", "coupling", {"gel.viscosity": _log(rng, 3e-3, 10.0)})


def gel_thickness(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    value = truth["couplant.thickness"] + design.prior["couplant.thickness"] * _log(rng, 1.5, 20.0)
    return _moved("gel thickness", "couplant", "geometry", truth, "couplant.thickness", value)


def partial_coverage(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    inner = truth["couplant.radius"] * (1.0 - _log(rng, 2e-3, 0.4))
    return conceal("partial coverage", "couplant", "geometry",
                   {"coverage.inner": inner, "coverage.outer": truth["couplant.radius"]},
                   told={"coverage.radius": inner})


# --------------------------------------------------------------------------------------------------------------------
# Polymer, bond


def imperfect_bond(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    below = bool(rng.integers(2))
    normal = _log(rng, 3e13, 1e16)
    # The layer itself, intact, has 1e14 Pa/m; tangential stiffness is a fraction of the normal one.
    hidden = {"bond.normal_stiffness": normal, "bond.tangential_stiffness": normal * rng.uniform(0.1, 0.6),
              "bond.loss_factor": rng.uniform(0.0, 0.1), "bond.below": float(below)}
    return conceal("imperfect bond", "bond", "stiffness", hidden)


def delamination(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """One face of the bond open beyond a radius, or within one."""
    inner, outer = truth["cavity.radius"], truth["substrate.radius"]
    width, beyond, below = _log(rng, 1e-2, 0.6), bool(rng.integers(2)), bool(rng.integers(2))
    edge = outer - width * (outer - inner) if beyond else inner + width * (outer - inner)
    share = (outer**2 - edge**2 if beyond else edge**2 - inner**2) / (outer**2 - inner**2)
    opened = {"open.width": width, "open.beyond": float(beyond), "open.below": float(below)}
    return conceal("partial bond", "bond", "geometry", opened,
                   told={**opened, "open.radius": edge, "open.share": share})


def fractional_loss(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    exponent, added = rng.uniform(0.1, 0.6), _log(rng, 1e-3, 0.1)
    omega = 2.0 * math.pi * float(np.mean(design.frequency))
    strength = added / math.tan(0.5 * math.pi * exponent)
    hidden = {"fractional.strength": strength, "fractional.exponent": exponent, "fractional.omega": omega}
    return conceal("fractional loss", "substrate", "loss", hidden, told={
        "fractional.exponent": exponent, "loss_factor": added,
        "loss_modulus": added * truth[f"{PLA}.shear_modulus"]})


def anisotropic_polymer(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    size = _sign(rng) * _log(rng, 2e-3, 0.2)
    return conceal("anisotropic polymer", "substrate", "stiffness",
                   {"anisotropy.c33": size, "anisotropy.c44": size * rng.uniform(-0.5, 1.0)})


def water_uptake(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    fraction = _log(rng, 1e-3, 5e-2)
    return conceal("water uptake", "substrate", "mass",
                   {"uptake.fraction": fraction, "uptake.softening": fraction * rng.uniform(0.5, 2.0),
                    "uptake.loss": fraction * rng.uniform(0.2, 1.0)})


# --------------------------------------------------------------------------------------------------------------------
# Transducer


def dielectric_loss(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    tangent = _log(rng, 5e-4, 4e-2)
    added = tangent * truth[f"{PZT}.eps33"]
    return conceal("dielectric loss", "transducer", "loss", {"eps33.loss": added},
                   told={f"{PZT}.eps33.loss": truth[f"{PZT}.eps33.loss"] + added, "added_tangent": tangent})


def complex_piezoelectric(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    # Passive: e33''^2 <= c33'' eps33''; more dielectric loss comes with it.
    tangent = _log(rng, 3e-4, 1e-2)
    added = tangent * truth[f"{PZT}.eps33"]
    whole = (truth[f"{PZT}.eps33.loss"] + added) * 8.8541878128e-12
    limit = math.sqrt(max(-truth[f"{PZT}.c33.loss"], 0.0) * whole)
    value = _sign(rng) * rng.uniform(0.5, 0.95) * limit
    return conceal("complex piezoelectric constant", "transducer", "loss", {"e33.loss": value, "eps33.loss": added},
                   told={f"{PZT}.e33.loss": value, f"{PZT}.eps33.loss": truth[f"{PZT}.eps33.loss"] + added})


def stiffness_loss(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    name = str(rng.choice(("c33", "c44")))
    added = _log(rng, 3e-4, 3e-2) * truth[f"{PZT}.{name}"]
    return conceal("stiffness loss", "transducer", "loss", {f"{name}.loss": added},
                   told={f"{PZT}.{name}.loss": truth.get(f"{PZT}.{name}.loss", 0.0) - added})


def electrode_mass(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    thickness, density = _log(rng, 3e-8, 1e-5), rng.uniform(5000.0, 9000.0)
    return conceal("electrode mass", "transducer", "mass",
                   {"electrode.thickness": thickness, "electrode.density": density},
                   told={"surface_density": thickness * density})


def partial_electrode(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    radius = truth["transducer.radius"] * (1.0 - _log(rng, 5e-4, 0.1))
    return conceal("partial electrode", "transducer", "geometry", {"electrode.radius": radius})


def depoled_rim(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    radius = truth["transducer.radius"] * (1.0 - _log(rng, 5e-4, 0.1))
    return conceal("depoled rim", "transducer", "geometry", {"depoled.radius": radius})


def clamp_load(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    name, region = (("clamp.normal", "transducer"), ("lid.normal", "superstrate"))[int(rng.integers(2))]
    return conceal("surface load", region, "loss", {name: _log(rng, 3e2, 1e6)})


def softening(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """c33 (1 - s (V / 8 Vpp)^2), and a loss that grows likewise."""
    size = _log(rng, 2e-4, 2e-2)
    return conceal("softening", "transducer", "stiffness",
                   {"softening.stiffness": size, "softening.loss": size * rng.uniform(0.1, 0.5)})


# --------------------------------------------------------------------------------------------------------------------
# Wrong statements


def wrong_dimension(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    name = str(rng.choice(("transducer.thickness", "substrate.thickness", "sidewall.thickness",
                           "superstrate.thickness", "cavity.radius")))
    value = truth[name] + _sign(rng) * design.prior[name] * _log(rng, 1.5, 15.0)
    return _moved("wrong dimension", name.split(".")[0], "geometry", truth, name, value)


def wrong_density(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    material, region = ((PZT, "transducer"), (PLA, "substrate"))[int(rng.integers(2))]
    name = f"{material}.density"
    value = truth[name] + _sign(rng) * design.prior[name] * _log(rng, 1.5, 20.0)
    return _moved("wrong density", region, "mass", truth, name, value)


def density_gauge(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """Constants fitted to a free disc with a wrong density: all of them are off with it, and the disc does not show."""
    size = _sign(rng) * _log(rng, 5e-3, 6e-2)
    powers = {name: 0.5 if name.startswith("e3") or name.startswith("e1") else 1.0
              for name in ("density", "c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15")}
    true = {f"{PZT}.{name}{part}": truth[f"{PZT}.{name}{part}"] * (1.0 + size) ** power
            for name, power in powers.items() for part in ("", ".loss") if f"{PZT}.{name}{part}" in truth}
    return Effect("density gauge", "transducer", "mass", {"transducer.gauge": size, **true}, values=true)


# --------------------------------------------------------------------------------------------------------------------
# Bench


def _bench(element: str, low: float, high: float, *, both: bool = False) -> Draw:
    def draw(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
        name = f"bench.{element}"
        sign = _sign(rng) if both else 1.0
        value = truth[name] + sign * design.prior[name] * _log(rng, low, high)
        return _moved(f"bench {element.replace('_', ' ')}", "bench", "bench", truth, name, value)

    return draw


# --------------------------------------------------------------------------------------------------------------------
# Outside the catalogue


def substrate_crack(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    inner = rng.uniform(0.2, 0.7) * truth["transducer.radius"]
    return conceal("substrate crack", "substrate", "other", {
        "crack.inner": inner, "crack.outer": inner + _log(rng, 0.05e-3, 1.2e-3), "crack.height": rng.uniform(0.3, 0.7)},
        catalogued=False)


def mode_splitting(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    area = math.pi * truth["transducer.radius"] ** 2 / truth["transducer.thickness"]
    low, high = float(design.frequency[0]), float(design.frequency[-1])
    return conceal("mode splitting", "transducer", "other", {
        "parasite.strength": _log(rng, 1e-5, 3e-3) * truth[f"{PZT}.eps33"] * 8.854e-12 * area,
        "parasite.frequency": low + rng.uniform(0.2, 0.8) * (high - low), "parasite.shift": rng.uniform(0.97, 1.0),
        "parasite.q": rng.uniform(80.0, 400.0)}, catalogued=False)


def lateral_gradient(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    return conceal("lateral gradient", "substrate", "other", {"gradient.slope": _sign(rng) * _log(rng, 0.03, 0.6)},
                   catalogued=False)


def poling_gradient(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """Piezoelectric constants that change through the thickness; their mean does not."""
    return conceal("poling gradient", "transducer", "other", {"poling.slope": _sign(rng) * _log(rng, 0.02, 0.6)},
                   catalogued=False)


def wandering_temperature(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """Resonances that move to and fro while they are measured."""
    return conceal("wandering temperature", "transducer", "other", {
        "wander.size": _log(rng, 1e-5, 1e-3), "wander.cycles": rng.uniform(0.7, 3.0), "wander.phase": rng.random()},
        catalogued=False)


# --------------------------------------------------------------------------------------------------------------------
# Shapes


def wall_draft(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    return conceal("draft of the sidewall", "sidewall", "geometry",
                   {"sidewall.draft": _sign(rng) * math.radians(_log(rng, 0.1, 4.5))})


def wall_barrel(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    return conceal("barrel of the sidewall", "sidewall", "geometry",
                   {"sidewall.barrel": _sign(rng) * _log(rng, 2e-6, 9e-5)})


def lid_bow(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """What holds it makes room for a third of itself at most."""
    return conceal("bow of the superstrate", "superstrate", "geometry", {
        "superstrate.bow": _sign(rng) * min(_log(rng, 2e-7, 1.8e-5), truth["bond.thickness"] / 3.0)})


def disc_dome(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    return conceal("dome of the transducer", "transducer", "geometry", {
        "transducer.dome": _sign(rng) * min(_log(rng, 1e-7, 9e-6), truth["couplant.thickness"] / 3.0)})


def meniscus(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """The liquid ends at a free surface before the wall."""
    radius = truth["cavity.radius"] * (1.0 - _log(rng, 1e-3, 0.25))
    return conceal("cavity not full", "cavity", "geometry", {"meniscus.radius": radius})


# --------------------------------------------------------------------------------------------------------------------
# What happens in labs


def partial_filling(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """The liquid ends at a free surface below the lid; above it is nothing."""
    return conceal("cavity filled to a height", "cavity", "geometry", {"fill.share": 1.0 - _log(rng, 1e-2, 0.6)})


def lid_bubble(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """A flat bubble under the lid, in the middle or in a ring, releases the pressure."""
    radius = truth["cavity.radius"]
    inner = float(rng.integers(2)) * rng.uniform(0.1, 0.6) * radius
    outer = inner + (_log(rng, 0.02, 0.35) if inner else _log(rng, 0.04, 0.9)) * radius
    return conceal("bubble under the lid", "cavity", "geometry", {"bubble.inner": inner, "bubble.outer": outer})


def other_liquid(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    which = int(rng.integers(len(LIQUIDS)))
    found = liquid(LIQUIDS[which], REFERENCE_TEMPERATURE)
    return conceal(f"cavity holds {LIQUIDS[which]}", "cavity", "other", {"cavity.liquid": float(which)}, told={
        "density": found.density, "sound_speed": found.sound_speed, "shear_viscosity": found.shear_viscosity or 0.0})


def wall_material(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    which = int(rng.integers(len(WALLS)))
    found = registry_solid(WALLS[which])
    return conceal(f"sidewall of {WALLS[which]}", "sidewall", "other", {"sidewall.material": float(which)}, told={
        "density": found.density.real, "c33": found.c33.real, "c33.loss": found.c33.imag, "c44": found.c44.real,
        "c44.loss": found.c44.imag})


def held_rim(rng: np.random.Generator, design: Design, truth: Values) -> Effect:
    """The rim of the lid or of the substrate sits in something stiff: springs per area, from weak ones to a clamp."""
    region = ("superstrate", "substrate")[int(rng.integers(2))]
    return conceal("held rim", region, "stiffness", {
        f"{region}.held": _log(rng, 1e10, 1e15), "held.tangential": rng.uniform(0.2, 1.0),
        "held.loss_factor": rng.uniform(0.0, 0.1)})


CATALOGUED: Mapping[str, Draw] = {
    "fluid_absorption": fluid_absorption, "cavity_bubbles": cavity_bubbles, "resonant_bubbles": resonant_bubbles,
    "fluid_temperature": fluid_temperature, "port_necks": port_necks, "gel_bubbles": gel_bubbles,
    "gel_shear": gel_shear,
    "gel_thickness": gel_thickness, "partial_coverage": partial_coverage, "imperfect_bond": imperfect_bond,
    "delamination": delamination,
    "fractional_loss": fractional_loss, "anisotropic_polymer": anisotropic_polymer, "water_uptake": water_uptake,
    "dielectric_loss": dielectric_loss, "complex_piezoelectric": complex_piezoelectric,
    "stiffness_loss": stiffness_loss, "electrode_mass": electrode_mass, "partial_electrode": partial_electrode,
    "depoled_rim": depoled_rim, "clamp_load": clamp_load, "softening": softening, "wrong_dimension": wrong_dimension,
    "wrong_density": wrong_density, "density_gauge": density_gauge,
    "bench_resistance": _bench("series_resistance", 1.5, 40.0),
    "bench_inductance": _bench("series_inductance", 1.5, 40.0),
    "bench_capacitance": _bench("parallel_capacitance", 1.5, 30.0),
    "bench_gain": _bench("gain", 1.5, 20.0, both=True), "bench_phase": _bench("phase", 1.5, 15.0, both=True),
    "bench_delay": _bench("delay", 1.5, 30.0, both=True),
    "wall_draft": wall_draft, "wall_barrel": wall_barrel, "lid_bow": lid_bow, "disc_dome": disc_dome,
    "meniscus": meniscus, "partial_filling": partial_filling, "lid_bubble": lid_bubble, "other_liquid": other_liquid,
    "wall_material": wall_material, "held_rim": held_rim,
}
OUTSIDE: Mapping[str, Draw] = {
    "lateral_gradient": lateral_gradient, "mode_splitting": mode_splitting, "substrate_crack": substrate_crack,
    "poling_gradient": poling_gradient, "wandering_temperature": wandering_temperature,
}
#: Effects that say two things of one place, so that one device cannot have both.
CLASHING = (
    {"cavity_bubbles", "resonant_bubbles"}, {"imperfect_bond", "delamination"}, {"wrong_density", "density_gauge"},
    {"meniscus", "port_necks"}, {"meniscus", "wall_draft"}, {"meniscus", "wrong_dimension"},
    *({"partial_filling", other} for other in ("meniscus", "port_necks", "lid_bubble")), {"lid_bubble", "meniscus"},
    {"lid_bubble", "wrong_dimension"}, *({"other_liquid", other} for other in (
        "fluid_absorption", "fluid_temperature", "cavity_bubbles", "resonant_bubbles")),
)
NONE = "none"
#: All that can be concealed, and the names, with that of nothing.
DRAWS: Mapping[str, Draw] = {**CATALOGUED, **OUTSIDE}
MECHANISMS: tuple[str, ...] = (NONE, *DRAWS)
