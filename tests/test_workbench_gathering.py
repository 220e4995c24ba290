"""The statement on where and when particles gather: one case of every answer, on fields with a known one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support import CELL
from test_workbench_barriers import half_wave
from test_workbench_trajectories import HEIGHT, NEUTRAL, WATER, bead, block
from test_workbench_trajectories import half_wave as bessel_wave

import workbench as wb
from geometry.measure import Parity, Straight
from materials.kinds import Fluid
from materials.registry import Registry
from workbench.acoustics.captures import capture_statistics
from workbench.acoustics.forces import ParticleForces, particle_forces
from workbench.acoustics.nodal import NodalMesh, mesh_of
from workbench.acoustics.trajectories import Fate, Trajectories, follow, record_times
from workbench.acoustics.traps import TrapReport, find_traps
from workbench.model.particles import Particle, net_weight
from workbench.simulation.beads import LEAST_DEPTH, with_particle
from workbench.simulation.gathering import THERMAL, Gathering, gathering, percent, statement
from workbench.simulation.liquid_motion import LiquidMotion

REST = LiquidMotion(None, None, None)


def flowing(critical: Mapping[str, float]) -> Any:
    """A flow with critical diameters (m), as far as a statement reads it."""
    return SimpleNamespace(streaming=SimpleNamespace(critical_diameters=critical))


def bessel(particle: Particle, *, p0: float = 4e5) -> TrapReport:
    forces = particle_forces(bessel_wave(block(14, 6), radial=666.0, p0=p0), particle, fluid=WATER, region="cavity")
    return find_traps(forces, least_depth=LEAST_DEPTH)


def said(forces: ParticleForces, *, duration: float = 600.0) -> Gathering:
    report = find_traps(forces, least_depth=LEAST_DEPTH)
    return statement("filled", report, REST, follow(report, record_times(duration), particles=60))


@pytest.fixture(scope="module")
def gathered() -> Trajectories:
    return follow(bessel(bead()), record_times(1800.0), particles=100)


def test_the_plane_and_the_way_along_it_have_times_and_places_of_their_own(gathered: Trajectories) -> None:
    found = statement("filled", gathered.report, REST, gathered)
    assert found.gathers
    assert found.first is not None
    assert found.first.words == "levitate 0.36 mm above the floor"
    assert found.first.half == pytest.approx(np.nanmedian(gathered.levitated_at))
    axis = found.places[0]
    assert axis.words == "in a trap on the axis, 0.36 mm above the floor"
    assert axis.share == pytest.approx((gathered.trap == 0).mean())
    # Along the plane f2 alone moves them, some hundred times more slowly.
    assert axis.half is not None
    assert axis.half > 30.0 * (found.first.half or math.inf)
    assert sum(place.share for place in found.places) == pytest.approx(1.0)
    text = str(found)
    assert text.startswith("After 30 min at 1.0516 MHz and 5 Vpp, of 100 evenly spread polystyrene spheres of 10 um: ")
    assert "% settled on the floor (half of these within" in text
    assert "times its net weight" in text
    assert "along the plane" in text


def test_below_the_critical_diameter_they_circulate_at_any_voltage(gathered: Trajectories) -> None:
    report, small = gathered.report, {"axial": 11e-6, "radial": 40e-6}
    for followed in (None, gathered):
        found = statement("filled", report, flowing(small), followed)
        assert found.gathers is False
        assert "do not gather: they circulate with the streaming, however large the voltage" in str(found)
        assert "critical diameter is 11 um" in str(found)
    found = statement("filled", report, flowing({"axial": math.nan, "radial": 1e-6}), None)
    assert "no size of them is moved more by the sound" in str(found)


def test_a_flow_that_wins_along_the_plane_alone_is_said(gathered: Trajectories) -> None:
    words = "Along the plane the flow moves them more than the sound does, however large the voltage"
    for limit, expected in ((20e-6, True), (9e-6, False)):
        found = statement("filled", gathered.report, flowing({"axial": 2e-6, "radial": limit}), gathered)
        assert (words in str(found)) is expected
        assert "circulate" not in str(found)


def test_two_planes_are_two_heights() -> None:
    found = said(half_wave(bead(), half_waves=2, p0=3e5))
    assert found.first is not None
    assert found.first.words == "levitate 0.19 and 0.56 mm above the floor"


def test_a_field_too_weak_for_the_weight_is_said_with_the_voltage_that_is_enough() -> None:
    lead = replace(NEUTRAL, density=11000.0)
    found = said(half_wave(lead, p0=1e5))
    assert found.gathers is False
    assert [place.words for place in found.places] == ["settled on the floor"]
    assert "The field is too weak" in found.sentences[1]
    # At that voltage it does, and two steps below the lift, which goes with its square, is less than the weight.
    enough = float(found.sentences[1].split("At ")[1].split(" Vpp")[0])
    strong = said(half_wave(lead, p0=1.05e5 * enough / 10.0))
    assert strong.first is not None
    assert strong.first.share > 0.05
    lift = find_traps(half_wave(lead)).traps[0].lift
    assert lift is not None
    assert (enough / 1.44 / 10.0) ** 2 * lift < net_weight(lead, WATER)


def test_slow_focusing_is_said_with_a_voltage() -> None:
    found = said(half_wave(replace(NEUTRAL, radius=1e-6), p0=2e4), duration=20000.0)
    assert found.gathers is False
    assert "This is slow" in str(found)
    assert "Vpp would take 10 s" in str(found)


def test_no_trap_is_said_and_why_an_antinode_holds_none() -> None:
    report = find_traps(half_wave(NEUTRAL))
    still = replace(report.forces, force=np.zeros_like(report.forces.force))
    empty = replace(report, forces=still, traps=())
    found = statement("filled", empty, REST, follow(empty, record_times(10.0), particles=20))
    assert found.gathers is False
    assert "no minimum" in str(found)
    oil = particle_forces(bessel_wave(block(6, 6), p0=4e5), replace(NEUTRAL, compressibility=6e-10), fluid=WATER,
                          region="cavity")
    text = str(said(oil))
    assert "these particles go to pressure antinodes" in text


def test_beads_too_light_for_the_floor_do_not_rest_on_it() -> None:
    small = bessel(bead(radius=0.05e-6), p0=4e5)
    found = statement("filled", small, flowing({"axial": 2e-6, "radial": 9e-6}), None)
    # k T / W with W = 4/3 pi a^3 53 kg/m^3 g.
    height = 1.380649e-23 * 298.15 / (4 / 3 * math.pi * 0.05e-6**3 * 53.0 * 9.80665)
    assert f"do not rest on the floor: thermal motion spreads them over a height of {1e3 * height:.2g} mm" in str(found)
    assert pytest.approx(4.1e-20, rel=0.01, abs=0.0) == THERMAL


def test_shares_next_to_nothing_and_to_all_keep_their_digits() -> None:
    assert [percent(each) for each in (0.0, 0.005, 0.0349, 0.5, 0.996, 1.0)] == [
        "0 %", "0.5 %", "3 %", "50 %", "99.6 %", "100 %"]


def test_without_liquid_or_particle_it_says_what_is_missing() -> None:
    def shot(fluid: Any = None, cavity: str = "water") -> Any:
        held = {"cavity": Registry().load("water") if fluid is None else fluid}
        return SimpleNamespace(
            state="filled", chip=SimpleNamespace(materials=lambda _state: {"cavity": cavity} if cavity else {}),
            problem=SimpleNamespace(materials={} if fluid is False else held), traps=None, fields=SimpleNamespace(
                pressure=np.ones(1), frequency=1e6, mesh=SimpleNamespace(nodes_of=lambda _regions: [0])))

    assert gathering(shot(cavity="")) is None
    for fluid in (False, Registry().load("air")):
        found = gathering(shot(fluid))
        assert found is not None
        assert found.gathers is None
        assert "holds no liquid" in str(found)
    found = gathering(shot())
    assert found is not None
    assert 'particle = "polystyrene"' in str(found)
    assert "[states.filled]" in str(found)
    assert isinstance(Registry().load("air"), Fluid)


# Channels ------------------------------------------------------------------------------------------------------------


def channel(flow: Any, particle: Particle = NEUTRAL) -> tuple[TrapReport, np.ndarray]:
    """A silent channel, right half, with a flow (m/s) of x over the half width and z over the height."""
    half_width = 190e-6
    x, z = np.linspace(0.0, half_width, 9), np.linspace(0.0, HEIGHT, 9)
    low, high = (np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
                 for lines in ((x[:-1], z[:-1]), (x[1:], z[1:])))
    mesh: NodalMesh = mesh_of(low, high, np.zeros(len(low), dtype=np.int64), ("cavity",), order=4,
                              measure=Straight(0.02, Parity.ODD))
    waves = SimpleNamespace(
        mesh=mesh, frequency=2e6, voltage=5.0 + 0j, drive="none", pressure=np.ones(len(mesh.points), complex),
        velocity=np.zeros((len(mesh.points), 2), complex), energy_density=np.ones(len(mesh.points)))
    forces = particle_forces(waves, particle, fluid=WATER, region="cavity")
    forces = replace(forces, force=np.zeros_like(forces.force), potential=np.zeros_like(forces.potential))
    across, up = forces.mesh.points.T / np.array([[half_width], [HEIGHT]])
    return TrapReport(forces=forces, traps=()), np.stack(np.broadcast_arrays(*flow(across, up)), axis=1)


def test_one_that_passes_has_not_arrived() -> None:
    """A roll that turns about the middle of the half channel brings every bead to the middle line, and away again."""
    report, flow = channel(lambda x, z: (
        -1e-5 * np.sin(math.pi * x) * np.cos(math.pi * z),
        1e-5 * HEIGHT / 190e-6 * np.cos(math.pi * x) * np.sin(math.pi * z)))
    found = follow(report, np.linspace(0.0, 600.0, 601), particles=100, flow=flow)
    free = np.isnan(found.stopped_at)
    came = (np.abs(found.positions[free, :, 0]) < found.within).any(axis=1).mean()
    stays = np.isfinite(found.focused_at[free]).mean()
    assert came > 0.25
    assert stays < 0.3 * came
    (focused, *_) = capture_statistics(found)
    assert focused.name == "focused across the channel"
    assert focused.count < 0.3 * came * found.count


def test_the_lid_of_a_channel_is_a_place_of_its_own() -> None:
    report, flow = channel(lambda x, z: (-2e-3 * x, 4e-6 + 0.0 * x))
    found = follow(report, record_times(600.0), particles=40, flow=flow)
    assert (found.fate == Fate.AT_LID).all()
    rows = {row.name: row for row in capture_statistics(found)}
    assert rows["pressed to the lid, in the middle of the channel"].share == 1.0
    # They are at their place across on the lid too.
    assert rows["focused across the channel"].share == 1.0
    text = str(statement("filled", report, REST, found))
    assert "100 % pressed to the lid, in the middle of the channel" in text
    assert "100 % focus across the channel, in the middle of the channel: half of these within" in text


# A chip --------------------------------------------------------------------------------------------------------------


def test_simulate_and_particles_say_the_same(tmp_path: Any) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    chip = wb.read_chip(path)
    shot = wb.snapshot(chip, "filled", 1e6, accuracy=2e-2, drive=wb.parse_drive("20 Vpp"))
    moving = wb.liquid_motion(shot)
    simulated = gathering(shot)
    found = wb.trajectories(shot, 1800.0, particles=300, seed=5, flow=moving.velocity)
    followed = statement("filled", found.report, moving, found)
    assert simulated is not None
    assert simulated.first is not None
    assert followed.first is not None
    assert simulated.gathers == followed.gathers
    assert simulated.critical_diameters == followed.critical_diameters
    assert simulated.first.share == pytest.approx(followed.first.share, abs=0.04)
    assert simulated.first.share > 0.2
    assert simulated.first.half == pytest.approx(followed.first.half, rel=0.2)
    for one, other in zip(simulated.places, followed.places, strict=False):
        assert one.share == pytest.approx(other.share, abs=0.05)


def test_heat_that_is_refused_is_said_first(tmp_path: Any) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    chip = with_particle(wb.read_chip(path), "filled", particle=None, radius=0.2e-6)
    found = gathering(wb.snapshot(chip, "filled", 1e6, accuracy=2e-2, drive=wb.parse_drive("60 Vpp")))
    assert found is not None
    assert found.sentences[0].startswith("The heat of the drive is left out of the following, because this state has "
                                         "60 Vpp at the electrodes")
    assert "at most" in found.sentences[0]
    assert "circulate with the streaming, however large the voltage" in str(found)
