"""Element size and field order, chosen by the required accuracy of Z."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from geometry.free_section import FreeSection
from geometry.mesh_size import MeshSize
from geometry.names import TRANSDUCER, role_of
from geometry.section import Rectangle, Section
from materials.kinds import CubicSolid, Fluid, IsotropicSolid
from materials.registry import Material
from workbench.files.errors import InputError, expect_number

#: Thickness of the row of elements beside a film, in decay lengths 1 / k of its near field in the solid.
FILM_ROW = 1.75

#: Characteristic impedance (Pa s/m) that separates gases from liquids; water has 1.5e6, air 4e2.
GAS_IMPEDANCE = 1e4


@dataclass(frozen=True)
class Discretisation:
    """The order of the fields, and the size of the elements.

    ``elements_per_wavelength`` of the slowest wave of a region at the top of the band. The transducer has
    ``transducer_finer`` times as many: its radial overtones are sharp and its losses small. A gas has ``gas_finer``
    times as many, that is fewer: behind solid walls a gas changes Z by 0.3 % at most, and its short waves would
    determine every element above and below. The wave along a film of fluid (:func:`film_speeds`) has ``film_finer``
    times as many; fewer suffice if it has little energy. Its near field in the solid decays within 1 / k, and has a row
    of elements there (:data:`FILM_ROW`): without them Z of a chip with 24 um of gel was wrong by 3.7 %, with them by
    0.4 %. The others are as in `geometry.mesh_size.MeshSize`.
    """

    order: int
    elements_per_wavelength: float
    through_thickness: int = 1
    through_quarter_wave: int = 1
    corner_refinement: float = 0.12
    cavity_corner: float = math.inf
    growth: float = 8.0
    transducer_finer: float = 1.5
    gas_finer: float = 0.75
    film_finer: float = 1.0

    def refined(self, factor: float) -> Discretisation:
        """A copy with elements smaller by `factor`."""
        return replace(self, elements_per_wavelength=self.elements_per_wavelength * factor,
                       through_thickness=math.ceil(self.through_thickness * factor),
                       through_quarter_wave=math.ceil(self.through_quarter_wave * factor))

    def mesh_size(
        self, section: Section | FreeSection, materials: Mapping[str, Material], frequency: float, *,
        skins: Mapping[str, float] | None = None, radii: Sequence[float] = (), levels: Sequence[float] = (),
    ) -> MeshSize:
        """The element size for a section at `frequency` (Hz). `skins`, `radii` and `levels` are as in
        `geometry.mesh_size.MeshSize`."""
        speeds, films = self.mesh_speeds(section.regions, materials), film_speeds(section, materials, frequency)
        for region, speed in films.items():
            speeds[region] = min(speeds[region], speed / self.film_finer)
        return MeshSize(speeds, frequency, order=self.order,
                        elements_per_wavelength=self.elements_per_wavelength,
                        minimum_through_thickness=self.through_thickness,
                        minimum_through_quarter_wave=self.through_quarter_wave,
                        corner_refinement=self.corner_refinement, cavity_corner=self.cavity_corner,
                        growth=self.growth, skins=skins or {},
                        levels=(*film_levels(section, materials, films, frequency), *levels), radii=tuple(radii))

    def mesh_speeds(self, regions: tuple[str, ...], materials: Mapping[str, Material]) -> dict[str, float]:
        """The wave speed (m/s) for the mesh size, by region. It is infinite if empty."""
        return {region: materials[region].slowest_wave_speed() / self._finer(region, materials[region])
                if region in materials else math.inf for region in regions}

    def _finer(self, region: str, material: Material) -> float:
        if isinstance(material, Fluid) and material.density * material.sound_speed < GAS_IMPEDANCE:
            return self.gas_finer
        return self.transducer_finer if role_of(region) == TRANSDUCER else 1.0


def film_speeds(
    section: Section | FreeSection, materials: Mapping[str, Material], frequency: float
) -> dict[str, float]:
    """Speed (m/s) of the wave along films of fluid, by region.

    The films lie on elastic solids; `frequency` is in Hz. Flow along the film presses the solids apart, and the wave is
    slower in a thinner film: h k^3 = w^2 rho sum (1 - nu) / G over the solids beside it, without ceramics, which are
    far stiffer.
    """
    omega, found = 2.0 * math.pi * frequency, dict[str, float]()
    for film in section.rectangles:
        fluid = materials.get(film.region)
        if not isinstance(fluid, Fluid):
            continue
        beside = {r.region for r in _beside(section, film)}
        softness = sum(_softness(solid) for solid in (materials.get(region) for region in beside)
                       if isinstance(solid, IsotropicSolid | CubicSolid))
        if softness > 0.0:
            speed = (omega * (film.z_top - film.z_bottom) / (fluid.density * softness)) ** (1.0 / 3.0)
            found[film.region] = min(speed, found.get(film.region, math.inf))
    return found


def film_levels(
    section: Section | FreeSection, materials: Mapping[str, Material], speeds: Mapping[str, float], frequency: float
) -> tuple[float, ...]:
    """Heights (m) in solids beside films where the near field has decayed. `speeds` are those of :func:`film_speeds` at
    `frequency` (Hz). Solids too thin for a separate row have none."""
    found = set[float]()
    for film in (each for each in section.rectangles if each.region in speeds):
        if speeds[film.region] > materials[film.region].slowest_wave_speed():
            continue  # It is thicker than a film: sound in it is slower.
        depth = FILM_ROW * speeds[film.region] / (2.0 * math.pi * frequency)
        for solid in _beside(section, film):
            beside = materials.get(solid.region)
            if isinstance(beside, IsotropicSolid | CubicSolid) and depth < 0.5 * (solid.z_top - solid.z_bottom):
                above = solid.z_bottom >= film.z_top
                found.add(solid.z_bottom + depth if above else solid.z_top - depth)
    return tuple(sorted(found))


def _beside(section: Section | FreeSection, film: Rectangle) -> list[Rectangle]:
    """The rectangles directly above or below a film."""
    return [r for r in section.rectangles if r.z_top == film.z_bottom or r.z_bottom == film.z_top
            if r.r_inner < film.r_outer and r.r_outer > film.r_inner]


def _softness(solid: IsotropicSolid | CubicSolid) -> float:
    """Compliance (1 - nu) / G (1/Pa) of a solid. A crystal has its average."""
    bulk, shear = complex(solid.bulk_modulus).real, complex(solid.shear_modulus).real
    return (3.0 * bulk + 4.0 * shear) / (2.0 * shear * (3.0 * bulk + shear))


#: Discretisations by their largest rms error of ln Z over the band of every round chip in `geometry/chips`, in every
#: state, coarsest first: measured by `tests/benchmarks/discretisation.py`. Straight chips, with sharper resonances,
#: have errors of 0.41, 0.15, 0.08, 0.018 and 0.016 %.
ROWS: Mapping[float, Discretisation] = {
    # 0.38 %, 2 100 (disc_20x2) to 17 000 unknowns (acevedo_2026_chip empty)
    5e-3: Discretisation(4, 1.4, cavity_corner=0.12),
    1e-3: Discretisation(4, 1.8, cavity_corner=0.04),  # 0.077 %, to 26 000
    # 0.045 %, 3 800 to 34 300. For Z alone 30 000 would suffice: two elements across a lid and more along the gel serve
    # the recovered fields (`tests/benchmarks/recovered_fields.py`).
    5e-4: Discretisation(4, 1.9, through_quarter_wave=2, corner_refinement=0.16, cavity_corner=0.03, growth=5.0,
                         transducer_finer=1.54),
    2e-4: Discretisation(6, 1.2, cavity_corner=0.033, transducer_finer=1.15, gas_finer=0.85),  # 0.018 %, to 31 000
    # 0.0098 %, to 53 000
    1e-4: Discretisation(6, 1.4, corner_refinement=0.03, cavity_corner=0.01, growth=6.0, transducer_finer=1.15,
                         gas_finer=0.9),
}

#: Default relative accuracy of Z of a mesh. Doubled, a model has a quarter fewer unknowns.
ACCURACY = 5e-4


def discretisation(accuracy: float | Discretisation) -> Discretisation:
    """The coarsest of :data:`ROWS` with this rms error of ln Z.

    A `Discretisation` is returned as is.

    Raises:
        InputError: not an accuracy, or one finer than that of the last row.
    """
    if isinstance(accuracy, Discretisation):
        return accuracy
    finest = min(ROWS)
    wanted = (f"a relative error of Z of {finest:g} ({100.0 * finest:g} %), the finest there is, or more, below 1, or "
              f"a Discretisation; {ACCURACY:g} is usual")
    expect_number(accuracy, wanted, source="mesh", field="accuracy")
    if not finest * (1.0 - 1e-9) <= accuracy < 1.0:
        raise InputError("mesh", "accuracy", f"{accuracy:g}", wanted)
    fit = [row for row in ROWS if row <= accuracy * (1.0 + 1e-9)]
    return ROWS[max(fit)]
