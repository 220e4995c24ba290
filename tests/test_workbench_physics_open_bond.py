"""A bond open at a rim against chips whose bond ends there, and against a bond of less material."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import Chip
from materials.kinds import IsotropicSolid, Material
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import Problem, problem
from workbench.physics import open_bond
from workbench.physics.annulus import Annulus
from workbench.physics.open_bond import HALFWAY, SKIN, STIFFNESS_FLOOR, OpenBond

RADIUS, HOLE, BAND = 3.5e-3, 1.5e-3, (300e3, 700e3)
FREQUENCY = np.linspace(310e3, 690e3, 9)

#: One ring, of all of a layer.
EVERYWHERE = Annulus("rim", limit=1.0, widths=())


def opened(base: Problem, width: complex, rim: Annulus, skin: float = 0.0) -> Problem:
    """`base` with a bond, or the lower face of a superstrate, that is open over a width of a rim."""
    region, material = ("superstrate", "glass") if skin else ("bond", "epoxy")
    return base.with_terms((OpenBond(region, material, rim, skin),), {rim.number: width})


def up_to(edge: float, side: str = "rim") -> tuple[float, Annulus]:
    """All of one ring, from a side to an edge (m)."""
    width = abs(edge - (RADIUS if side == "rim" else HOLE)) / RADIUS
    return width, Annulus("rim", 1.0 if side == "rim" else HOLE / RADIUS, width, outwards=side != "rim", widths=())


def impedance(model: Problem, frequency: NDArray[np.float64] = FREQUENCY) -> NDArray[np.complex128]:
    return solve_full(assemble(model.mesh, model.terms), frequency, model.values).impedance


@pytest.fixture(scope="module")
def empty(
    stacked: Callable[..., Chip], meshed: Callable[..., Problem], filled_materials: dict[str, Material]
) -> Callable[..., Problem]:
    """The small chip without water, its bond from a hole to a radius (m), or with the superstrate on the sidewall."""
    materials = {region: material for region, material in filled_materials.items() if region != "cavity"}

    def made(hole: float = HOLE, radius: float = RADIUS, skin: float | None = None) -> Problem:
        layers: list[tuple[str, float, float, float | None]] = [
            ("transducer", 2e-3, 3e-3, None), ("couplant", 50e-6, 3e-3, None), ("substrate", 0.85e-3, RADIUS, None),
            ("sidewall", 0.72e-3, RADIUS, HOLE)]
        if skin is None:
            layers += [("bond", 0.1e-3, radius, hole), ("superstrate", 1e-3, RADIUS, None)]
        else:
            # What is left of a skin at the lower face, where it has an edge.
            layers += [("layer", skin * 1e-3, radius, None)] if radius < RADIUS else []
            layers += [("superstrate", 1e-3 if radius == RADIUS else (1.0 - skin) * 1e-3, RADIUS, None)]
        there = {**materials, "layer": materials["superstrate"]}
        roles = {role for role, *_ in layers}
        return meshed(stacked(layers, band=BAND), {region: there[region] for region in there if region in roles},
                      elements_per_wavelength=8.0, skins={"superstrate": SKIN} if skin and radius == RADIUS else None)

    return made


def edge_of(base: Problem, about: float, way: str) -> tuple[float, float]:
    """A radius near one (m): that of an element, or the middle between two; and the next of an element."""
    radii = np.unique(base.mesh.mesh.p[0])
    inner, after = radii[np.flatnonzero(radii >= about)[0] + np.array([0, 1])]
    return (float(inner) if way == "at the edge of an element" else float(0.5 * (inner + after))), float(after)


@pytest.mark.parametrize("way", ["at the edge of an element", "within an element"])
@pytest.mark.parametrize(("side", "about"), [("rim", 2.9e-3), ("rim", 2.2e-3), ("cavity", 1.8e-3), ("cavity", 2.5e-3)])
def test_an_open_ring_is_a_bond_that_ends_there(
    side: str, about: float, way: str, empty: Callable[..., Problem]
) -> None:
    base = empty()
    edge, _ = edge_of(base, about, way)
    resolved = empty(radius=edge) if side == "rim" else empty(hole=edge)
    full, expected, found = impedance(base), impedance(resolved), impedance(opened(base, *up_to(edge, side)))
    effect, miss = np.abs(expected - full).max(), np.abs(found - expected).max()
    print(f"open at the {side}, {edge * 1e3:.2f} mm, {way}: {effect / np.abs(full).max():.2g} of Z, "
          f"off by {miss / effect:.2g}")
    assert np.abs(expected / full - 1.0).max() > 0.03
    # At an edge: what is left in the gap. Elsewhere elements, here of order two and as wide as three thicknesses of the
    # bond, have no kink where the stress has one.
    assert miss < {"at the edge of an element": 1e-5, "within an element": 0.03}[way] * effect


@pytest.mark.parametrize("about", [2.9e-3, 2.2e-3])
def test_without_a_layer_a_skin_of_the_superstrate_opens(about: float, empty: Callable[..., Problem]) -> None:
    base = empty(skin=SKIN)
    edge, _ = edge_of(base, about, "at the edge of an element")
    full, expected = impedance(base), impedance(empty(skin=SKIN, radius=edge))
    found = impedance(opened(base, *up_to(edge), skin=-SKIN))
    effect, miss = np.abs(expected - full).max(), np.abs(found - expected).max()
    print(f"superstrate on the sidewall, open at the rim, {edge * 1e3:.2f} mm: off by {miss / effect:.2g}")
    assert np.abs(expected / full - 1.0).max() > 0.03
    assert miss < 5e-3 * effect  # two meshes through the skin, at the tip of a crack


def test_the_thickness_of_the_skin_hardly_matters(empty: Callable[..., Problem]) -> None:
    full = impedance(empty(skin=SKIN))
    thin, thick = (impedance(empty(skin=share, radius=2.2e-3)) for share in (0.5 * SKIN, SKIN))
    assert np.abs(thin - thick).max() < 0.02 * np.abs(thick - full).max()


def test_a_share_of_a_ring_says_where_the_edge_is(empty: Callable[..., Problem]) -> None:
    base = empty()
    edge, after = edge_of(base, 2.2e-3, "within an element")
    inner = 2.0 * edge - after
    rim = Annulus("rim", limit=1.0 - inner / RADIUS, widths=(1.0 - after / RADIUS,))
    full, expected = impedance(base), impedance(empty(radius=edge))
    found = impedance(opened(base, 1.0 - edge / RADIUS, rim))
    miss = np.abs(found - expected).max() / np.abs(expected - full).max()
    print(f"open beyond {edge * 1e3:.2f} mm by a share of a ring: off by {miss:.2g}")
    # Spread evenly over a ring, what is left holds the superstrate elsewhere than at the edge.
    assert miss < 0.15


@pytest.mark.parametrize("share", [0.5, 0.99])
def test_a_ring_all_over_is_a_bond_of_so_much_less_stiffness_and_mass(filled: Problem, share: float) -> None:
    frequency = np.linspace(310e3, 390e3, 5)
    epoxy = filled.materials["bond"]
    assert isinstance(epoxy, IsotropicSolid)
    held = STIFFNESS_FLOOR + (1.0 - STIFFNESS_FLOOR) * HALFWAY * (1.0 - share) / (1.0 - (1.0 - HALFWAY) * (1.0 - share))
    less = replace(epoxy, density=held * epoxy.density, bulk_modulus=held * epoxy.bulk_modulus,
                   shear_modulus=held * epoxy.shear_modulus)
    expected = impedance(problem(filled.mesh, {**filled.materials, "bond": less}, filled.band), frequency)
    assert np.abs(expected / impedance(filled, frequency) - 1.0).max() > 0.01
    found = impedance(opened(filled, 1.0 - (1.0 - share) ** 0.5, EVERYWHERE), frequency)
    assert np.abs(found / expected - 1.0).max() < 1e-9


def test_what_is_left_in_the_gap_does_not_matter(
    empty: Callable[..., Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    base = empty()
    model = opened(base, *up_to(0.8 * RADIUS))
    full, found = impedance(base), impedance(model)
    monkeypatch.setattr(open_bond, "STIFFNESS_FLOOR", 10.0 * STIFFNESS_FLOOR)
    changed = np.abs(impedance(model) - found).max() / np.abs(found - full).max()
    print(f"left, ten times: off by {changed:.2g}")
    assert 0.0 < changed < 1e-4
