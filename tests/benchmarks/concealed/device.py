"""A device as numbers by name, and the body that these numbers and its hidden defects make in one of its states.

Names are those of a campaign file: ``pzt/trial.c33``, ``pzt/trial.c33.loss``, ``couplant.thickness``, ``bench.gain``.
Defects have names of their own (see :mod:`mechanisms`); without any, the body is what the chip files describe.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from concealed.media import Bubbles, Hold, Liquid, Load, Medium, Necks, Piezo, Solid, Viscous
from concealed.section import Body, Box, Face, Profile, Warp
from numpy.typing import NDArray

from materials.kinds import Fluid, IsotropicSolid
from materials.registry import Registry

Values = Mapping[str, float]
Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

PZT, PLA, EPOXY, GLASS, GEL, WATER = ("pzt/trial", "pla/trial", "epoxy/trial", "glass/trial", "gel/trial",
                                      "water/iapws_2011")
REFERENCE_TEMPERATURE = 298.15

#: Liquids that may be in the cavity instead of water, and materials of its wall instead of the printed polymer.
LIQUIDS = ("glycerol_water_20/volk_2018", "glycerol_water_50/volk_2018", "glycerol_water_80/volk_2018",
           "olive_oil/rshydro")
WALLS = ("petg/acevedo_2026", "abs/acevedo_2026", "pmma/acevedo_2026", "polycarbonate/ono_2020",
         "photopolymer/bakaric_2021")

#: Thickness (m) of the layers that stand for an imperfect bond, for a crack and for a bubble under the lid.
THIN = 1e-6

#: Slices of the ceramic whose poling changes through its thickness.
SLICES = 8

#: Distance (m) from an inner corner of the cavity within which the grid is finer: stress is singular there.
CORNER = 3e-5

#: Distance (m) from the edge of an open face within which the grid is finer: stress is singular there as well.
TIP = 1e-5

#: Share of the radius of a patch within which the grid is finer at its edge and below it.
STEEP = 1.0 / 6.0

PIEZO_CONSTANTS = ("density", "c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15", "eps11", "eps33")


@dataclass(frozen=True)
class State:
    """One state of the device: "disc", "empty" or "filled" at a temperature (K) and a drive (V, peak to peak)."""

    name: str
    filling: str
    temperature: float = REFERENCE_TEMPERATURE
    drive: float = 2.0
    held_out: bool = False


_DISC, _AGAIN = State("disc", "disc"), State("filled_again", "filled", temperature=308.15, drive=5.0, held_out=True)

#: Sets of states that somebody measures: fillings, or drives.
FILLINGS = (_DISC, State("empty", "empty"), State("filled", "filled"), _AGAIN)
DRIVES = (_DISC, State("filled_low", "filled", drive=0.5), State("filled_high", "filled", drive=8.0), _AGAIN)

#: All of them.
STATES = tuple(dict.fromkeys((*FILLINGS, *DRIVES)))


@lru_cache
def liquid(name: str, temperature: float) -> Fluid:
    """A liquid of the registry (its law is what the states' stated temperatures refer to)."""
    found = Registry().load(name, temperature=temperature)
    if not isinstance(found, Fluid):
        raise TypeError(f"{name} must be a fluid")
    return found


def water(temperature: float) -> Fluid:
    """What the cavity is stated to hold."""
    return liquid(WATER, temperature)


@lru_cache
def registry_solid(name: str) -> Solid:
    """A solid of the registry."""
    found = Registry().load(name)
    if not isinstance(found, IsotropicSolid):
        raise TypeError(f"{name} must be an isotropic solid")
    return Solid.isotropic(found.density, found.bulk_modulus, found.shear_modulus)


def _number(values: Values, name: str) -> complex:
    return complex(values[name], values.get(f"{name}.loss", 0.0))


def transducer(values: Values, defects: Values, drive: float) -> Piezo:
    """The ceramic; driven harder it is softer and loses more, where that is its defect."""
    constants = {name: _number(values, f"{PZT}.{name}") for name in PIEZO_CONSTANTS}
    level = (drive / 8.0) ** 2
    c33 = constants["c33"] * (1.0 - defects.get("softening.stiffness", 0.0) * level)
    c33 -= 1j * defects.get("softening.loss", 0.0) * level * c33.real
    return Piezo(**{
        **constants,
        "c33": c33 - 1j * defects.get("c33.loss", 0.0),
        "c44": constants["c44"] - 1j * defects.get("c44.loss", 0.0),
        "eps33": constants["eps33"] + 1j * defects.get("eps33.loss", 0.0),
        "e33": constants["e33"] + 1j * defects.get("e33.loss", 0.0),
    })


def poled(ceramic: Piezo, share: float) -> Piezo:
    """A ceramic with a share of its piezoelectricity."""
    return replace(ceramic, e31=share * ceramic.e31, e33=share * ceramic.e33, e15=share * ceramic.e15)


def polymer(values: Values, defects: Values, *, wet: bool, factor: float = 1.0) -> Solid:
    """The printed polymer."""
    density = values[f"{PLA}.density"]
    bulk, shear = factor * _number(values, f"{PLA}.bulk_modulus"), factor * _number(values, f"{PLA}.shear_modulus")
    if wet and "uptake.fraction" in defects:
        density *= 1.0 + defects["uptake.fraction"]
        bulk, shear = bulk.real * (1.0 + 0j) + 1j * bulk.imag, shear.real * (1.0 + 0j) + 1j * shear.imag
        shear = shear * (1.0 - defects["uptake.softening"]) - 1j * defects["uptake.loss"] * shear.real
    fractional = None
    if "fractional.strength" in defects:
        fractional = (defects["fractional.strength"], defects["fractional.exponent"], defects["fractional.omega"])
    made = Solid.isotropic(density, bulk, shear, fractional=fractional)
    if "anisotropy.c33" in defects:
        made = Solid(made.density, made.c11, made.c12, made.c13, made.c33 * (1.0 + defects["anisotropy.c33"]),
                     made.c44 * (1.0 + defects["anisotropy.c44"]), fractional)
    return made


def couplant(values: Values, defects: Values) -> Medium:
    """The gel: a liquid without shear unless a viscosity is hidden in it."""
    density, speed = values[f"{GEL}.density"], values[f"{GEL}.sound_speed"]
    bubbles = None
    if "gel.void_fraction" in defects:
        bubbles = Bubbles(defects["gel.void_fraction"], 0.0, density, speed, 1e-3)
    if "gel.viscosity" in defects:
        return Viscous(density, speed, defects["gel.viscosity"], 0.0, bubbles)
    return Liquid(density, speed, 0.0, bubbles)


def content(values: Values, defects: Values, state: State) -> Viscous:
    """What fills the cavity: a viscous fluid, whose layers at the walls are resolved."""
    temperature = state.temperature + defects.get("temperature.offset", 0.0)
    if "cavity.liquid" in defects:
        law, scale = liquid(LIQUIDS[int(defects["cavity.liquid"])], temperature), 1.0
    else:
        law = water(temperature)
        scale = values[f"{WATER}.sound_speed"] / water(REFERENCE_TEMPERATURE).sound_speed
    speed, shear, bulk = law.sound_speed * scale, law.shear_viscosity or 0.0, law.bulk_viscosity or 0.0
    bulk += defects.get("cavity.bulk_viscosity", 0.0)
    bubbles = None
    if "cavity.void_fraction" in defects:
        bubbles = Bubbles(defects["cavity.void_fraction"], defects.get("cavity.bubble_radius", 0.0), law.density,
                          speed, shear)
    return Viscous(law.density, speed, shear, bulk, bubbles)


def _towards(low: float, high: float, layer: float) -> list[float]:
    """Lines that resolve a layer of thickness `layer` at both ends of an interval, where it is thin."""
    steps = [s * layer for s in (2.5, 8.0) if 4.0 * s * layer < high - low]
    return [low + s for s in steps] + [high - s for s in steps]


def body(values: Values, defects: Values, state: State) -> Body:
    """The section of the device in a state."""
    omega = 2.0 * math.pi * 1e6
    h, a = values["transducer.thickness"], values["transducer.radius"]
    metal = defects.get("electrode.thickness", 0.0)
    ceramic = transducer(values, defects, state.drive)
    boxes = [Box(0.0, a, metal, metal + h, ceramic, "transducer")]
    lines_r: list[float] = []
    lines_z: list[float] = []
    faces: list[Face] = []
    if metal:
        # Porous fired silver, soft beside the ceramic.
        silver = Solid.isotropic(defects["electrode.density"], 6e9, 4e9)
        boxes += [Box(0.0, a, 0.0, metal, silver), Box(0.0, a, metal + h, 2.0 * metal + h, silver)]
    if "depoled.radius" in defects:
        bare = poled(ceramic, 0.0)
        boxes.append(Box(defects["depoled.radius"], a, metal, metal + h, bare, "transducer"))
    if "poling.slope" in defects:
        middle = metal + 0.5 * h
        boxes += [Box(0.0, a, z0, z1, poled(ceramic, 1.0 + defects["poling.slope"] * (0.5 * (z0 + z1) - middle) / h),
                      "transducer") for z0, z1 in pairwise(np.linspace(metal, metal + h, SLICES + 1).tolist())]
    live = (metal + h, 0.0, min(a, defects.get("electrode.radius", a)))
    ground = (metal, 0.0, a)
    if "clamp.normal" in defects:
        faces.append(Face(0.0, a, 0.0, 0.0, Load(defects["clamp.normal"], 0.0)))
    if "patch.distance" in defects:
        # Fields are steep at the edge of a patch that is moved, and below it.
        distance, edge = defects["patch.distance"], 0.5 * defects["patch.diameter"]
        near = (end + step * edge for end in (abs(distance - edge), distance + edge) for step in (-STEEP, 0.0, STEEP))
        lines_r += [line for line in near if line > 0.5 * STEEP * edge]
        lines_z += [metal + h - step * edge for step in (STEEP, 4.0 * STEEP)]
    if state.filling == "disc":
        return Body(tuple(boxes), live, ground, tuple(faces), tuple(lines_r), tuple(lines_z),
                    warps(values, defects, state))

    outer, cavity = values["substrate.radius"], values["cavity.radius"]
    z = 2.0 * metal + h
    gel, top = couplant(values, defects), z + values["couplant.thickness"]
    covered = values["couplant.radius"]
    boxes.append(Box(0.0, covered, z, top, gel, "couplant"))
    if "coverage.inner" in defects:
        boxes.append(Box(defects["coverage.inner"], min(covered, defects["coverage.outer"]), z, top, None))
    if isinstance(gel, Viscous):
        lines_z += _towards(z, top, math.sqrt(2.0 * gel.shear_viscosity / (abs(gel.density) * omega)))
    z, top = top, top + values["substrate.thickness"]
    wet = state.filling == "filled"
    pla = polymer(values, defects, wet=wet)
    gradient = defects.get("gradient.slope", 0.0)
    if gradient:
        edges = np.linspace(0.0, outer, 9)
        boxes += [Box(r0, r1, z, top, polymer(values, defects, wet=wet, factor=1.0 + gradient * (
            0.5 * (r0 + r1) / outer - 0.5)), "substrate") for r0, r1 in pairwise(edges.tolist())]
    else:
        boxes.append(Box(0.0, outer, z, top, pla, "substrate"))
    if "crack.inner" in defects:
        middle = z + defects["crack.height"] * (top - z)
        boxes.append(Box(defects["crack.inner"], defects["crack.outer"], middle, middle + THIN, None))
    floor, z, top = top, top, top + values["sidewall.thickness"]
    wall = registry_solid(WALLS[int(defects["sidewall.material"])]) if "sidewall.material" in defects else pla
    boxes.append(Box(cavity, outer, z, top, wall, "sidewall"))
    z, top = top, top + values["bond.thickness"]
    boxes.append(Box(cavity, outer, z, top, Solid.isotropic(
        values[f"{EPOXY}.density"], _number(values, f"{EPOXY}.bulk_modulus"),
        _number(values, f"{EPOXY}.shear_modulus")), "bond"))
    if "open.width" in defects:
        at, width = z if defects["open.below"] else top - THIN, defects["open.width"] * (outer - cavity)
        inner, edge, end = (cavity, cavity + width, cavity + width) if not defects["open.beyond"] else (
            outer - width, outer - width, outer)
        boxes.append(Box(inner, end, at, at + THIN, None))
        lines_r += [edge - TIP, edge + TIP]
    if "bond.normal_stiffness" in defects:
        lossy = 1.0 - 1j * defects["bond.loss_factor"]
        normal, shear = (defects[f"bond.{kind}_stiffness"] * THIN * lossy for kind in ("normal", "tangential"))
        weak = Solid(values[f"{EPOXY}.density"], normal, 0.3 * normal, 0.3 * normal, normal, shear)
        at = z if defects["bond.below"] else top - THIN
        boxes.append(Box(cavity, outer, at, at + THIN, weak))
    z, ceiling, top = top, top, top + values["superstrate.thickness"]
    lines_r += [cavity - CORNER, cavity + CORNER]
    lines_z += [floor - CORNER, floor + CORNER, floor + values["sidewall.thickness"] - CORNER]
    boxes.append(Box(0.0, outer, z, top, Solid.isotropic(
        values[f"{GLASS}.density"], _number(values, f"{GLASS}.bulk_modulus"),
        _number(values, f"{GLASS}.shear_modulus")), "superstrate"))
    if state.filling == "filled":
        fluid = content(values, defects, state)
        surface = floor + defects.get("fill.share", 1.0) * (ceiling - floor)
        boxes.append(Box(0.0, defects.get("meniscus.radius", cavity), floor, surface, fluid))
        if "bubble.outer" in defects:
            boxes.append(Box(defects["bubble.inner"], defects["bubble.outer"], ceiling - THIN, ceiling, None))
            lines_r += [defects["bubble.outer"] - TIP, defects["bubble.outer"] + TIP]
        layer = math.sqrt(2.0 * fluid.shear_viscosity / (abs(fluid.density) * omega))
        lines_z += [floor + 2.5 * layer, surface - 2.5 * layer, surface - CORNER]
        lines_r.append(cavity - 2.5 * layer)
        if "port necks.share" in defects:
            necks = Necks(defects["port necks.share"], abs(fluid.density), defects["port necks.length"],
                          defects["port necks.resistance"], 0.0)
            faces.append(Face(cavity, cavity, floor, ceiling, necks))
    if "lid.normal" in defects:
        faces.append(Face(0.0, outer, top, top, Load(defects["lid.normal"], 0.0)))
    for held, z0, z1 in (("substrate", floor - values["substrate.thickness"], floor), ("superstrate", ceiling, top)):
        if f"{held}.held" in defects:
            stiffness = defects[f"{held}.held"] * (1.0 - 1j * defects["held.loss_factor"])
            faces.append(Face(outer, outer, z0, z1, Hold(stiffness, defects["held.tangential"] * stiffness)))
    return Body(tuple(boxes), live, ground, tuple(faces), tuple(lines_r), tuple(lines_z), warps(values, defects, state))


def warps(values: Values, defects: Values, state: State) -> tuple[Warp, ...]:
    """How parts differ from discs with plane faces and upright sides: what is beside them makes room."""
    h, a = values["transducer.thickness"], values["transducer.radius"]
    metal = defects.get("electrode.thickness", 0.0)
    top = 2.0 * metal + h
    across = Profile(((-a, 0.0), (a, 0.0)), parabola=True)
    found: list[Warp] = []
    if state.filling == "disc":
        if "transducer.dome" in defects:
            found.append(Warp(False, defects["transducer.dome"], across, Profile(((metal, 0.0), (top - metal, 1.0)))))
        return tuple(found)
    outer, cavity = values["substrate.radius"], values["cavity.radius"]
    gel = top + values["couplant.thickness"]
    floor = gel + values["substrate.thickness"]
    wall = floor + values["sidewall.thickness"]
    ceiling = wall + values["bond.thickness"]
    lid = ceiling + values["superstrate.thickness"]
    if "transducer.dome" in defects:
        found.append(Warp(False, defects["transducer.dome"], across,
                          Profile(((metal, 0.0), (top - metal, 1.0), (gel, 0.0)))))
    if "sidewall.draft" in defects:
        widened = math.tan(defects["sidewall.draft"]) * (wall - floor)
        found.append(Warp(True, widened, Profile(((0.0, 0.0), (cavity, 1.0), (outer, 0.0))),
                          Profile(((floor, 0.0), (wall, 1.0), (ceiling, 1.0), (lid, 0.0)))))
    if "sidewall.barrel" in defects:
        found.append(Warp(True, defects["sidewall.barrel"], Profile(((cavity, 0.0), (outer, 1.0))),
                          Profile(((floor, 0.0), (wall, 0.0)), parabola=True)))
    if "superstrate.bow" in defects:
        found.append(Warp(False, defects["superstrate.bow"], Profile(((-outer, 0.0), (outer, 0.0)), parabola=True),
                          Profile(((wall, 0.0), (ceiling, 1.0), (lid, 1.0)))))
    return tuple(found)


def swept(values: Values, defects: Values, state: State, frequency: Real) -> Real:
    """Frequencies (n,) Hz that the device has been asked for where the generator shows `frequency` (n,), relative to a
    device as warm as at the start: its moduli follow the temperature, which wanders through the sweep."""
    asked = frequency * (1.0 + values.get("bench.clock", 0.0))
    if "wander.size" in defects:
        # Every state is measured at another hour.
        time = np.linspace(0.0, 1.0, frequency.size)
        turn = 2.0 * np.pi * (defects["wander.cycles"] * time + defects["wander.phase"] + 0.382 * STATES.index(state))
        asked = asked / (1.0 + defects["wander.size"] * np.sin(turn))
    return asked


def seen(values: Values, defects: Values, state: State, frequency: Real, own: Complex) -> Complex:
    """What the bench shows (n,) of a device of impedance `own` (n,), both e^{+j w t}."""
    w = 2.0 * np.pi * frequency
    admittance = 1.0 / own
    if "parasite.strength" in defects:
        # A mode that is not axisymmetric, weakly driven: one more motional branch, detuned by what is on the disc.
        detuned = defects["parasite.frequency"] * (1.0 if state.filling == "disc" else defects["parasite.shift"])
        x = frequency / detuned
        admittance = admittance + 1j * w * defects["parasite.strength"] / (1.0 - x**2 + 1j * x / defects["parasite.q"])
    inner = 1.0 / (admittance + 1j * w * values["bench.parallel_capacitance"])
    series = values["bench.series_resistance"] + 1j * w * values["bench.series_inductance"]
    gain = np.exp(values["bench.gain"] + 1j * (values["bench.phase"] - w * values["bench.delay"]))
    return np.asarray(gain * (series + inner))
