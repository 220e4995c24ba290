"""Cubic crystals in straight sections against closed forms: plane waves, rotated tensors, stacks, isotropic solids."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skfem import Basis
from support import STACK, plate_below_a_layer, quadratic
from test_geometry_straight import CHIP, chip

from geometry.chip import parse_chip
from geometry.measure import Measure, Parity, Straight
from geometry.mesh import mesh_section
from geometry.mesh_size import MeshSize
from geometry.section import Electrode, Rectangle, Section
from materials import Registry
from materials.kinds import CHANNELS, CubicSolid, IsotropicSolid, Material, Piezoelectric
from materials.passivity import check_passive
from workbench.fem.elements import Lagrange
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.files.errors import InputError
from workbench.files.tables import parse_toml
from workbench.model.problem import Problem, fill, problem
from workbench.simulation.run import snapshot

COARSE, LENGTH = quadratic(3.0), 0.02
SILICON = {direction: Registry().load(f"silicon/cubic_100_{direction.strip('<>')}") for direction in CHANNELS}


def crystal(direction: str, **changes: complex) -> CubicSolid:
    found = SILICON[direction]
    assert isinstance(found, CubicSolid)
    assert found.channel == direction
    return replace(found, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def pzt(reference_materials: Callable[[str], dict[str, Material]]) -> Piezoelectric:
    found = reference_materials("free_disc_fitted_rho7500")["transducer"]
    assert isinstance(found, Piezoelectric)
    return found


def on_a_plate(
    width: float, plate: tuple[float, float], crystal: tuple[float, float], materials: dict[str, Material], edge: float,
    measure: Measure,
) -> Problem:
    """The model of a crystal on a plate, each between two heights (m), of elements no longer than `edge` (m)."""
    section = Section((Rectangle("transducer", 0.0, width, *plate), Rectangle("substrate", 0.0, width, *crystal)),
                      (Electrode("electrode_live", 0.0, width, plate[0]),
                       Electrode("electrode_ground", 0.0, width, plate[1])), measure)
    size = MeshSize(dict.fromkeys(section.regions, 1.0), 1.0 / edge, 1.0, 4)
    return problem(mesh_section(section, size), materials, (1e5, 1e7))


def modulus(direction: str, along: tuple[float, float], motion: tuple[float, float], pzt: Piezoelectric) -> float:
    """rho v^2 (Pa) of a plane wave along x and z with that motion, as the quotient of the forms of the model.

    A block holds whole wavelengths, over which squares of sines and cosines have one mean.
    """
    made = crystal(direction)
    period = 1e-3
    width, height = (period / each if each else period for each in along)
    model = on_a_plate(width, (-0.1e-3, 0.0), (0.0, height), {"transducer": pzt, "substrate": made}, 0.05e-3,
                       Straight(LENGTH))
    operators = assemble(model.mesh, model.terms)
    x, z = Basis(model.mesh.mesh, Lagrange(model.mesh.order), intorder=1).doflocs
    wave = np.cos(2.0 * np.pi / period * (along[0] * x + along[1] * z))
    state = np.zeros((operators.size, 1), dtype=complex)
    for component, size in zip(("u_r", "u_z"), motion, strict=True):
        rows = operators.numbering[component]
        state[rows[rows >= 0], 0] = size * wave[rows >= 0]
    forms = operators.quadratic(state, state)[0].real * operators.coefficients(np.array([1.0]), model.values)[0].real
    parts = {is_mass: sum(form for form, i in zip(forms, operators.integrals, strict=True) if i.place == "substrate"
                          and i.coefficient.parameters[0].endswith("density") is is_mass) for is_mass in (True, False)}
    wavenumber = 2.0 * np.pi / period * np.hypot(*along)
    return float(-parts[False] / parts[True] / wavenumber**2 * made.density)


ROOT = (float(np.sqrt(2.0 / 3.0)), float(np.sqrt(1.0 / 3.0)))


@pytest.mark.parametrize(("direction", "along", "motion", "expected"), [
    # Along [001], the normal of the wafer.
    ("<110>", (0.0, 1.0), (0.0, 1.0), (1.0, 0.0, 0.0)), ("<110>", (0.0, 1.0), (1.0, 0.0), (0.0, 0.0, 1.0)),
    ("<100>", (0.0, 1.0), (0.0, 1.0), (1.0, 0.0, 0.0)), ("<100>", (0.0, 1.0), (1.0, 0.0), (0.0, 0.0, 1.0)),
    # Across the channel: along [110] and along [100].
    ("<110>", (1.0, 0.0), (1.0, 0.0), (0.5, 0.5, 1.0)), ("<110>", (1.0, 0.0), (0.0, 1.0), (0.0, 0.0, 1.0)),
    ("<100>", (1.0, 0.0), (1.0, 0.0), (1.0, 0.0, 0.0)), ("<100>", (1.0, 0.0), (0.0, 1.0), (0.0, 0.0, 1.0)),
    # Along [111], and along [110] in the plane of x and z.
    ("<110>", ROOT, ROOT, (1 / 3, 2 / 3, 4 / 3)),
    ("<110>", ROOT, (ROOT[1], -ROOT[0]), (1 / 3, -1 / 3, 1 / 3)),
    ("<100>", (1.0, 1.0), (1.0, 1.0), (0.5, 0.5, 1.0)),
    ("<100>", (1.0, 1.0), (1.0, -1.0), (0.5, -0.5, 0.0)),
])
def test_plane_waves_have_their_speeds(
    direction: str, along: tuple[float, float], motion: tuple[float, float], expected: tuple[float, float, float],
    pzt: Piezoelectric,
) -> None:
    exact = sum(share * complex(getattr(crystal(direction), key)).real
                for share, key in zip(expected, ("c11", "c12", "c44"), strict=True))
    # Order 4 interpolates a sine with 20 elements on a wavelength to 1e-6, and a quotient is of second order.
    assert modulus(direction, along, motion, pzt) == pytest.approx(exact, rel=1e-8)


@pytest.mark.parametrize(("direction", "turn"), [("<110>", 0.25 * np.pi), ("<100>", 0.0)])
def test_the_stiffness_is_that_of_the_turned_tensor(direction: str, turn: float) -> None:
    made = crystal(direction)
    c11, c12, c44 = (complex(getattr(made, key)).real for key in ("c11", "c12", "c44"))
    tensor = np.zeros((3, 3, 3, 3))
    for i in range(3):
        for j in range(3):
            tensor[i, i, j, j] = c11 if i == j else c12
            if i != j:
                tensor[i, j, i, j] = tensor[i, j, j, i] = c44
    cosine, sine = np.cos(turn), np.sin(turn)
    turned = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    found = np.einsum("ai,bj,ck,dl,ijkl->abcd", turned, turned, turned, turned, tensor)
    across, along = made.stiffness
    assert [found[0, 0, 0, 0], found[0, 0, 1, 1]] == pytest.approx([across, along], rel=1e-12)
    assert [found[0, 0, 2, 2], found[2, 2, 2, 2], found[0, 2, 0, 2]] == pytest.approx([c12, c11, c44], rel=1e-12)


@pytest.mark.parametrize("direction", CHANNELS)
def test_between_rollers_a_wafer_on_a_plate_is_the_transfer_matrix(direction: str, pzt: Piezoelectric) -> None:
    # Silicon with a loss, so that the impedance is finite at every frequency.
    made = crystal(direction, c11=165.7e9 - 0.5e9j, c12=63.9e9 - 0.2e9j, c44=79.6e9 - 0.3e9j)
    width, thick, depth, frequency = 0.5e-3, 1e-3, 0.525e-3, np.linspace(0.4e6, 4e6, 13)
    model = on_a_plate(width, (0.0, thick), (thick, thick + depth), {"transducer": pzt, "substrate": made}, 0.1e-3,
                       Straight(LENGTH, Parity.EVEN, Parity.EVEN))
    found = solve_full(assemble(model.mesh, model.terms), frequency, model.values).impedance
    of_density = IsotropicSolid(name="wafer", density=made.density, bulk_modulus=1e11, shear_modulus=5e10)
    expected = plate_below_a_layer(pzt, thick, of_density, depth, np.sqrt(width * LENGTH / np.pi), frequency,
                                   complex(made.c11))
    assert np.abs(np.log(found / expected)).max() < 1e-7


@pytest.mark.parametrize("direction", CHANNELS)
def test_a_crystal_with_the_constants_of_glass_is_glass(direction: str, tmp_path: Path) -> None:
    glass = Registry().load("soda_lime_glass/ono_2020")
    assert isinstance(glass, IsotropicSolid)
    bulk, shear = complex(glass.bulk_modulus) / 1e9, complex(glass.shear_modulus) / 1e9
    (tmp_path / "crystal").mkdir()
    (tmp_path / "references.bib").write_text("@misc{own,\n  title = {own}\n}\n")
    (tmp_path / "crystal" / "own.toml").write_text(
        'kind = "cubic solid"\ntitle = "glass"\nsource = "own"\nconditions = "own"\n'
        f'channel = "{direction}"\ndensity = {{ value = {glass.density}, unit = "kg/m^3" }}\n' + "".join(
            f'{key} = {{ value = {value.real!r}, loss = {value.imag!r}, unit = "GPa" }}\n' for key, value in (
                ("c11", bulk + 4.0 / 3.0 * shear), ("c12", bulk - 2.0 / 3.0 * shear), ("c44", shear))))
    registry = Registry((tmp_path,))
    shots = [snapshot(chip(CHIP.replace("soda_lime_glass/ono_2020", name)), None, 1.97e6, registry=registry,
                      accuracy=COARSE)
             for name in ("crystal/own", "soda_lime_glass/ono_2020")]
    assert shots[0].closure < 1e-9
    assert shots[0].fields.current == pytest.approx(shots[1].fields.current, rel=1e-8)
    solids = shots[0].fields.mesh.nodes_of(["substrate"])
    stresses = [shot.fields.stress[solids] for shot in shots]
    assert np.abs(stresses[0] - stresses[1]).max() < 1e-6 * np.abs(stresses[1]).max()


def test_a_crystal_moves_the_resonance_of_a_channel_and_is_none_in_a_round_chip() -> None:
    text = CHIP.replace("soda_lime_glass/ono_2020", "silicon/cubic_100_110")
    shots = [snapshot(chip(text.replace("_110", f"_{name}")), None, 1.97e6, accuracy=COARSE) for name in ("110", "100")]
    assert all(shot.closure < 1e-9 for shot in shots)
    assert abs(shots[0].fields.current / shots[1].fields.current - 1.0) > 1e-4
    round_chip = parse_chip(parse_toml(STACK.replace('"pla"', '"silicon/cubic_100_110"'), source="chip.toml"),
                            source="chip.toml")
    with pytest.raises(InputError, match=r"material of sample: .*no single crystal in a round chip.*hill_average"):
        fill(round_chip)


def test_unstable_and_active_crystals_are_refused_and_a_direction_must_be_stated() -> None:
    for changes, words in (({"c12": 166e9}, "positive definite"), ({"c44": 79.6e9 + 1e9j}, "imaginary part"),
                           ({"c12": 63.9e9 - 1e9j}, "no eigenvalue below")):
        with pytest.raises(InputError, match=words):
            check_passive(crystal("<110>", **changes), loss_tolerances={}, source="own")
    with pytest.raises(InputError, match="<100>"):
        crystal("<110>").__class__(name="own", density=1.0, c11=2.0, c12=1.0, c44=1.0, channel="<111>")
