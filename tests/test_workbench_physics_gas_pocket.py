"""Gas in a part of a cavity against chips without liquid there, and against the modes of a cylinder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh
from scipy.special import jn_zeros

from geometry.chip import Chip
from geometry.mesh import mesh_section
from geometry.section import Rectangle, cut_section
from materials.kinds import Fluid, Material
from workbench.catalogue.handling import AREAS, DEPTHS
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.discretisation import Discretisation
from workbench.model.problem import Problem, problem
from workbench.physics import gas_pocket
from workbench.physics.annulus import Annulus
from workbench.physics.gas_pocket import LIQUID_FLOOR, GasPocket
from workbench.physics.term import Formula, Monomial

HEIGHT, RADIUS, FLOOR = 0.82e-3, 1.5e-3, 2.9e-3
#: The layer over a bubble, and the depth of a flat one beside the cavity's height.
LID, THIN = "superstrate", 2e-3
FREQUENCY = np.linspace(560e3, 690e3, 4)


@pytest.fixture(scope="module")
def chip(stacked: Callable[..., Chip]) -> Chip:
    """The small chip, in a wider band."""
    return stacked(
        [("transducer", 2e-3, 3e-3, None), ("couplant", 50e-6, 3e-3, None), ("substrate", 0.85e-3, 3.5e-3, None),
         ("sidewall", 0.72e-3, 3.5e-3, 1.5e-3), ("bond", 0.1e-3, 3.5e-3, 1.5e-3), ("superstrate", 1e-3, 3.5e-3, None)],
        band=(300e3, 700e3))


@pytest.fixture(scope="module")
def made(chip: Chip, filled_materials: dict[str, Material]) -> Callable[..., Problem]:
    """The chip with water, on a mesh with lines at some shares of the cavity's height and radius; with nothing in the
    upper share `depth` of the cavity within an `area` about the axis, if given."""
    @cache
    def at(levels: tuple[float, ...] = (), radii: tuple[float, ...] = (), depth: float = 0.0,
           area: float = 1.0) -> Problem:
        section = cut_section(chip)
        if depth:
            section = replace(section, rectangles=tuple(
                part for each in section.rectangles for part in emptied(each, depth, area)))
        size = Discretisation(2, 8.0, 2, growth=1.5).mesh_size(
            section, filled_materials, chip.band[1], radii=[RADIUS * r for r in radii],
            levels=[FLOOR + HEIGHT * (1.0 - each) for each in levels])
        return problem(mesh_section(section, size), filled_materials, chip.band)

    return at


def emptied(part: Rectangle, depth: float, area: float) -> list[Rectangle]:
    """A rectangle of the section, or the parts of one of the cavity; that without liquid is called the second one."""
    cut, edge = FLOOR + HEIGHT * (1.0 - depth), RADIUS * area**0.5
    if part.region != "cavity" or part.z_top <= cut:
        return [part]
    found = [replace(part, region="cavity_2", z_bottom=max(cut, part.z_bottom), r_outer=edge)]
    if part.z_bottom < cut:
        found.append(replace(part, z_top=cut))
    if area < 1.0:
        found.append(replace(found[0], region="cavity", r_inner=edge, r_outer=part.r_outer))
    return found


def pocket(base: Problem, size: float, edges: tuple[float, ...], lid: str = "") -> Problem:
    """`base` with gas to a depth, or over an area, with slabs or rings up to some `edges`."""
    rim = Annulus("gas", 0.0, edges[-1], True, edges[:-1], "area") if lid else Annulus(
        "gas", limit=edges[-1], widths=edges[:-1], measure="height")
    term = GasPocket("cavity", base.materials["cavity"].name, rim, RADIUS if lid else HEIGHT,
                     f"cavity|{lid}" if lid else "", lid)
    return base.with_terms((term,), {rim.number: size, **{key: complex(v) for key, v in term.fixed().items()}})


def impedance(model: Problem, frequency: NDArray[np.float64] = FREQUENCY) -> NDArray[np.complex128]:
    return solve_full(assemble(model.mesh, model.terms), frequency, model.values).impedance


@cache
def of_base(base: Problem) -> NDArray[np.complex128]:
    """The impedance of a chip that several tests start from."""
    return impedance(base)


def miss(found: Problem, expected: Problem, base: Problem) -> tuple[float, float]:
    """How far off an impedance is, relative to the effect, and the effect relative to Z."""
    full, there, own = of_base(base), impedance(expected), impedance(found)
    return float(np.abs(own - there).max() / np.abs(there - full).max()), float(np.abs(there / full - 1.0).max())


@pytest.mark.parametrize("depth", [0.05, 0.3, 0.7])
def test_a_free_surface_at_a_line_of_nodes_is_a_chip_without_liquid_above_it(
    depth: float, made: Callable[..., Problem]
) -> None:
    base = made((depth,))
    off, effect = miss(pocket(base, depth, (depth,)), made((depth,), depth=depth), base)
    print(f"filled up to {1.0 - depth:g} of its height: {effect:.2f} of Z, off by {off:.2g}")
    assert effect > 0.03
    # What is left of the pressure above the surface reaches 1 / 1700 of the slab deep.
    assert off < 3e-3


@pytest.mark.parametrize(("depth", "tolerance"), [(0.02, 0.15), (0.2, 0.1), (0.5, 0.4)])
def test_within_a_slab_the_depth_says_where_the_surface_is(
    depth: float, tolerance: float, made: Callable[..., Problem]
) -> None:
    base = made(DEPTHS)
    off, effect = miss(pocket(base, depth, DEPTHS), made(DEPTHS[:-1], depth=depth), base)
    print(f"filled up to {1.0 - depth:g}, within a slab: {effect:.2f} of Z, off by {off:.2g}")
    # p is linear in a slab that is thin beside the wavelength: those here are 0.02, 0.07 and 0.13 of one.
    assert off < tolerance


@pytest.mark.parametrize("area", [0.03, 0.3])
def test_a_bubble_up_to_a_line_of_nodes_is_a_chip_without_liquid_there(
    area: float, made: Callable[..., Problem]
) -> None:
    base = made((), (area**0.5,))
    off, effect = miss(pocket(base, area, (area,), LID), made((), (area**0.5,), THIN, area), base)
    print(f"bubble over {area:g} of the lid: {effect:.2f} of Z, off by {off:.2g}")
    assert effect > 0.003
    # The pressure has an infinite slope at the edge of the patch, and the two meshes differ there: with elements of
    # order four 0.011.
    assert off < 0.04


@pytest.mark.parametrize(("area", "tolerance"), [(0.02, 0.1), (0.2, 0.1), (0.6, 0.6)])
def test_within_a_ring_the_area_says_where_the_bubble_ends(
    area: float, tolerance: float, made: Callable[..., Problem]
) -> None:
    base = made((), tuple(each**0.5 for each in AREAS))
    off, effect = miss(pocket(base, area, AREAS, LID), made((), (area**0.5,), THIN, area), base)
    print(f"bubble over {area:g} of the lid, within a ring: {effect:.2f} of Z, off by {off:.2g}")
    # Spread over its ring, a patch without pressure is elsewhere than the disc that ends within it: on flanks of a
    # resonance, a wide ring is a search's first step.
    assert off < tolerance


@pytest.mark.parametrize("depth", [0.0, 0.3, 0.5])
def test_a_cylinder_between_rigid_walls_has_its_modes_below_the_surface(
    depth: float, made: Callable[..., Problem], rows: Callable[..., NDArray[np.int64]]
) -> None:
    model = pocket(made((0.3, 0.5)), depth, (0.3, 0.5))
    operators = assemble(model.mesh, model.terms)
    own = rows(operators, "cavity", "p")
    inertia, compliance = (operators.matrix(np.array([
        g.constant(model.values) if isinstance(g, Monomial | Formula) and g.omega_power == power else 0.0
        for g in (integral.coefficient for integral in operators.integrals)])).real.tocsc()[own][:, own]
        for power in (-2, 0))
    found = np.sqrt(eigsh(inertia, k=5, M=-compliance, sigma=(2e6 * np.pi) ** 2 / 4.0, return_eigenvectors=False))
    water = model.materials["cavity"]
    assert isinstance(water, Fluid)
    up = (np.arange(4) + 0.5) / (1.0 - depth) if depth else np.arange(4)
    along = np.array([0.0, *jn_zeros(1, 4)]) / RADIUS
    expected = water.sound_speed * np.hypot(np.pi * up[:, None] / HEIGHT, along).ravel()
    for each in found[found > 1.0]:
        off = np.abs(expected / each - 1.0).min()
        print(f"empty down to {depth:g}: {each / 2e3 / np.pi:.1f} kHz, off by {off:.1g}")
        # Elements of order two, eight to a wavelength of the shear waves in the solids.
        assert off < 2e-3


def test_what_is_left_of_the_liquid_above_the_surface_does_not_matter(
    made: Callable[..., Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    base = made((0.3,))
    model = pocket(base, 0.3, (0.3,))
    full, found = impedance(base), impedance(model)
    monkeypatch.setattr(gas_pocket, "LIQUID_FLOOR", 10.0 * LIQUID_FLOOR)
    changed = np.abs(impedance(model) - found).max() / np.abs(found - full).max()
    print(f"left, ten times: off by {changed:.2g}")
    assert 0.0 < changed < 2e-3
