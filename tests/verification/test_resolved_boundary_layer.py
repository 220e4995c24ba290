"""The boundary-layer term in a coupled device against a fluid whose layers are meshed, where they matter.

The device is chip-like and shallow: a transducer, a base, a cavity of 0.1 to 0.2 mm in a ring, a lid. The fluid's
layers take about as much energy as all solids together, or far more. The resolved side is the generator of
concealed-effect trials: a viscous compressible fluid as displacement and pressure without slip, elements of fifth order
down to the layer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from concealed import media, solver

from geometry.chip import Chip
from geometry.names import interface
from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric
from workbench.fem.operators import assemble
from workbench.model.problem import Problem
from workbench.physics.boundary_layer import ViscousBoundaryLayer
from workbench.reduced.at_point import reduce
from workbench.results.merit import figures
from workbench.results.spectrum import Spectrum

RADIUS, CAVITY_RADIUS, CERAMIC, PLATE = 3e-3, 2.2e-3, 2e-3, 0.5e-3
GLASS = IsotropicSolid(name="glass", density=2500.0, bulk_modulus=41e9, shear_modulus=29e9)
PLA = IsotropicSolid(name="pla", density=1131.7, bulk_modulus=3.57e9 - 5e6j, shear_modulus=0.93e9 - 2e6j)
WALLS = ("substrate", "sidewall", "superstrate")


def resolved(transducer: Piezoelectric, wall: IsotropicSolid, fluid: Fluid, height: float,
             frequency: np.ndarray) -> Spectrum:
    """The device with the layers meshed."""
    assert fluid.shear_viscosity is not None
    omega = 2.0 * math.pi * float(np.mean(frequency))
    layer = math.sqrt(2.0 * fluid.shear_viscosity / (fluid.density * omega))
    names = ("density", "c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15", "eps11", "eps33")
    ceramic = media.Piezo(**{name: getattr(transducer, name) for name in names})
    solid = media.Solid.isotropic(wall.density, wall.bulk_modulus, wall.shear_modulus)
    liquid = media.Viscous(fluid.density, fluid.sound_speed, fluid.shear_viscosity, 0.0)
    floor, ceiling = CERAMIC + PLATE, CERAMIC + PLATE + height
    boxes = (solver.Box(0.0, RADIUS, 0.0, CERAMIC, ceramic), solver.Box(0.0, RADIUS, CERAMIC, floor, solid),
             solver.Box(CAVITY_RADIUS, RADIUS, floor, ceiling, solid),
             solver.Box(0.0, RADIUS, ceiling, ceiling + PLATE, solid),
             solver.Box(0.0, CAVITY_RADIUS, floor, ceiling, liquid))
    lines_r = (CAVITY_RADIUS - 2.5 * layer, CAVITY_RADIUS - 8.0 * layer, CAVITY_RADIUS + 3e-5)
    lines_z = (floor - 3e-5, *(x for s in (2.5, 8.0) for x in (floor + s * layer, ceiling - s * layer)))
    body = solver.Body(boxes, (CERAMIC, 0.0, RADIUS), (0.0, 0.0, RADIUS), (), lines_r, lines_z)
    return Spectrum(frequency, solver.spectrum(body, frequency, order=9, tolerance=1e-6))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wall", "viscosity", "height", "band"),
    [(GLASS, 20e-3, 200e-6, (330e3, 380e3)), (PLA, 5e-3, 100e-6, (320e3, 360e3)), (PLA, 20e-3, 100e-6, (320e3, 360e3))],
    ids=["glass", "pla", "pla, thicker layer"],
)
def test_the_term_has_the_quality_and_frequency_of_a_resolved_layer(
    wall: IsotropicSolid,
    viscosity: float,
    height: float,
    band: tuple[float, float],
    stacked: Callable[..., Chip],
    meshed: Callable[..., Problem],
    reference_materials: Callable[[str], dict[str, Material]],
) -> None:
    transducer = reference_materials("free_disc_fitted_rho7500")["transducer"]
    assert isinstance(transducer, Piezoelectric)
    # A fifth of the ceramic's own loss, so that the fluid's shows.
    c11, c13, c33 = (complex(c.real, 0.2 * c.imag) for c in (transducer.c11, transducer.c13, transducer.c33))
    transducer = replace(transducer, c11=c11, c13=c13, c33=c33)
    fluid = Fluid(name="oil", density=950.0, sound_speed=1400.0, shear_viscosity=viscosity, bulk_viscosity=0.0)
    frequency = np.linspace(*band, 161)
    exact = figures(resolved(transducer, wall, fluid, height, frequency))

    chip = stacked([("transducer", CERAMIC, RADIUS, None), ("substrate", PLATE, RADIUS, None),
                    ("sidewall", height, RADIUS, CAVITY_RADIUS), ("superstrate", PLATE, RADIUS, None)], band=band)
    materials = {"transducer": transducer, "cavity": fluid, **dict.fromkeys(WALLS, wall)}
    problem = meshed(chip, materials, elements_per_wavelength=20.0, corner_refinement=0.1)
    layers = tuple(ViscousBoundaryLayer(interface("cavity", name), name, "cavity", "oil") for name in WALLS)
    found = {}
    for name, terms in (("without", problem.terms), ("with", problem.terms + layers)):
        operators = assemble(problem.mesh, terms)
        solution = reduce(operators, frequency, problem.values).solve(frequency, problem.values)
        found[name] = figures(Spectrum.from_solver(frequency, solution.impedance))
    print(f"resolved f0 {exact.f0:.1f} Hz, Q {exact.q:.2f}; term {found['with'].f0:.1f}, {found['with'].q:.2f}; "
          f"without {found['without'].f0:.1f}, {found['without'].q:.2f}")
    # Corners and the wave along the film cost 1.3 % of Q at most; on elements half as large 0.04 %, and 3e-5 of f0.
    # It matters: without the term Q is off by more than half.
    assert found["without"].q > 1.5 * exact.q
    assert found["with"].q == pytest.approx(exact.q, rel=0.02)
    assert found["with"].f0 == pytest.approx(exact.f0, rel=3e-4)
