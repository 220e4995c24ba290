"""Straight chips in the solver: fields, losses, half widths as parameters, terms that need an axis, pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import moved_onto, quadratic
from test_geometry_straight import CHIP, chip

from geometry.chip import Chip, read_chip
from geometry.measure import Parity, Straight
from workbench.acoustics.nodal import integrate
from workbench.fem.capacitance import clamped_capacitance
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.model.dimensions import parametrised
from workbench.model.discretisation import ROWS
from workbench.model.problem import Problem, build, fill
from workbench.physics.annulus import Annulus
from workbench.physics.missing_fluid import MissingFluid
from workbench.physics.open_bond import OpenBond
from workbench.physics.term import ModelError
from workbench.render.gallery import draw_state
from workbench.simulation.run import Snapshot, simulate, snapshot

COARSE = quadratic(3.0)
CHIPS = Path(__file__).parents[1] / "geometry" / "chips"
FREQUENCY = 1.97e6
#: With a split electrode, for any symmetry.
SPLIT = CHIP.replace('live = "bottom"', 'live = "bottom", live_inner_half_width = "0.3 mm"')


def of_symmetry(name: str) -> Chip:
    return chip(SPLIT.replace('symmetry = "even"', f'symmetry = "{name}"'))


@pytest.fixture(scope="module", params=["even", "odd", "none"])
def shot(request: pytest.FixtureRequest) -> Snapshot:
    return snapshot(of_symmetry(request.param), None, FREQUENCY, accuracy=COARSE)


def test_losses_close_and_energies_are_those_of_the_whole_chip(shot: Snapshot) -> None:
    # An identity of the discrete system: rounding and the residual are all there is.
    assert shot.closure < 1e-9
    mesh, one = shot.fields.mesh, np.ones(len(shot.fields.mesh.points))
    for region, volume in (("cavity", 380e-6 * 160e-6 * 0.02), ("transducer", 5e-3 * 1e-3 * 0.02)):
        assert integrate(mesh, one, [region]) == pytest.approx(volume, rel=1e-12)
    solids = mesh.nodes_of(["substrate"])
    strain_free = shot.fields.stress[solids, 1]
    # Plane strain: the stress along the channel is nu times the sum of the others.
    bulk, shear = (complex(shot.problem.values[f"soda_lime_glass/ono_2020.{name}_modulus"]) for name in (
        "bulk", "shear"))
    ratio = (3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear))
    across = shot.fields.stress[solids][:, [0, 2]].sum(axis=1)
    assert np.abs(strain_free - ratio * across).max() < 1e-12 * np.abs(across).max()


def test_pictures_are_drawn_and_solid_ones_left_out(shot: Snapshot, tmp_path: Path) -> None:
    names = {picture.path.stem for picture in draw_state(shot, tmp_path)}
    assert {"displacement_filled", "pressure_filled", "losses_filled", "mesh_filled"} <= names
    assert "cutaway_filled" not in names
    with pytest.raises(InputError, match="the chip is straight"):
        draw_state(shot, tmp_path, only=["cutaway"])


def test_even_and_whole_agree_in_all_that_is_counted() -> None:
    half, whole = (snapshot(of_symmetry(name), None, FREQUENCY, accuracy=COARSE) for name in ("even", "none"))
    assert half.fields.current == pytest.approx(whole.fields.current, rel=1e-9)
    assert half.losses == pytest.approx(whole.losses, rel=1e-8)
    for region in ("cavity", "superstrate"):
        energies = [integrate(each.fields.mesh, each.fields.energy_density, [region]) for each in (half, whole)]
        # Gradients are recovered over both sides of the middle in the whole section, and from one side in the half.
        assert energies[0] == pytest.approx(energies[1], rel=2e-2)


def test_impedance_goes_as_the_inverse_of_the_length() -> None:
    long = chip()
    short = replace(long, measure=Straight(0.5 * long.measure.length, Parity.EVEN))
    found = [impedance(build(fill(each), accuracy=COARSE)) for each in (long, short)]
    assert found[1] / found[0] == pytest.approx(2.0, rel=1e-10)


def impedance(problem: Problem) -> complex:
    solution = solve_full(assemble(problem.mesh, problem.terms), np.array([FREQUENCY]), problem.values)
    return complex(solution.impedance[0])


@pytest.mark.parametrize("symmetry", ["even", "odd", "none"])
def test_half_widths_and_thicknesses_are_exact_parameters(symmetry: str) -> None:
    there = of_symmetry(symmetry)
    moved = {"transducer.half_width": 2.6e-3, "cavity.half_width": 2.1e-4, "electrode_live.inner_half_width": 2.8e-4,
             "sidewall.thickness": 1.7e-4}
    names = [name for name in moved if name.endswith("half_width")]
    problem = build(fill(there), accuracy=COARSE)
    # The same mesh, moved: the stretch is linear between the breaks of the section, and so is this one.
    free = parametrised(problem, there, names)
    assert impedance(free) == pytest.approx(impedance(problem), rel=1e-9)
    stretched = impedance(free.with_values({name: complex(value) for name, value in moved.items()}))
    changed = there.with_dimensions(moved)
    expected = impedance(replace(problem, mesh=moved_onto(problem.mesh, changed)))
    print(f"{symmetry}: moved by parameters {stretched:.6g}, by its mesh {expected:.6g}")
    assert stretched == pytest.approx(expected, rel=1e-8)
    assert abs(stretched / impedance(problem) - 1.0) > 1e-2


def test_sides_that_coincide_and_move_otherwise_are_told() -> None:
    text = CHIP.replace('"even"', '"none"').replace('role = "bond"', 'role = "bond"\noffset = "-0.5 mm"')
    there = chip(text.replace('thickness = "20 um"\nhalf_width = "1.5 mm"', 'thickness = "20 um"\nhalf_width = "2 mm"'))
    problem = build(fill(there), accuracy=COARSE)
    parametrised(problem, there, ["cavity.half_width"])
    with pytest.raises(InputError, match=r"a side that does not coincide with one that .*half_width moves"):
        parametrised(problem, there, ["substrate.half_width"])


def test_terms_with_rings_need_an_axis() -> None:
    problem = build(fill(chip()), accuracy=COARSE)
    for term in (OpenBond("bond", "epoxy/acevedo_2026", Annulus("edge")),
                 MissingFluid("cavity", "water", "air", Annulus("gas"))):
        with pytest.raises(ModelError, match="needs an axis"):
            assemble(problem.mesh, (*problem.terms, term))


def test_a_simulation_has_a_spectrum_and_figures() -> None:
    found = simulate(chip(), points=61, accuracy=COARSE)
    assert found.figures is not None
    # A plate of 1 mm has its thickness resonance about 2 MHz.
    assert 1.7e6 < found.figures.f0 < 2.4e6


def test_a_plate_under_full_electrodes_has_the_capacitance_of_its_area() -> None:
    problem = build(fill(chip(CHIP.replace(', ground_half_width = "2 mm"', ""))), accuracy=COARSE)
    eps = problem.values["pzt4/acevedo_2026_fitted.eps33"].real * VACUUM_PERMITTIVITY
    found = clamped_capacitance(assemble(problem.mesh, problem.terms), problem.values, 1e3)
    # The field is uniform.
    assert found == pytest.approx(eps * 5e-3 * 0.02 / 1e-3, rel=1e-9)


def offset_chip(plate: float, others: float = 0.0) -> Chip:
    """The chip with its plate, and with all else, that far (m) to the right."""
    there = chip(SPLIT.replace('"even"', '"none"').replace(", live_inner_half_width = \"0.3 mm\"", ""))
    return replace(there, layers=tuple(replace(
        layer, offset=plate if layer is there.transducer else others,
        cavity_offset=0.0 if layer.cavity_radius is None else others) for layer in there.layers))


def test_offsets_are_places_and_no_more() -> None:
    """A chip moved as a whole is the same, and one turned round too."""
    found = {}
    for name, offsets in {"as it is": (0.0, 0.0), "moved": (0.4e-3, 0.4e-3), "right": (0.4e-3, 0.0),
                          "left": (-0.4e-3, 0.0)}.items():
        problem = build(fill(offset_chip(*offsets)), accuracy=COARSE)
        found[name] = impedance(problem)
    assert found["moved"] == pytest.approx(found["as it is"], rel=1e-9)
    assert found["left"] == pytest.approx(found["right"], rel=1e-9)
    assert abs(found["right"] / found["as it is"] - 1.0) > 1e-3


def test_a_plate_off_the_middle_drives_half_a_wave_across_the_channel() -> None:
    """Under one in the middle, the pressure at both side walls is the same."""
    uneven = []
    for offset in (0.0, 0.4e-3):
        fields = snapshot(offset_chip(offset), None, FREQUENCY, accuracy=COARSE).fields
        x = fields.mesh.points[:, 0]
        inside = np.zeros(len(x), dtype=bool)
        inside[fields.mesh.nodes_of(["cavity"])] = True
        left, right = (fields.pressure[inside & (np.abs(x - place) < 1e-9)].mean() for place in (-190e-6, 190e-6))
        uneven.append(abs(left - right) / abs(left + right))
    assert uneven[0] < 1e-8
    assert uneven[1] > 0.1


def test_a_channel_is_as_accurate_as_was_asked() -> None:
    # Elements that are short against the wavelength alone leave 0.6 % of ln Z here at 0.5 % asked; the other mesh has a
    # hundredth of them in every corner, whatever is made of the channel's.
    channel = read_chip(CHIPS / "silicon_glass_channel.toml")
    frequency, found = np.linspace(*channel.band, 5), []
    for accuracy in (5e-3, replace(ROWS[5e-3], corner_refinement=0.01)):
        problem = build(fill(channel, "filled"), accuracy=accuracy)
        found.append(solve_full(assemble(problem.mesh, problem.terms), frequency, problem.values).impedance)
    error = float(np.sqrt(np.mean(np.abs(np.log(found[0] / found[1])) ** 2)))
    print(f"silicon and glass channel: ln Z off by {100.0 * error:.2f} % at 0.5 %")
    # Over the band at 121 frequencies it is 0.37 %.
    assert error < 5e-3
