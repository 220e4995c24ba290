"""Inhomogeneity: random fields of stiffness, mass and loss in parts.

No part of a real device is as homogeneous as its material's constants. Its stiffness, mass and loss differ by random
fields (Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425) of zero mean, a size that is averaged over and the
correlation

    <a(x) a(x')> = exp(-|x - x'|^2 / (2 l^2)),   l a quarter of the shortest wavelength in the region,

the same in all states. Fields of some tenths of a per cent in all parts make evidences smaller and fit nothing. A field
of any size in one region is a hypothesis outside the catalogue. A field is a sum of cosines over the region's rectangle
with independent amplitudes, whose variances are the spectrum of that correlation (Rasmussen and Williams 2006, Gaussian
Processes for Machine Learning, section 4.2). The change of ln Z by each cosine is a quadratic form of the states
(:func:`changes`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from skfem import MeshQuad

from geometry.names import TRANSDUCER, parent_place
from materials.kinds import CubicSolid, Fluid, IsotropicSolid, Material, Piezoelectric
from workbench.fem.energy import LOSS, MASS, STIFFNESS, cell_forms
from workbench.fem.operators import FullOperators
from workbench.fitting.objective import Objective
from workbench.model.problem import Problem
from workbench.physics.cosine_mode import CosineMode, VaryingProperty
from workbench.physics.piezoelectric import PiezoelectricSolid
from workbench.reduced.predictor import Prediction

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


#: Points of a recording with solved states; a spline gives the points between. A resonance of a free disc is a
#: thirtieth of its band wide: with 121, splines missed a fifth of its changes.
POINTS = 401

#: Frequencies whose states are in memory at a time. Doubled, they take 40 MB more on a mesh of 40 000 unknowns.
TOGETHER = 64

#: Cosines whose amplitude has less than this share of the variance of the first are left out.
LEFT_OUT = 0.05

#: A region, the row of :func:`changes`, and half waves along r and z.
Key = tuple[str, int, int, int]


@dataclass(frozen=True, eq=False)
class Inhomogeneity:
    """Changes of the data by inhomogeneity of a relative size of one.

    Rows are real and then imaginary parts of ln Z, by recording. ``parts`` (m, k) is that of all parts, with losses
    relative to their value; ``regions`` holds that of each region (m, k), with losses relative to the stiffness.
    """

    parts: Real
    regions: Mapping[str, Real]


def cosine_modes(problem: Problem, frequency: float) -> Iterator[tuple[CosineMode, float]]:
    """The cosine modes along the transducer's radius, with their amplitude deviations. These are those of a field of
    unit size.

    The resonances are so sharp that the inhomogeneity of a disc moves them by their width: ln Z is not linear in these.
    The correlation length is that at the `frequency` (Hz).
    """
    material, mesh = problem.materials.get(TRANSDUCER), problem.mesh.mesh
    if not isinstance(material, Piezoelectric):
        return
    size = _rectangle(mesh, mesh.subdomains[TRANSDUCER])[1]
    integrals, radius = PiezoelectricSolid(TRANSDUCER, material.name).integrals(), float(size[0])
    for (i, k), deviation in cosines(size, _correlation_length(material, frequency)):
        if k == 0:
            for uneven in VaryingProperty:
                yield CosineMode.of(integrals, uneven, i, radius, problem.values), deviation


def cosine_keys(acting: Iterable[CosineMode]) -> set[Key]:
    """The changes by cosine modes that are parameters."""
    rows = {VaryingProperty.STIFFNESS: STIFFNESS, VaryingProperty.DENSITY: MASS}
    return {(each.region, rows[each.varying], each.half_waves, 0) for each in acting}


def inhomogeneity(objective: Objective, x: Real, acting: Collection[Key] = ()) -> Inhomogeneity:
    """The inhomogeneity of the device at x (p,), without the keys `acting`. These are parameters already."""
    # The stated uncertainty of an observable is far above the changes of a field by parts that are nearly homogeneous.
    spectra = [k for k, recording in enumerate(objective.recordings) if recording.observable is None]
    sparse = objective.thinned(POINTS)
    columns: dict[Key, Complex] = {}
    known: list[tuple[Prediction, dict[Key, Complex]]] = []
    ends = np.cumsum([0, *(recording.measured.frequency.size for recording in objective.recordings)]).tolist()
    for k in spectra:
        recording, few = objective.recordings[k], sparse.recordings[k].measured.frequency
        frequency = recording.measured.frequency
        prediction = sparse.predict(x, k, ())[2]
        # Recordings of one solution share their changes.
        slopes_by_key = next((each for other, each in known if other.solution is prediction.solution), None)
        if slopes_by_key is None:
            slopes_by_key = _of_recording(prediction, recording.problem.materials, float(np.mean(frequency[[0, -1]])))
            known.append((prediction, slopes_by_key))
        slopes = np.stack(list(slopes_by_key.values()), axis=1)
        if frequency.size > few.size:
            slopes = CubicSpline(few, slopes)(frequency)
        for key, slope in zip(slopes_by_key, slopes.T, strict=True):
            columns.setdefault(key, np.zeros(ends[-1], dtype=complex))[ends[k]:ends[k + 1]] += slope

    def as_data(taken: Iterable[Complex]) -> Real:
        """Columns (m, k) of real and then imaginary parts, recording after recording."""
        whole = np.reshape(list(taken), (-1, ends[-1])).T
        return np.concatenate([part for each in np.split(whole, ends[1:-1]) for part in (each.real, each.imag)])

    regions: dict[str, list[Complex]] = {}
    for (region, row, *_), column in columns.items():
        if row != LOSS:
            regions.setdefault(region, []).extend([column, 1j * column] if row == STIFFNESS else [column])
    beside = [column for key, column in columns.items() if key not in acting]
    return Inhomogeneity(as_data(beside), {region: as_data(each) for region, each in regions.items()})


def _of_recording(
    prediction: Prediction, materials: Mapping[str, Material], frequency: float
) -> dict[Key, Complex]:
    """The change d ln Z (n,) of a recording by each cosine. Cosines without a change are omitted."""
    model, solution = prediction.model, prediction.solution
    mesh = model.full.mesh.mesh
    fields = []
    for region, cells in mesh.subdomains.items():
        # A layer's part of a region, or one that holds nothing in this state.
        if parent_place(region) == region and region in materials:
            share, size = _rectangle(mesh, cells)
            modes = cosines(size, _correlation_length(materials[region], frequency))
            cosine = [weight * np.cos(np.pi * i * share[0]) * np.cos(np.pi * k * share[1]) for (i, k), weight in modes]
            fields.append((region, cells, [numbers for numbers, _ in modes], np.array(cosine)))
    parts_by_key: dict[Key, list[Complex]] = {}
    for start in range(0, solution.omega.size, TOGETHER):
        some = slice(start, start + TOGETHER)
        states = model.basis @ solution.states[:, some]
        forms = changes(model.full, states, solution.coefficients[some], solution.charge[some])
        for region, cells, numbers, shapes in fields:
            for row in (STIFFNESS, MASS, LOSS):
                for (i, k), part in zip(numbers, np.conj(shapes @ forms[row, cells]), strict=True):
                    parts_by_key.setdefault((region, row, i, k), []).append(part)
    whole = {key: np.concatenate(parts) for key, parts in parts_by_key.items()}
    return {key: slope for key, slope in whole.items() if slope.any()}


def cosines(size: Real, length: float) -> list[tuple[tuple[int, int], float]]:
    """Cosine modes of a rectangle of `size` (2,) m, with amplitude deviations.

    Modes are half waves along r and z. The field has unit variance and a Gaussian correlation of `length` (m).
    """
    counts = [int(side / (np.pi * length) * np.sqrt(-np.log(LEFT_OUT))) + 1 for side in size]
    variance = np.ones((counts[0], counts[1]))
    for axis, (count, side) in enumerate(zip(counts, size, strict=True)):
        number = np.arange(count)
        along = np.exp(-0.5 * (np.pi * number * length / side) ** 2)
        variance = variance * (along[:, None] if axis == 0 else along)
    # The mean of the square of a cosine is a half, of a constant one.
    mean = np.outer(np.where(np.arange(counts[0]) > 0, 0.5, 1.0), np.where(np.arange(counts[1]) > 0, 0.5, 1.0))
    amplitude = np.sqrt(variance / mean / variance.sum())
    return [((i, j), float(amplitude[i, j])) for i, j in np.argwhere(variance > LEFT_OUT).tolist()]


def _rectangle(mesh: MeshQuad, cells: NDArray[np.int64]) -> tuple[Real, Real]:
    """Cell centres (2, cells) as shares of their rectangle, and its size. The rectangle around the cells begins at the
    axis; its size (2,) is in m."""
    corners = mesh.p[:, mesh.t[:, cells]]
    low, high = corners.min(axis=(1, 2)), corners.max(axis=(1, 2))
    low[0] = 0.0
    return (corners.mean(axis=1) - low[:, None]) / (high - low)[:, None], high - low


def _correlation_length(material: Material, frequency: float) -> float:
    """A quarter of the shortest wavelength (m) in a material. `frequency` is in Hz."""
    return 0.25 * _slowest(material) / frequency


def _slowest(material: Material) -> float:
    """The speed (m/s) of the slowest wave of a material."""
    match material:
        case Piezoelectric():
            return float(np.sqrt(abs(complex(material.c44)) / material.density))
        case IsotropicSolid():
            return float(np.sqrt(abs(complex(material.shear_modulus)) / material.density))
        case CubicSolid() | Fluid():
            return material.slowest_wave_speed()
        case _:
            raise TypeError(f"{material!r} carries no waves that are known")


def changes(operators: FullOperators, states: Complex, coefficients: Complex, charge: Complex) -> Complex:
    """d ln Z (3, cells, n) by changes of every cell.

    Rows are relative changes of stiffness, mass and loss, e^{-i w t}, for `states` (size, n), `coefficients` (n,
    integrals) and `charge` (n,) C.
    """
    return cell_forms(operators, states, states, coefficients) / charge
