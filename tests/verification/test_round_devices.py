"""Rings, several transducers and open wells against closed forms: Bessel functions, one dimension, a rigid cylinder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import jn_zeros, jv, yv
from support import Held, chip_from, fluid_modes

from geometry.chip import Chip
from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric
from workbench.fem.operators import assemble
from workbench.fem.solve import solve_full
from workbench.model.problem import FilledChip, build

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
EPOXY = IsotropicSolid(name="epoxy", density=1200.0, bulk_modulus=5e9 - 0.1e9j, shear_modulus=1.5e9 - 0.05e9j)
GLASS = IsotropicSolid(name="glass", density=2500.0, bulk_modulus=44e9, shear_modulus=29e9)
WATER = Fluid(name="water", density=997.0, sound_speed=1497.0)


def chip_of(*layers: str, band: tuple[str, str], more: str = "") -> Chip:
    """A chip of layers, each the lines of its table."""
    text = "".join(f"[[layers]]\n{layer}\n" for layer in layers)
    head = f'[chip]\nname = "device"\nband = ["{band[0]}", "{band[1]}"]\nunusual = ["band"]\n'
    return chip_from(head + text + more, "device.toml")


@pytest.fixture(scope="module")
def pzt(reference_materials: Callable[[str], dict[str, Material]]) -> Piezoelectric:
    found = reference_materials("free_disc_fitted_rho7500")["transducer"]
    assert isinstance(found, Piezoelectric)
    return found


def impedance(chip: Chip, materials: dict[str, Material], frequency: Real, *, rollers: bool = False) -> Complex:
    """Z (n,) of a chip of these materials by region; between `rollers` it does not move along the radius."""
    made = build(FilledChip(chip, chip.states[0], materials), accuracy=1e-4)
    if rollers:
        made = made.with_terms(tuple(Held("u_r", f"{region}|outside") for region in materials), {})
    return solve_full(assemble(made.mesh, made.terms), frequency, made.values).impedance


# --------------------------------------------------------------------------------------------------------------------
# Rings


def thin_ring(pzt: Piezoelectric, thick: float, inner: float, outer: float, frequency: Real) -> Complex:
    """Z (n,) of a thin ring with electrodes on its faces, in plane stress: u = A J1(k r) + B Y1(k r), free at both
    rims (IEEE Standard on Piezoelectricity 176-1987, plane radial modes, of a ring)."""
    c11, c12 = pzt.c11 - pzt.c13**2 / pzt.c33, pzt.c12 - pzt.c13**2 / pzt.c33
    e31 = pzt.e31 - pzt.c13 * pzt.e33 / pzt.c33
    permittivity = pzt.absolute_eps33 + pzt.e33**2 / pzt.c33
    found = []
    for omega in 2.0 * np.pi * frequency:
        k, r = omega * np.sqrt(pzt.density / c11), np.array([inner, outer])
        # Radial stress of either solution at the rims, for a field of 1 / thick.
        stress = np.stack([c11 * k * 0.5 * (f(0, k * r) - f(2, k * r)) + c12 * f(1, k * r) / r for f in (jv, yv)], 1)
        a, b = np.linalg.solve(stress, np.full(2, e31 / thick))
        moved = r * (a * jv(1, k * r) + b * yv(1, k * r))
        charge = 2.0 * np.pi * (e31 * (moved[1] - moved[0])
                                + permittivity / thick * 0.5 * (outer**2 - inner**2))
        found.append(1.0 / (-1j * omega * charge))
    return np.array(found)


def test_a_thin_ring_has_the_radial_modes_of_plane_stress(pzt: Piezoelectric) -> None:
    thick, inner, outer = 0.1e-3, 4e-3, 10e-3
    chip = chip_of(f'role = "transducer"\nmaterial = "pzt"\nthickness = "{thick} m"\nradius = "{outer} m"\n'
                   f'inner_radius = "{inner} m"', band=("20 kHz", "400 kHz"))
    frequency = np.linspace(60e3, 110e3, 51)
    found = impedance(chip, {"transducer": pzt}, frequency)
    expected = thin_ring(pzt, thick, inner, outer, frequency)
    assert np.argmin(np.abs(expected)) not in (0, 50)
    error = np.abs(np.log(found / expected)).max()
    # The first radial mode is in the band, at a Q of 100: a frequency of 1e-3 off would be 0.1 of ln Z there. The
    # thickness is left out to its square over that of the wavelength.
    print(f"ring: ln Z off by {error:.1e}")
    assert error < 5e-3
    disc = np.abs(np.log(thin_ring(pzt, thick, 1e-6, outer, frequency) / expected)).max()
    assert disc > 0.5


# --------------------------------------------------------------------------------------------------------------------
# Several transducers


@dataclass(frozen=True)
class Plate:
    """A layer of a stack in one dimension; the signs of the ``field`` that a voltage of 1 makes in a transducer, and of
    its e33 as ``poled``."""

    material: Piezoelectric | IsotropicSolid
    thickness: float
    field: int = 0
    poled: int = 1

    @property
    def permittivity(self) -> complex:
        return complex(self.material.absolute_eps33) if isinstance(self.material, Piezoelectric) else 1e-11

    @property
    def h(self) -> complex:
        """e33 over the permittivity, V/m."""
        return self.poled * self.material.e33 / self.permittivity if isinstance(self.material, Piezoelectric) else 0j

    @property
    def stiffness(self) -> complex:
        """At constant D, Pa."""
        if isinstance(self.material, Piezoelectric):
            return complex(self.material.c33 + self.material.e33**2 / self.permittivity)
        return complex(self.material.bulk_modulus + 4.0 * self.material.shear_modulus / 3.0)


def stack_impedance(plates: list[Plate], area: float, frequency: Real) -> Complex:
    """Z (n,) of plates in one dimension, free at both ends, their voltages in parallel: u = A sin k z + B cos k z in
    each, and the displacement field D, with stress and motion continuous."""
    found, count = [], len(plates)
    for omega in 2.0 * np.pi * frequency:
        def at(i: int, z: float, omega: float = omega) -> tuple[Complex, Complex]:
            """Motion and stress at the height z of a plate, by the unknowns A, B and D of all."""
            plate, motion, stress = plates[i], *np.zeros((2, 3 * count), dtype=complex)
            k = omega * np.sqrt(plate.material.density / plate.stiffness)
            motion[3 * i:3 * i + 2] = np.sin(k * z), np.cos(k * z)
            stress[3 * i:3 * i + 3] = (plate.stiffness * k * np.cos(k * z), -plate.stiffness * k * np.sin(k * z),
                                       -plate.h)
            return motion, stress

        rows, right = [at(0, 0.0)[1], at(count - 1, plates[-1].thickness)[1]], [0.0, 0.0]
        for i in range(count - 1):
            rows += [a - b for a, b in zip(at(i, plates[i].thickness), at(i + 1, 0.0), strict=True)]
            right += [0.0, 0.0]
        for i, plate in enumerate(plates):
            # The integral of E = D / eps - h u' along z; a passive plate has no D.
            row = -plate.h * (at(i, plate.thickness)[0] - at(i, 0.0)[0])
            row[3 * i + 2] = plate.thickness / plate.permittivity
            rows.append(row)
            right.append(float(plate.field))
        x = np.linalg.solve(np.array(rows), np.array(right))
        charge = area * sum(plate.field * x[3 * i + 2] for i, plate in enumerate(plates))
        found.append(1.0 / (-1j * omega * charge))
    return np.array(found)


@pytest.mark.parametrize("bonded", [False, True])
def test_transducers_in_parallel_are_the_stack_in_one_dimension(pzt: Piezoelectric, *, bonded: bool) -> None:
    """Two of different thickness, live where they meet and poled towards each other, with epoxy between or without."""
    def disc(role: str, thick: str, more: str) -> str:
        return f'role = "{role}"\nmaterial = "any"\nthickness = "{thick}"\nradius = "1 mm"\n{more}'

    layers = [disc("transducer", "1 mm", 'electrodes = { live = "top" }'),
              *([disc("bond", "20 um", "")] if bonded else []),
              disc("transducer", "1.4 mm", 'electrodes = { live = "bottom" }\npoled = "down"')]
    materials: dict[str, Material] = {"transducer": pzt, "transducer_2": pzt} | ({"bond": EPOXY} if bonded else {})
    frequency = np.linspace(0.3e6, 2.5e6, 23)
    found = impedance(chip_of(*layers, band=("300 kHz", "2.5 MHz")), materials, frequency, rollers=True)
    # A live face on top makes a field downwards.
    plates = [Plate(pzt, 1e-3, -1), *([Plate(EPOXY, 20e-6)] if bonded else []), Plate(pzt, 1.4e-3, 1, -1)]
    expected = stack_impedance(plates, np.pi * 1e-6, frequency)
    error = np.abs(np.log(found / expected)).max()
    print(f"two transducers, {'bonded' if bonded else 'touching'}: ln Z off by {error:.1e}")
    assert error < 1e-5
    # Poled alike they shake against each other.
    alike = stack_impedance([*plates[:-1], Plate(pzt, 1.4e-3, 1, 1)], np.pi * 1e-6, frequency)
    assert np.abs(np.log(alike / expected)).max() > 0.3


# --------------------------------------------------------------------------------------------------------------------
# Open wells


def test_an_open_well_has_the_modes_of_a_cylinder_with_a_free_surface(
    pzt: Piezoelectric, rows: Callable[..., NDArray[np.int64]]
) -> None:
    depth, radius = 2e-3, 3e-3
    chip = chip_of('role = "transducer"\nmaterial = "any"\nthickness = "1 mm"\nradius = "5 mm"',
                   'role = "substrate"\nmaterial = "any"\nthickness = "1 mm"\nradius = "5 mm"',
                   'role = "sidewall"\nmaterial = "any"\nthickness = "3 mm"\nradius = "5 mm"\ncavity_radius = "3 mm"',
                   band=("0.3 MHz", "1 MHz"), more='[cavity]\nfill = "2 mm"\n[states.filled]\ncavity = "water"\n')
    assert [layer.region for layer in chip.layers] == ["transducer", "substrate", "sidewall", "sidewall_2"]
    materials: dict[str, Material] = {"transducer": pzt, "substrate": GLASS, "sidewall": GLASS, "sidewall_2": GLASS,
                                      "cavity": WATER}
    made = build(FilledChip(chip, chip.states[0], materials, inviscid=True), accuracy=1e-4)
    held = tuple(Held(component, boundary) for boundary in ("cavity|substrate", "cavity|sidewall")
                 for component in ("u_r", "u_z"))
    made = made.with_terms(held, {})
    operators = assemble(made.mesh, made.terms)
    found = fluid_modes(operators, made.values, rows(operators, "cavity", "p"), 1e6)
    across = np.array([0.0, *jn_zeros(1, 3)]) / radius
    up = (np.arange(2) + 0.5) * np.pi / depth
    expected = np.sort((WATER.sound_speed**2 * (across[:, None]**2 + up**2)).ravel())[:5]
    error = max(np.abs(found / each - 1.0).min() for each in expected)
    print(f"open well: w^2 off by {error:.1e}")
    assert error < 1e-6
