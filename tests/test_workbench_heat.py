"""Heat conduction against closed forms, and the temperatures of a chip against its own balance of power."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import scipy.sparse.linalg
import scipy.special
from numpy.typing import NDArray

import workbench as wb
from geometry.chip import Chip, parse_chip
from geometry.mesh import SectionMesh, mesh_section
from geometry.mesh_size import MeshSize
from geometry.section import cut_section
from materials.kinds import Fluid, IsotropicSolid
from materials.registry import Registry
from tests.support import quadratic
from workbench.acoustics.conduction import Conduction, ThermalConstants, boundary_place, conduction
from workbench.acoustics.fields import section_nodes
from workbench.acoustics.heat import check_peclet, conducted_heat, conduction_of, peclet_number, thermal_influence
from workbench.acoustics.heat_source import heat_source
from workbench.acoustics.nodal import integrate
from workbench.fem.level import impedance_level
from workbench.fem.linearised import FullSystem
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.places import place_of
from workbench.fem.solve import Solution, solve_full
from workbench.files.errors import InputError
from workbench.model.problem import Problem, build, fill
from workbench.physics.term import Integral, Monomial
from workbench.reduced.at_point import reduced
from workbench.simulation.heating import softening_words
from workbench.simulation.run import loss_budget

Real = NDArray[np.float64]

RADIUS, THICKNESS = 3e-3, 2e-3
#: PZT-like numbers.
CONSTANTS = ThermalConstants(conductivity=1.2, density=7500.0, heat_capacity=420.0)
SIDE, TOP, BOTTOM = "side", "top", "bottom"


def chip_of(*layers: Mapping[str, str], **content: Any) -> Chip:
    return parse_chip({"chip": {"name": "test", "band": ["300 kHz", "600 kHz"]}, "layers": list(layers), **content},
                      source="test")


def disc(radius: float = RADIUS, thickness: float = THICKNESS) -> Chip:
    return chip_of({"role": "transducer", "material": "pzt4/comsol_nominal", "thickness": f"{1e3 * thickness} mm",
                    "radius": f"{1e3 * radius} mm"})


def disc_mesh(order: int, elements: float, *, radius: float = RADIUS, thickness: float = THICKNESS) -> SectionMesh:
    """Cells of a disc of `elements` per millimetre, with its faces and its side named apart."""
    size = MeshSize({"transducer": 1e3}, 1e6 * elements, order=order, elements_per_wavelength=1.0)
    mesh = mesh_section(cut_section(disc(radius, thickness)), size)
    facets = mesh.mesh.boundaries["transducer|outside"]
    r, z = mesh.mesh.p[:, mesh.mesh.facets[:, facets]]
    parts = {SIDE: (r > (1.0 - 1e-9) * radius).all(axis=0), TOP: (z > (1.0 - 1e-9) * thickness).all(axis=0),
             BOTTOM: (z < 1e-9 * thickness).all(axis=0)}
    boundaries = {**mesh.mesh.boundaries, **{name: facets[there] for name, there in parts.items()}}
    # Set directly: the names are none of a section's.
    mesh.mesh._boundaries = boundaries
    return mesh


def cooled(mesh: SectionMesh, cooling: Mapping[str, float], *, held: Mapping[str, float] | None = None) -> Conduction:
    """Conduction in a disc, cooled on named parts of its surface."""
    found = conduction(mesh, {"transducer": CONSTANTS}, cooling={"": 1.0}, holders=held)
    return replace(found, cooling=dict(cooling), walls={name: boundary_place(mesh, name) for name in cooling})


def load_of(mesh: SectionMesh, density: Callable[[Real, Real], Real]) -> Real:
    """The load (N,) W of a source of `density` (W/m^3) at r and z."""
    place = place_of(mesh, Integral(Monomial(1.0, 0), "transducer", ()))
    assert place is not None
    nodes, dofs = section_nodes(mesh)
    at = np.zeros(dofs.max() + 1)
    at[dofs] = nodes.points[:, 1]
    z = np.einsum("eqi,ie->eq", place.shapes["value"], at[place.dofs])
    return np.asarray(np.bincount(place.dofs.ravel(), minlength=at.size, weights=np.einsum(
        "eqi,eq->ie", place.shapes["value"], place.weights * density(place.radius, z)).ravel()), dtype=float)


def places(mesh: SectionMesh, size: int) -> tuple[Real, Real]:
    nodes, dofs = section_nodes(mesh)
    r, z = np.zeros((2, size))
    r[dofs], z[dofs] = nodes.points.T
    return r, z


# Closed forms ---------------------------------------------------------------------------------------------------------


def test_a_plate_with_an_even_source_has_a_parabola() -> None:
    # k T'' = -q, k T' = h T below, -k T' = h T above; the side is insulated, so that nothing depends on r.
    mesh, source, h = disc_mesh(4, 1.0), 2e6, 12.0
    model = cooled(mesh, {TOP: h, BOTTOM: h})
    found = model.temperature(load_of(mesh, lambda r, z: source + 0.0 * r))
    _, z = places(mesh, model.size)
    expected = source * THICKNESS / (2.0 * h) + source * z * (THICKNESS - z) / (2.0 * CONSTANTS.conductivity)
    error = np.abs(found / expected - 1.0).max()
    print(f"plate: {error:.1e}")
    assert error < 1e-8  # a polynomial of the elements' order: rounding alone


def test_a_plate_on_a_holder_warms_from_the_holder() -> None:
    mesh, source, h, holder = disc_mesh(4, 1.0), 2e6, 12.0, 5.0
    model = cooled(mesh, {TOP: h}, held={BOTTOM: holder})
    load = load_of(mesh, lambda r, z: source + 0.0 * r)
    found = model.temperature(load)
    _, z = places(mesh, model.size)
    k, d = CONSTANTS.conductivity, THICKNESS
    # T = T_b + a z - q z^2 / 2k, and -k T'(d) = h T(d).
    a = (source * d + h * (source * d**2 / (2.0 * k) - holder)) / (k + h * d)
    expected = holder + a * z - source * z**2 / (2.0 * k)
    assert np.abs(found / expected - 1.0).max() < 1e-8
    by_boundary, into_holder = model.leaving(found, load)
    assert by_boundary[TOP] == pytest.approx(h * math.pi * RADIUS**2 * expected[np.argmax(z)], rel=1e-9)
    assert into_holder == pytest.approx(k * a * math.pi * RADIUS**2, rel=1e-9)


def test_a_cylinder_with_a_radial_source_has_the_closed_form() -> None:
    # q = q0 (r / R)^2: T = q0 R / 4h + q0 R^2 / 16k (1 - (r / R)^4), of fourth order in r.
    mesh, source, h = disc_mesh(4, 1.0), 3e6, 20.0
    model = cooled(mesh, {SIDE: h})
    found = model.temperature(load_of(mesh, lambda r, z: source * (r / RADIUS) ** 2))
    r, _ = places(mesh, model.size)
    expected = (source * RADIUS / (4.0 * h)
                + source * RADIUS**2 / (16.0 * CONSTANTS.conductivity) * (1.0 - (r / RADIUS) ** 4))
    error = np.abs(found / expected - 1.0).max()
    print(f"cylinder: {error:.1e}")
    assert error < 1e-8


@pytest.mark.parametrize("biot", [1e-3, 1e-2])
def test_a_fin_follows_the_law_of_rods_up_to_its_biot_number(biot: float) -> None:
    # A rod at 1 K at its foot, cooled along its side, insulated at its end: cosh m(L - z) / cosh mL, m^2 = 2h / kR. The
    # law leaves out the drop of temperature from axis to side, whose share is h R / 2k = Bi / 2.
    radius, length = 1e-3, 10e-3
    h = biot * CONSTANTS.conductivity / radius
    mesh = disc_mesh(4, 1.0, radius=radius, thickness=length)
    model = cooled(mesh, {SIDE: h}, held={BOTTOM: 1.0})
    found = model.temperature(np.zeros(model.size))
    _, z = places(mesh, model.size)
    m = math.sqrt(2.0 * h / (CONSTANTS.conductivity * radius))
    law = np.cosh(m * (length - z)) / math.cosh(m * length)
    error = np.abs(found / law - 1.0).max()
    print(f"fin, Bi {biot:g}: {error / biot:.3f} Bi")
    # Two-sided: the difference is the one that the law leaves out, not the mesh's.
    assert 0.1 * biot < error < 0.5 * biot


def eigenvalue(function: Callable[[float], float], low: float, high: float) -> float:
    return float(scipy.optimize.brentq(function, low, high, xtol=1e-14))


def test_the_slowest_time_of_a_slab_and_of_a_cylinder() -> None:
    # x tan x = h d / 2k of half a slab, and x J1(x) = h R / k J0(x) of a cylinder: Carslaw and Jaeger, 3.11 and 7.8.
    h = 500.0
    k, diffusivity = CONSTANTS.conductivity, CONSTANTS.diffusivity
    mesh = disc_mesh(4, 1.0)
    half = 0.5 * THICKNESS
    slab = eigenvalue(lambda x: x * math.sin(x) - h * half / k * math.cos(x), 1e-6, 0.5 * math.pi)
    found = cooled(mesh, {TOP: h, BOTTOM: h}).slowest_time()
    assert found == pytest.approx(half**2 / (diffusivity * slab**2), rel=1e-8)
    first = eigenvalue(lambda x: x * scipy.special.j1(x) - h * RADIUS / k * scipy.special.j0(x), 1e-6, 2.4)
    found = cooled(mesh, {SIDE: h}).slowest_time()
    # An eigenvalue has twice the order of the elements; cells of a millimetre leave 1e-11.
    assert found == pytest.approx(RADIUS**2 / (diffusivity * first**2), rel=1e-8)


def test_the_error_falls_with_the_order_of_the_elements() -> None:
    # A source that is no polynomial: k T'' = -q0 cos(pi z / d), T = q0 d^2 / (pi^2 k) cos(pi z / d) + 0 at mid-height.
    source, k = 1e6, CONSTANTS.conductivity
    for order in (2, 3):
        errors = []
        for elements in (1.0, 2.0, 4.0):
            mesh = disc_mesh(order, elements)
            model = cooled(mesh, {}, held={BOTTOM: source * THICKNESS**2 / (math.pi**2 * k)})
            load = load_of(mesh, lambda r, z: source * np.cos(math.pi * z / THICKNESS))
            _, z = places(mesh, model.size)
            expected = source * THICKNESS**2 / (math.pi**2 * k) * np.cos(math.pi * z / THICKNESS)
            difference = model.temperature(load) - expected
            errors.append(math.sqrt(difference @ (model.capacity @ difference)))
        observed = np.log2(np.array(errors[:-1]) / errors[1:])
        print(f"order {order}: observed {observed}")
        # Nodal values are of two orders more than the elements' own: superconvergence at Gauss-Lobatto points.
        assert order + 1.8 < observed[-1] < order + 2.2


def test_heat_needs_a_way_out() -> None:
    mesh = disc_mesh(2, 1.0)
    for cooling, words in (({"": 0.0}, "a heat transfer coefficient above"), ({"": -1.0}, "0 W/\\(m\\^2 K\\) or more"),
                           ({"transduce|outside": 1.0}, "did you mean 'transducer|outside'")):
        with pytest.raises(InputError, match=words.replace("|", "\\|")):
            conduction(mesh, {"transducer": CONSTANTS}, cooling=cooling)
    with pytest.raises(InputError, match=r"holder: received 'tp'; expected one of .*top"):
        conduction(mesh, {"transducer": CONSTANTS}, cooling={"": 1.0}, holders={"tp": 0.0})


# A chip ---------------------------------------------------------------------------------------------------------------

FREQUENCY = 480e3


def cell(cavity: str = "water") -> Chip:
    def layer(role: str, material: str, thickness: str, **more: str) -> dict[str, str]:
        return {"role": role, "material": material, "thickness": thickness, "radius": "3 mm", **more}

    return chip_of(
        layer("transducer", "pzt4/acevedo_2026_initial", "2 mm"), layer("substrate", "pla", "0.85 mm"),
        layer("sidewall", "pla", "0.72 mm", cavity_radius="1.5 mm"), layer("superstrate", "pmma", "1 mm"),
        states={"filled": {"cavity": cavity}})


@cache
def solved(cavity: str = "water") -> tuple[Problem, FullOperators, Solution]:
    problem = build(fill(cell(cavity), "filled", Registry()), accuracy=quadratic(6.0))
    operators = assemble(problem.mesh, problem.terms)
    return problem, operators, solve_full(operators, np.array([FREQUENCY]), problem.values)


def test_the_source_is_the_electrical_power_place_by_place() -> None:
    _, operators, solution = solved()
    source = heat_source(solution, 5.0)
    losses, _ = loss_budget(solution, 5.0)
    assert set(source.loads) == set(losses)
    for place, load in source.loads.items():
        assert load.sum() == pytest.approx(losses[place], rel=1e-10)
    assert source.power == pytest.approx(25.0 * float(solution.input_power()[0]), rel=1e-10)
    # The boundary layer's heat counts for the water, and lies on the nodes of the wall.
    wall = next(place for place in source.loads if place.startswith("cavity|"))
    assert source.owner[wall] == "cavity"
    assert set(np.flatnonzero(source.loads[wall])) <= set(np.unique(operators.places[wall].dofs))
    assert sum(source.released(region) for region in set(source.owner.values())) == pytest.approx(source.power)


@pytest.mark.parametrize("holder", [None, "transducer|outside"])
def test_the_balance_of_power_closes(holder: str | None) -> None:
    problem, _, solution = solved()
    found = conducted_heat(problem, solution, 5.0, holder=holder)
    assert found.released == pytest.approx(found.power, rel=1e-10)
    assert found.closure < 1e-10
    assert sum(found.convected.values()) + found.into_holder == pytest.approx(found.power, rel=1e-9)
    assert (found.into_holder > 0.0) == (holder is not None)
    # By the outside of the chip, from the temperatures themselves.
    top = float(boundary_mean(problem, found.mesh, found.rise, "superstrate"))
    assert found.convected["superstrate|outside"] == pytest.approx(10.0 * top, rel=1e-9)


def boundary_mean(problem: Problem, mesh: Any, rise: Real, region: str) -> float:
    """Integral (K m^2) of the temperature over the outside of a region."""
    place = boundary_place(problem.mesh, f"{region}|outside")
    _, dofs = section_nodes(problem.mesh)
    at = np.zeros(dofs.max() + 1)
    at[dofs] = rise
    return float(np.sum(np.einsum("eqi,ie->eq", place.shapes["value"], at[place.dofs]) * place.weights))


def test_a_doubled_drive_gives_four_times_the_temperature() -> None:
    problem, _, solution = solved()
    once, twice = (conducted_heat(problem, solution, voltage) for voltage in (5.0, 10.0))
    np.testing.assert_allclose(twice.rise, 4.0 * once.rise, rtol=1e-9)
    assert twice.peak_resistance == pytest.approx(once.peak_resistance)
    assert twice.time_constant == pytest.approx(once.time_constant)
    assert {name: part.resistance for name, part in twice.parts.items()} == pytest.approx(
        {name: part.resistance for name, part in once.parts.items()})


def test_the_parts_of_a_chip_agree_with_its_temperature_field() -> None:
    problem, _, solution = solved()
    found = conducted_heat(problem, solution, 5.0)
    losses, _ = loss_budget(solution, 5.0)
    one = np.ones(len(found.rise))
    for region, part in found.parts.items():
        volume = float(integrate(found.mesh, one, [region]))
        # The rule at the nodes integrates the interpolant of r T, and the elements' own rule r T itself.
        assert part.mean == pytest.approx(float(integrate(found.mesh, found.rise, [region])) / volume, rel=1e-4)
        assert part.peak == found.rise[found.mesh.nodes_of([region])].max()
        material = problem.materials[region]
        assert material.heat_capacity is not None
        assert part.capacity == pytest.approx(volume * material.density * material.heat_capacity, rel=1e-9)
        assert part.resistance * found.power == pytest.approx(part.mean, rel=1e-9)
        # q / (rho c): its losses over its capacity.
        lost = sum(power for place, power in losses.items() if place == region or
                   (region == "cavity" and place.startswith("cavity|")))
        assert part.initial_rate == pytest.approx(lost / part.capacity, rel=1e-9, abs=1e-300)
    assert found.peak == found.rise.max()
    assert found.initial_rate == pytest.approx(found.power / sum(part.capacity for part in found.parts.values()))


def test_the_rate_at_switch_on_is_the_loss_over_the_capacity() -> None:
    # Before conduction begins, C dT/dt = f: q / (rho c) at every node of one part, and the whole loss over the whole
    # capacity in the mean over a chip.
    mesh, source = disc_mesh(4, 1.0), 2e6
    alone = cooled(mesh, {SIDE: 10.0})
    rate = scipy.sparse.linalg.spsolve(alone.capacity.tocsc(), load_of(mesh, lambda r, z: source + 0.0 * r))
    assert np.abs(rate * CONSTANTS.volumetric / source - 1.0).max() < 1e-10
    problem, _, solution = solved()
    found, (model, _) = conducted_heat(problem, solution, 5.0), conduction_of(problem)
    everywhere = np.zeros(model.size)
    everywhere[model.nodes] = 1.0
    rate = heat_source(solution, 5.0).load.sum() / (everywhere @ (model.capacity @ everywhere))
    assert found.initial_rate == pytest.approx(rate, rel=1e-10)


def test_the_influence_of_the_losses_adds_up_to_the_temperature() -> None:
    problem, _, solution = solved()
    found = conducted_heat(problem, solution, 5.0)
    losses, _ = loss_budget(solution, 5.0)
    for part in ("cavity", "superstrate"):
        resistances = thermal_influence(problem, solution, part=part)
        assert sum(resistances[place] * power for place, power in losses.items()) == pytest.approx(
            found.parts[part].mean, rel=1e-9)
    # A part that loses nothing is warmed evenly; interfaces have resistances too.
    even = thermal_influence(problem, part="cavity")
    assert set(even) >= {*problem.mesh.section.regions, "substrate|transducer"}
    assert even["cavity"] > even["transducer"] > 0.0
    with pytest.raises(InputError, match="did you mean 'cavity'"):
        thermal_influence(problem, part="cavty")


def test_an_empty_cavity_conducts_as_air_or_is_insulated() -> None:
    problem, _, solution = solved("vacuum")
    air = conducted_heat(problem, solution, 5.0)
    assert "cavity is empty and conducts heat as air/us_standard_1976" in air.notes[0]
    none = conducted_heat(problem, solution, 5.0, empty=None)
    assert "insulated" in none.notes[0]
    assert "cavity" in air.parts
    assert "cavity" not in none.parts
    inside = none.mesh.nodes_of(["cavity"])
    walls = np.isfinite(none.rise[inside])
    assert walls.any()
    assert not walls.all()
    # A further way for the heat lowers the temperature weighted with the losses (Rayleigh's principle), here a little.
    load = heat_source(solution, 5.0).load
    by_air, by_none = (load @ np.nan_to_num(conduction_of(problem, empty=empty)[0].temperature(load))
                       for empty in ("air", None))
    assert 0.95 * by_none < by_air < by_none
    assert max(air.closure, none.closure) < 1e-10


def test_a_holder_that_is_warm_warms_a_chip_that_loses_nothing_there() -> None:
    problem, _, solution = solved()
    cold = conducted_heat(problem, solution, 5.0, holder="transducer|outside")
    warm = conducted_heat(problem, solution, 5.0, holder={"transducer|outside": 7.0})
    # Resistances are by the power of the chip alone.
    assert warm.parts["cavity"].resistance == pytest.approx(cold.parts["cavity"].resistance, rel=1e-9)
    assert cold.parts["cavity"].mean < warm.parts["cavity"].mean < cold.parts["cavity"].mean + 7.0
    assert warm.closure < 1e-10
    resistances = [thermal_influence(problem, solution, part="cavity", holder={"transducer|outside": rise})
                   for rise in (0.0, 7.0)]
    assert resistances[0] == pytest.approx(resistances[1])
    # What the holder covers loses nothing to the air.
    assert "transducer|outside" not in warm.convected


# What is refused ------------------------------------------------------------------------------------------------------


def test_a_material_without_thermal_constants_is_refused_only_for_heat() -> None:
    problem, _, solution = solved()
    lid = problem.materials["superstrate"]
    assert isinstance(lid, IsotropicSolid)
    bare = replace(problem, materials={**problem.materials, "superstrate": replace(lid, thermal_conductivity=None)})
    assert assemble(bare.mesh, bare.terms).size == assemble(problem.mesh, problem.terms).size
    with pytest.raises(InputError, match=r"material pmma/acevedo_2026: thermal_conductivity: missing; expected a "
                       r"number in W/\(m K\).*did you mean 'pmma/"):
        conducted_heat(bare, solution, 5.0)
    strange = replace(lid, name="zzz/zzz", heat_capacity=None)
    with pytest.raises(InputError, match=r"material zzz/zzz: heat_capacity.*did you mean '"):
        conducted_heat(replace(problem, materials={**problem.materials, "superstrate": strange}), solution, 5.0)


def test_a_reduced_solution_and_a_chip_without_losses_are_refused() -> None:
    problem, operators, solution = solved()
    _, small = reduced(operators, np.linspace(470e3, 490e3, 5), problem.values, tolerance=1e-2)
    with pytest.raises(InputError, match="a reduced one has no cells"):
        heat_source(small, 1.0)
    with pytest.raises(InputError, match="a solution at one frequency"):
        heat_source(solve_full(operators, np.array([470e3, 480e3]), problem.values), 1.0)
    with pytest.raises(InputError, match="a chip that loses power"):
        conducted_heat(problem, solution, 0.0)


def test_conduction_is_refused_above_a_peclet_number_of_one() -> None:
    water = Registry().load("water")
    assert isinstance(water, Fluid)
    # 0.6065 / (997.05 x 4181.5) = 1.455e-7 m^2/s.
    assert peclet_number(water, 1e-4, 1e-3) == pytest.approx(1e-7 / 1.4548e-7, rel=1e-3)
    assert check_peclet(water, 1e-4, 1e-3) < 1.0
    with pytest.raises(InputError, match=r"speed of the flow: received '0.001 m/s'; expected at most 0.000145 m/s in "
                       r"water/iapws_2011 across 1 mm: the Peclet number is 6.87"):
        check_peclet(water, 1e-3, 1e-3)


# A simulation ---------------------------------------------------------------------------------------------------------


#: About the lowest radial resonance of the chip, which the water beside its axis moves little.
BAND = (340e3, 385e3)


@pytest.fixture(scope="module")
def run() -> wb.Simulation:
    return wb.simulate(cell(), "filled", points=41, band=BAND, accuracy=quadratic(6.0))


def test_a_simulation_is_heated_and_its_liquid_warmed(run: wb.Simulation) -> None:
    heat = wb.heating(run)
    assert heat.frequency == run.fields.frequency
    assert heat.power == pytest.approx(run.fields.power, rel=1e-9)
    assert "10 Vpp at the electrodes" in str(heat)
    shot = wb.snapshot(cell(), "filled", run.fields.frequency, band=BAND, accuracy=quadratic(6.0))
    np.testing.assert_allclose(wb.heating(shot).rise, heat.rise, rtol=1e-6)
    with pytest.raises(InputError, match="speed of the flow"):
        wb.heating(run, flow_speed=1e-3)
    assert wb.heating(run, flow_speed=1e-6).peak == heat.peak
    with pytest.raises(InputError, match=r"flow_speed: received -1\.0; expected a speed in m/s of 0 or more"):
        wb.heating(run, flow_speed=-1.0)
    with pytest.raises(InputError, match=r"holder: received 'cavity\|substrate'; expected .*\|outside") as caught:
        wb.heating(run, holder="cavity|substrate")
    assert "electrode" not in caught.value.expected
    warm = wb.liquid_warming(run, heat)
    assert warm.rise == heat.parts["cavity"].mean
    # Marczak 1997 at 25 degC: 2.68 m/s a kelvin; Kell 1975: 2.57e-4 1/K.
    assert warm.speed_slope == pytest.approx(2.68, rel=0.02)
    assert warm.thermal_expansion == pytest.approx(2.57e-4, rel=0.01)
    assert wb.liquid_warming(shot, heat).resonance_slope is None


def test_a_polymer_that_becomes_too_warm_is_named_with_the_largest_voltage(run: wb.Simulation) -> None:
    heat, stated = wb.heating(run), run.problem.materials["cavity"]
    region, solid = next((region, each) for region, each in run.problem.materials.items()
                         if isinstance(each, IsotropicSolid))
    assert isinstance(stated, Fluid)
    assert stated.temperature is not None

    def said(share: float) -> str:
        limit = stated.temperature + share * heat.parts[region].peak
        materials = {**run.problem.materials, region: replace(solid, softening_temperature=limit)}
        return " ".join(softening_words(replace(run, problem=replace(run.problem, materials=materials)), heat))

    assert f"The {region} becomes" not in said(1.01)
    # Temperatures go with the square of the voltage.
    voltage = 2.0 * abs(run.fields.voltage)
    assert f"The {region} becomes" in said(0.25)
    assert f"up to about {0.5 * voltage:.2g} Vpp" in said(0.25)


def test_the_shift_of_the_resonance_is_that_of_warmer_water(run: wb.Simulation) -> None:
    warm = wb.liquid_warming(run, wb.heating(run))
    assert warm.resonance is not None
    found = []
    for offset in (-1.0, 1.0):
        water = Registry().load("water", temperature=298.15 + offset)
        assert isinstance(water, Fluid)
        values = {**run.problem.values, f"{water.name}.sound_speed": water.sound_speed,
                  f"{water.name}.density": water.density}
        system, frequency = FullSystem(run.operators, values), warm.resonance
        for _ in range(6):
            state = system.linearised(frequency)
            level = impedance_level(state)
            frequency -= level.slope / level.curvature
        found.append(frequency)
    print(f"d f0 / dT {warm.resonance_slope:.4f} Hz/K, by difference {0.5 * (found[1] - found[0]):.4f}")
    # The difference quotient over 2 K; the law of the registry is taken over 10 K, and bends by 1e-3 of its slope.
    assert warm.resonance_slope == pytest.approx(0.5 * (found[1] - found[0]), rel=5e-3)
    assert warm.resonance_shift == pytest.approx(warm.resonance_slope * warm.rise)


def test_liquid_warming_needs_a_liquid_and_a_law() -> None:
    empty = wb.snapshot(cell("vacuum"), "filled", FREQUENCY, accuracy=quadratic(4.0))
    with pytest.raises(InputError, match="a state with a fluid in the cavity"):
        wb.liquid_warming(empty, wb.heating(empty))
    thick = wb.snapshot(cell("coupling_gel"), "filled", FREQUENCY, accuracy=quadratic(4.0))
    found = wb.liquid_warming(thick, wb.heating(thick))
    assert found.rise > 0.0
    assert (found.speed_slope, found.resonance_shift) == (None, None)
    with pytest.raises(InputError, match=r"heat: received 'temperatures .*'; expected wb\.heating of this result"):
        wb.liquid_warming(thick, wb.heating(empty))
    fine = wb.snapshot(cell("coupling_gel"), "filled", FREQUENCY, accuracy=quadratic(5.0))
    with pytest.raises(InputError, match="heat: received 'temperatures on another mesh'"):
        wb.liquid_warming(thick, wb.heating(fine))
    heat = wb.heating(thick)
    lighter = replace(heat.parts["cavity"], capacity=0.9 * heat.parts["cavity"].capacity)
    with pytest.raises(InputError, match="heat: received 'temperatures of another cavity'"):
        wb.liquid_warming(thick, replace(heat, parts={**heat.parts, "cavity": lighter}))
