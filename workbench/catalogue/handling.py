"""Hypotheses about how a chip was filled, gripped and made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

import numpy as np

from geometry.names import CAVITY, interface, outside, part_name, role_of
from materials.kinds import Fluid, IsotropicSolid, Material
from workbench.campaign.campaign import DeviceState
from workbench.catalogue.effect import Device, Effect, is_liquid, is_polymer, with_terms
from workbench.model.problem import boundary_layers, material_values, terms_of
from workbench.physics import gas_pocket, other_material, surface_load
from workbench.physics.annulus import Annulus
from workbench.physics.term import Term

#: Depths of slabs above a free surface, relative to the cavity's height. Beyond the last one the liquid is a film. A
#: search refines them near the surface; each is a row of elements in every mesh of a score.
DEPTHS = (0.05, 0.15, 0.35, 0.7)

#: Areas of discs under a bubble, relative to the lid's area over the cavity. Beyond the last one the chip is empty.
AREAS = (0.04, 0.15, 0.4, 0.8)

#: Roles of layers that may be of another material. A film of gel or glue is not among them: only its stiffness over
#: thickness is observable, and thickness and shear have their own hypotheses.
MADE = ("substrate", "sidewall", "superstrate", "sample", "layer", "matching")

#: Roles of layers that a holder grips.
GRIPPED = ("substrate", "superstrate")

#: ALIKE is the rms of the log ratios of constants up to which two materials count as one: PLA and PETG differ by 0.32.
#: OF_A_KIND is the largest ratio of densities and of shear moduli within a kind: glass and silicon differ by factors
#: of 1 and 2.3, glass and steel by 3.2 in density.
ALIKE, OF_A_KIND = 0.08, (2.0, 5.0)

_Kind = TypeVar("_Kind", Fluid, IsotropicSolid)


def filling(device: Device) -> Iterator[Effect]:
    """A partly filled cavity, a bubble in it, or another liquid."""
    states = device.filled
    if not states or not isinstance(fluid := states[0].fluid, Fluid):
        return
    surface = Annulus("free surface", limit=DEPTHS[-1], widths=DEPTHS[:-1], measure="height")
    yield with_terms("cavity filled up to a height", CAVITY, "geometry", "the liquid ends at a level surface below the "
                     "lid", states, lambda state: [gas_pocket.GasPocket(
                         CAVITY, state.materials[CAVITY].name, surface, _height(state))])
    bubble = Annulus("bubble under the lid", 0.0, AREAS[-1], True, AREAS[:-1], "area")
    covered = [state for state in states if _lid(state)]
    if covered:
        yield with_terms("bubble under the lid", CAVITY, "geometry", "a bubble of air sits under the middle of the lid",
                         covered, lambda state: [gas_pocket.GasPocket(
                             CAVITY, state.materials[CAVITY].name, bubble,
                             max(hole.inner_radius for hole in state.chip.holes), interface(CAVITY, _lid(state)),
                             _lid(state))])
    for other in others_of_kind(device, fluid):
        yield _exchanged(device, states, CAVITY, other, f"{_short(other.name)} in the cavity", "the liquid is another "
                         "than stated, or contains a share of it")


def _height(state: DeviceState) -> float:
    return state.chip.holes[-1].z_top - state.chip.holes[0].z_bottom


def _lid(state: DeviceState) -> str:
    """The layer over the cavity, "" for an open cavity."""
    order = [layer.region for layer in state.chip.layers]
    above = order[order.index(state.chip.holes[-1].region) + 1:]
    return above[0] if above and interface(CAVITY, above[0]) in state.device.section.boundary_names() else ""


def gripped(device: Device) -> Iterator[Effect]:
    """A holder at the outer side of the lid or the substrate."""
    for region in dict.fromkeys(r for state in device.states for r in state.materials if role_of(r) in GRIPPED):
        yield _gripped(device, region)


def _gripped(device: Device, region: str) -> Effect:
    spring = surface_load.SurfaceSpring(part_name(outside(region), region), region, f"{region} held at its rim")
    return with_terms(spring.name, region, "stiffness", "a holder grips its outer side", device.holding(region),
                      lambda _: [spring])


def made_of(device: Device) -> Iterator[Effect]:
    """A layer of another material of the same kind."""
    for region in dict.fromkeys(r for state in device.states for r in state.materials if role_of(r) in MADE):
        states = device.holding(region)
        stated = states[0].materials[region]
        for other in others_of_kind(device, stated) if isinstance(stated, IsotropicSolid) else ():
            yield _exchanged(device, states, region, other, f"{region} of {_short(other.name)}", "the layer is of "
                             f"{_short(other.name)} instead of {_short(stated.name)}")


def _exchanged(
    device: Device, states: tuple[DeviceState, ...], region: str, other: Material, name: str, about: str
) -> Effect:
    """The hypothesis that a region of some states is of another material."""
    def term(state: DeviceState) -> other_material.OtherMaterial:
        return other_material.OtherMaterial(_terms(state, region), name)

    def ratios(state: DeviceState) -> Mapping[str, complex]:
        stated, made = state.materials[region], term(state)
        own, there = ({name.rpartition(".")[2]: value for name, value in material_values(each).items()}
                      for each in (stated, _at_temperature_of(device, other, stated)))
        # A constant that one of the two lacks stays unchanged.
        return {made.ratio(key): there[key] / own[key] if own.get(key) and there.get(key) else 1.0
                for key in made.constants()}

    return with_terms(name, region, "stiffness", about, states, lambda state: [term(state)], ratios)


def _terms(state: DeviceState, region: str) -> tuple[Term, ...]:
    """The terms of the base model with constants of a region's material."""
    material = state.materials[region]
    own = terms_of(region, material)
    if not isinstance(material, Fluid) or state.device.inviscid:
        return own
    pairs = (tuple(boundary.split("|")) for boundary in state.device.section.boundary_names() if "|" in boundary)
    walls = [(interface(*pair), side) for pair in pairs if region in pair for side in pair
             if side != region and side in state.materials]
    return (*own, *(layer for boundary, wall in walls for layer in boundary_layers(boundary, wall, region, material)))


def _at_temperature_of(device: Device, other: Material, stated: Material) -> Material:
    """The `other` material at the temperature of the stated one."""
    if other.temperature is None or stated.temperature is None:
        return other
    return device.registry.load(other.name, temperature=stated.temperature)


def others_of_kind(device: Device, stated: _Kind) -> list[_Kind]:
    """Materials that may be mistaken for the `stated` one, nearest first.

    Their density and stiffness are within :data:`OF_A_KIND` of it. They differ from it and from each other by more than
    :data:`ALIKE`. Liquids have a viscosity.
    """
    found = sorted(((_distance(stated, material), material) for material in device.by_name
                    if isinstance(material, type(stated)) and _is_of_kind(stated, material)), key=lambda each: each[0])
    kept = [stated]
    for _, material in found:
        if min(_distance(material, each) for each in kept) > ALIKE:
            kept.append(material)
    return kept[1:]


def _is_of_kind(stated: _Kind, other: _Kind) -> bool:
    if isinstance(stated, Fluid) and isinstance(other, Fluid):
        return is_liquid(other) and other.shear_viscosity is not None
    ratios = np.exp(np.abs(_logarithms(stated) - _logarithms(other)))
    return bool((ratios[:2] < OF_A_KIND).all()) and is_polymer(stated) == is_polymer(other)


def _distance(one: _Kind, other: _Kind) -> float:
    return float(np.sqrt(np.mean((_logarithms(one) - _logarithms(other)) ** 2)))


def _logarithms(material: Fluid | IsotropicSolid) -> np.ndarray:
    """Logarithms of density and of the moduli that determine sound speeds."""
    if isinstance(material, Fluid):
        return np.log([material.density, material.density * material.sound_speed**2])
    return np.log([material.density, material.shear_modulus.real, material.bulk_modulus.real])


def _short(name: str) -> str:
    """The name of a material in words, without its source."""
    return name.partition("/")[0].replace("_", " ")
