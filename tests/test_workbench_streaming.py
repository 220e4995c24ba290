"""The streaming of a simulated chip: what it is made of, what it states, and what it refuses."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import workbench as wb
from geometry.chip import parse_chip
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.acoustics.flow_forces import TemperatureSlopes
from workbench.acoustics.nodal import borders, edge_nodes, integrate, interpolate
from workbench.acoustics.streaming import Streaming, acoustic_streaming, critical_diameter
from workbench.fem.elements import lobatto_weights
from workbench.model.discretisation import Discretisation
from workbench.model.particles import drag_coefficient
from workbench.render.sections import draw_streaming
from workbench.simulation.run import Snapshot
from workbench.simulation.streaming import slopes_of


def shot_of(cavity: str = "water", **state: str) -> Snapshot:
    def layer(role: str, material: str, thickness: str, **more: str) -> dict[str, str]:
        return {"role": role, "material": material, "thickness": thickness, "radius": "3 mm", **more}

    chip = parse_chip({"chip": {"name": "small", "band": ["300 kHz", "600 kHz"]}, "layers": [
        layer("transducer", "pzt4/acevedo_2026_initial", "2 mm"), layer("substrate", "pla", "0.85 mm"),
        layer("sidewall", "pla", "0.72 mm", cavity_radius="1.5 mm"), layer("superstrate", "pmma", "1 mm")],
        "states": {"filled": {"cavity": cavity, **state}}}, source="test")
    return wb.snapshot(chip, "filled", 480e3, accuracy=Discretisation(4, 3.0, corner_refinement=0.1, growth=3.0))


@pytest.fixture(scope="module")
def shot() -> Snapshot:
    return shot_of(particle="polystyrene", particle_radius="5 um")


@pytest.fixture(scope="module")
def flow(shot: Snapshot) -> Streaming:
    return wb.streaming(shot)


def test_nothing_flows_out_and_nothing_is_lost(flow: Streaming) -> None:
    assert flow.net_flux < 1e-10
    points, u = flow.mesh.points, flow.carrier_velocity
    low, high = points.min(axis=0), points.max(axis=0)
    largest = flow.largest_speed
    for across, walls in ((1, [points[:, 1] == low[1], points[:, 1] == high[1]]), (0, [points[:, 0] == high[0]])):
        for wall in walls:
            assert wall.sum() > 5
            assert np.abs(u[wall, across]).max() < 1e-12 * largest
    assert np.abs(u[points[:, 0] == 0.0, 0]).max() == 0.0
    # As much goes inwards as outwards through every line of cells, and as much up as down.
    weights = lobatto_weights(flow.mesh.order)
    for axis in (0, 1):
        for line in flow.mesh.lines[axis][1:-1]:
            _, edge = borders(flow.mesh, (flow.mesh.boxes[0][:, axis] >= line - 1e-9).astype(np.int64))[2 * axis]
            edge = edge[np.abs(flow.mesh.boxes[0][edge, axis] - line) < 1e-9]
            nodes = edge_nodes(flow.mesh, 2 * axis, edge)
            length = (flow.mesh.boxes[1] - flow.mesh.boxes[0])[edge, 1 - axis]
            measure = length[:, None] * weights * points[nodes, 0]
            through = float((measure * u[nodes, axis]).sum())
            assert abs(through) < 1e-10 * float((measure * np.abs(u[nodes, axis])).sum())


def test_the_causes_add_up(flow: Streaming) -> None:
    assert set(flow.causes) == {"walls", "absorption"}
    np.testing.assert_allclose(sum(flow.causes.values()), flow.carrier_velocity, atol=1e-15)
    np.testing.assert_allclose(flow.velocity + flow.drift, flow.carrier_velocity, atol=1e-15)
    assert 0.0 < flow.rms_speed < flow.largest_speed
    assert flow.assumptions == ("The temperature is assumed uniform: no force of sound or gravity on warmer liquid.",)


def test_the_slip_is_that_of_the_flow_at_the_walls(flow: Streaming) -> None:
    assert {each.solid for each in flow.slips} == {"substrate", "sidewall", "superstrate"}
    (floor,) = [each for each in flow.slips if each.solid == "substrate"]
    inner = floor.points[:, :, 0] < 1.2e-3
    np.testing.assert_allclose(flow.velocity[floor.nodes][inner][:, 0],
                               (floor.speed[:, :, None] * floor.tangent)[inner][:, 0], atol=0.02 * floor.largest)


def test_speed_grows_with_the_square_of_the_voltage(shot: Snapshot, flow: Streaming) -> None:
    fields = shot.fields
    doubled = replace(shot, fields=replace(
        fields, pressure=2.0 * fields.pressure, velocity=2.0 * fields.velocity, displacement=2.0 * fields.displacement))
    np.testing.assert_allclose(wb.streaming(doubled).velocity, 4.0 * flow.velocity, rtol=1e-9,
                               atol=1e-9 * flow.largest_speed)


def test_a_higher_order_hardly_changes_the_flow(shot: Snapshot, flow: Streaming) -> None:
    finer = wb.streaming(shot, order=6)
    assert finer.mesh.order == 6
    difference = finer.carried_on(flow.mesh) - flow.carrier_velocity
    # Observed 0.4 %, most of it at the corners.
    assert flow.rms_of(difference) < 0.01 * flow.rms_speed
    assert shot.traps is not None
    assert flow.carried_on(shot.traps.forces.mesh).shape == shot.traps.forces.force.shape


def test_the_peclet_number_is_that_of_heat_over_the_height(flow: Streaming) -> None:
    water = flow.fluid
    assert water.thermal_conductivity
    assert water.heat_capacity
    diffusivity = water.thermal_conductivity / (water.density * water.heat_capacity)
    assert diffusivity == pytest.approx(1.46e-7, rel=0.01)
    assert flow.peclet == pytest.approx(flow.largest_speed * 0.72e-3 / diffusivity, rel=1e-9)
    assert f"Peclet number {flow.peclet:.2g}" in str(flow)
    assert replace(flow, fluid=replace(water, thermal_conductivity=None)).peclet is None


def test_critical_diameters_are_those_of_each_direction_and_of_the_flow() -> None:
    """Levitation and the way along the plane of a flat cavity have different ones, and heat makes the second grow."""
    chip = wb.read_chip(Path(__file__).parent.parent / "geometry" / "chips" / "acevedo_2026_chip.toml")
    shot = wb.snapshot(chip, "filled", 1.03048e6, drive=wb.parse_drive("1.447 Vpp"), accuracy=2e-2)
    warm, cold = wb.liquid_motion(shot).streaming, wb.streaming(shot)
    assert warm is not None
    # At 15 J/m^3 a bead of 10 um drifts along the plane about as fast as the liquid.
    assert warm.critical_diameters["radial"] == pytest.approx(10e-6, rel=0.15)
    assert warm.critical_diameter == warm.critical_diameters["radial"]
    assert cold.critical_diameters["radial"] < 0.6 * warm.critical_diameters["radial"]
    assert warm.critical_diameters["axial"] < 3e-6
    # At that diameter the rms speeds are equal: of twice the bead that of radiation is four times that of the flow.
    assert shot.traps is not None
    forces = shot.traps.forces
    lifted = forces.force[:, 1] / drag_coefficient(forces.particle, forces.fluid)
    carried = warm.carried_on(forces.mesh)[:, 1]
    one = np.ones(len(lifted))
    ratio = math.sqrt(integrate(forces.mesh, lifted**2, ["cavity"]) / integrate(forces.mesh, carried**2, ["cavity"]))
    assert integrate(forces.mesh, one, ["cavity"]) > 0.0
    # The dipole depends a little on the size, in its layer.
    assert warm.critical_diameters["axial"] == pytest.approx(10e-6 / math.sqrt(ratio), rel=0.05)


def test_the_critical_bead_of_water(flow: Streaming) -> None:
    """1.98 um at 1.97 MHz, polystyrene in water of 25 degC (about 2 um was published)."""
    water = Fluid(name="water", density=997.0, sound_speed=1497.0, shear_viscosity=0.89e-3)
    assert critical_diameter(0.16493, water, 1.97e6) == pytest.approx(1.98e-6, rel=3e-3)
    assert critical_diameter(0.16493, water, 1.97e6, slip=1.5) == pytest.approx(2.0 * 1.98e-6, rel=3e-3)
    assert flow.critical_diameter is not None
    # Phi is 0.166 for 10 um here.
    assert flow.critical_diameter == pytest.approx(critical_diameter(0.166, flow.fluid, 480e3), rel=0.01)
    with pytest.raises(wb.InputError, match=r"contrast_factor: received 0\.0"):
        critical_diameter(0.0, water, 1e6)


def test_warm_liquid_adds_a_flow(shot: Snapshot, flow: Streaming) -> None:
    mesh = shot.fields.mesh
    inside = mesh.nodes_of(["cavity"])
    warm = 1.0 - (mesh.points[inside, 0] / 1.5e-3)**2
    whole = np.full(len(mesh.points), np.nan)
    whole[inside] = warm
    found, same = (wb.streaming(shot, temperature=each) for each in (warm, whole))
    np.testing.assert_array_equal(found.velocity, same.velocity)
    np.testing.assert_allclose(found.causes["walls"], flow.causes["walls"], atol=1e-12 * flow.largest_speed)
    assert found.rms_of(found.causes["heat"]) > 0.0
    assert not found.assumptions
    # Without sound, warm liquid rises in the middle.
    silent = replace(shot.fields, pressure=0.0 * shot.fields.pressure, velocity=0.0 * shot.fields.velocity,
                     displacement=0.0 * shot.fields.displacement)
    buoyant = wb.streaming(replace(shot, fields=silent), temperature=warm)
    middle = np.array([[0.0, 2.85e-3 + 0.36e-3]])
    assert interpolate(buoyant.mesh, buoyant.carrier_velocity, middle, ["cavity"])[0, 1] > 0.0


def test_the_slopes_are_those_of_the_liquids_law(shot: Snapshot) -> None:
    water = shot.problem.materials["cavity"]
    assert isinstance(water, Fluid)
    found = slopes_of(water, Registry())
    # 25 degC: 2.68 m/s and -0.257 kg/m^3 per kelvin (IAPWS, Kell); warmer water expands more.
    assert found.sound_speed == pytest.approx(2.68, rel=0.02)
    assert found.density == pytest.approx(-0.257, rel=0.02)
    assert slopes_of(water, Registry(), warmer_by=20.0).density < found.density


def test_what_is_refused(shot: Snapshot) -> None:
    with pytest.raises(wb.InputError, match=r"temperature: received 'an array of shape \(3,\)'"):
        wb.streaming(shot, temperature=np.zeros(3))
    given: Any = 20.0
    with pytest.raises(wb.InputError, match=r"temperature: received 20\.0; expected kelvin above .*wb\.heating"):
        wb.streaming(shot, temperature=given)
    uneven = np.full(len(shot.fields.mesh.nodes_of(["cavity"])), np.nan)
    with pytest.raises(wb.InputError, match="values that are not finite"):
        wb.streaming(shot, temperature=uneven, slopes=TemperatureSlopes(density=-0.25, sound_speed=2.6))
    water = shot.problem.materials["cavity"]
    assert isinstance(water, Fluid)
    with pytest.raises(wb.InputError, match="shear_viscosity: missing"):
        acoustic_streaming(shot.fields, fluid=replace(water, shear_viscosity=None), region="cavity")
    with pytest.raises(wb.InputError, match="region: received 'substrate'; expected a region with a pressure: cavity"):
        acoustic_streaming(shot.fields, fluid=water, region="substrate")
    with pytest.raises(wb.InputError, match="law of temperature"):
        slopes_of(replace(water, temperature=None), Registry())
    with pytest.raises(wb.InputError, match="a state with a liquid in the cavity"):
        wb.streaming(shot_of("vacuum"))


def test_a_fluid_of_unknown_absorption_says_so(shot: Snapshot) -> None:
    water = shot.problem.materials["cavity"]
    assert isinstance(water, Fluid)
    found = acoustic_streaming(shot.fields, fluid=replace(water, bulk_viscosity=None), region="cavity")
    # That of the shear alone is known.
    assert set(found.causes) == {"walls", "absorption"}
    assert any("is a lower bound" in each for each in found.assumptions)


def test_a_surface_without_a_wall_is_taken_to_stay(shot: Snapshot) -> None:
    # The lid's motion is taken away, as if nothing were there.
    fields, mesh = shot.fields, shot.fields.mesh
    displacement = fields.displacement.copy()
    displacement[mesh.nodes_of(["superstrate"])] = np.nan
    water = shot.problem.materials["cavity"]
    assert isinstance(water, Fluid)
    found = acoustic_streaming(replace(fields, displacement=displacement), fluid=water, region="cavity")
    assert "superstrate" not in {each.solid for each in found.slips}
    assert any("between the cavity and superstrate" in each for each in found.assumptions)
    top = found.mesh.points[:, 1] == found.mesh.points[:, 1].max()
    assert np.abs(found.carrier_velocity[top, 1]).max() < 1e-12 * found.largest_speed
    assert np.abs(found.carrier_velocity[top, 0]).max() > 0.0
    assert found.net_flux < 1e-10


def test_a_picture_is_written(flow: Streaming, tmp_path: Path) -> None:
    path = draw_streaming(flow, tmp_path / "flow.png")
    assert path.stat().st_size > 10_000
    still = replace(flow, velocity=0.0 * flow.velocity, drift=0.0 * flow.drift)
    assert draw_streaming(still, tmp_path / "still.png").is_file()
    assert math.isfinite(still.rms_speed)
