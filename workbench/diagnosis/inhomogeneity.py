"""Inhomogeneity: stiffness, mass and loss that differ from place to place as nobody knows, within all parts or in one.

No part of a real device is as homogeneous as its material's constants. Its stiffness, mass and loss differ by random
fields (Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425) of zero mean, a size that is averaged over and the
correlation

    <a(x) a(x')> = exp(-|x - x'|^2 / (2 l^2)),   l a quarter of the shortest wavelength in the region,

the same in all states: of some tenths of a per cent in all parts, which makes evidences smaller and fits nothing, and
of any size in one region, which is a hypothesis outside the catalogue. A field is a sum of cosines over the region's
rectangle with independent amplitudes, whose variances are the spectrum of that correlation (Rasmussen and Williams
2006, Gaussian Processes for Machine Learning, section 4.2). The change of ln Z by each cosine is a quadratic form of
the states (:func:`changes`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from skfem import MeshQuad

from geometry.names import TRANSDUCER, parent_place
from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric
from workbench.fem.operators import FullOperators, pair_of
from workbench.fitting.objective import Objective
from workbench.model.problem import Problem
from workbench.physics.piezoelectric import PiezoelectricSolid
from workbench.physics.term import OPERATORS, Integral
from workbench.physics.uneven import UnevenProperty, UnevenSolid
from workbench.reduced.predictor import Prediction

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Rows of :func:`changes`.
STIFFNESS, MASS, LOSS = range(3)

#: Points of a recording that states are made at; a spline gives the points between. A resonance of a free disc is a
#: thirtieth of its band wide: with 121, splines left out a fifth of its changes.
POINTS = 401

#: Cosines whose amplitude has less than this share of the variance of the first are left out.
LEFT_OUT = 0.05

#: A region, the row of :func:`changes`, and half waves along r and z.
Key = tuple[str, int, int, int]


@dataclass(frozen=True, eq=False)
class PredictedRecording:
    """A recording predicted at n frequencies (Hz): ``slopes`` (3, cells, n) of :func:`changes`."""

    frequency: Real
    operators: FullOperators
    slopes: Complex


def predicted_recordings(objective: Objective, x: Real) -> list[PredictedRecording]:
    """Every recording of an objective as predicted at x (p,); recordings of one solution share their slopes."""
    found: list[PredictedRecording] = []
    known: list[tuple[Prediction, FullOperators, Complex]] = []
    for k in range(len(objective.predictors)):
        if objective.recordings[k].observable is not None:
            found.append(PredictedRecording(objective.recordings[k].measured.frequency, objective.predictors[k].every,
                                            np.zeros((3, 0, 1), dtype=complex)))
            continue
        _, _, prediction = objective.predict(x, k, ())
        same = next((each for each in known if each[0].solution is prediction.solution), None)
        if same is None:
            operators, states = prediction.full
            same = prediction, operators, changes(operators, states, prediction)
            known.append(same)
        found.append(PredictedRecording(objective.recordings[k].measured.frequency, *same[1:]))
    return found


@dataclass(frozen=True, eq=False)
class Inhomogeneity:
    """Changes of the data by inhomogeneity of a relative size of one: real and then imaginary parts of ln Z, recording
    after recording.

    ``parts`` (m, k) is that of all parts, where a loss differs relative to its value; ``regions`` holds that of each
    region (m, k), where it differs relative to the stiffness.
    """

    parts: Real
    regions: Mapping[str, Real]


def waves(problem: Problem, frequency: float) -> Iterator[tuple[UnevenSolid, float]]:
    """The waves along the radius of a problem's transducer, each with the deviation of its amplitude in a field of unit
    size.

    Its resonances are so sharp that the inhomogeneity of a disc moves them by their width: ln Z is not linear in these.
    The correlation length is that at the `frequency` (Hz).
    """
    material, mesh = problem.materials.get(TRANSDUCER), problem.mesh.mesh
    if not isinstance(material, Piezoelectric):
        return
    size = _rectangle(mesh, mesh.subdomains[TRANSDUCER])[1]
    integrals, radius = PiezoelectricSolid(TRANSDUCER, material.name).integrals(), float(size[0])
    for (i, k), deviation in cosines(size, _correlation_length(material, frequency)):
        if k == 0:
            for uneven in UnevenProperty:
                yield UnevenSolid.of(integrals, uneven, i, radius, problem.values), deviation


def wave_keys(acting: Iterable[UnevenSolid]) -> set[Key]:
    """The changes by waves that are parameters."""
    rows = {UnevenProperty.STIFFNESS: STIFFNESS, UnevenProperty.DENSITY: MASS}
    return {(each.region, rows[each.uneven], each.half_waves, 0) for each in acting}


def inhomogeneity(objective: Objective, x: Real, acting: Collection[Key] = ()) -> Inhomogeneity:
    """The inhomogeneity of the device at x (p,), the parts without those that are `acting` as parameters."""
    # The stated uncertainty of an observable is far above the changes of a field by parts that are nearly homogeneous.
    spectra = [(k, recording) for k, recording in enumerate(objective.recordings) if recording.observable is None]
    every = predicted_recordings(objective.thinned(POINTS).among({recording.name for _, recording in spectra}), x)
    columns: dict[Key, Complex] = {}
    ends = np.cumsum([0, *(recording.measured.frequency.size for recording in objective.recordings)]).tolist()
    for each, (k, recording) in zip(every, spectra, strict=True):
        low, high = ends[k], ends[k + 1]
        frequency = recording.measured.frequency
        found = dict(_of_recording(each, recording.problem.materials, float(np.mean(frequency[[0, -1]]))))
        slopes = np.stack(list(found.values()), axis=1)
        if frequency.size > each.frequency.size:
            slopes = CubicSpline(each.frequency, slopes)(frequency)
        for key, slope in zip(found, slopes.T, strict=True):
            columns.setdefault(key, np.zeros(ends[-1], dtype=complex))[low:high] += slope

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
    found: PredictedRecording, materials: Mapping[str, Material], frequency: float
) -> Iterator[tuple[Key, Complex]]:
    """Every change of a recording with its d ln Z (n,)."""
    mesh = found.operators.mesh.mesh
    for region, cells in mesh.subdomains.items():
        # A layer's part of a region, or one that holds nothing in this state.
        if parent_place(region) != region or region not in materials:
            continue
        share, size = _rectangle(mesh, cells)
        for (i, k), weight in cosines(size, _correlation_length(materials[region], frequency)):
            shape = weight * np.cos(np.pi * i * share[0]) * np.cos(np.pi * k * share[1])
            for row, slopes in enumerate(found.slopes[:, cells]):
                if slopes.any():
                    yield (region, row, i, k), np.conj(shape @ slopes)


def cosines(size: Real, length: float) -> list[tuple[tuple[int, int], float]]:
    """Numbers of half waves along r and z of a rectangle of that `size` (2,) m, and the deviation of each amplitude.

    Of a field of unit variance with a Gaussian correlation of that `length` (m).
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
    """The middles (2, cells) of some cells as shares of the rectangle around them, which begins at the axis, and its
    size (2,) in m."""
    corners = mesh.p[:, mesh.t[:, cells]]
    low, high = corners.min(axis=(1, 2)), corners.max(axis=(1, 2))
    low[0] = 0.0
    return (corners.mean(axis=1) - low[:, None]) / (high - low)[:, None], high - low


def _correlation_length(material: Material, frequency: float) -> float:
    """A quarter of the shortest wavelength (m) in a material at a frequency (Hz)."""
    return 0.25 * _slowest(material) / frequency


def _slowest(material: Material) -> float:
    """The speed (m/s) of the slowest wave of a material."""
    match material:
        case Piezoelectric():
            return float(np.sqrt(abs(complex(material.c44)) / material.density))
        case IsotropicSolid():
            return float(np.sqrt(abs(complex(material.shear_modulus)) / material.density))
        case Fluid():
            return material.sound_speed
        case _:
            raise TypeError(f"{material!r} carries no waves that are known")


def changes(operators: FullOperators, states: Complex, prediction: Prediction) -> Complex:
    """d ln Z (3, cells, n), e^{-i w t}, by a relative change of stiffness, of mass and of loss of every cell."""
    return cell_forms(operators, states, states, prediction.solution.coefficients) / prediction.solution.charge


def cell_forms(operators: FullOperators, left: Complex, right: Complex, coefficients_of: Complex) -> Complex:
    """Forms left^T A right (3, cells, n), A the stiffness, the mass and the loss of every cell.

    For columns `left` and `right` (size, n), and the coefficients (n, integrals) of the integrals.
    """
    kinds = [_kind(integral) for integral in operators.integrals]
    used = [q for q, kind in enumerate(kinds) if kind is not None and coefficients_of[:, q].any()]
    part, count = operators.of(np.array(used, dtype=int)), right.shape[1]
    known = {id(integral): q for q, integral in zip(used, part.integrals, strict=True)}
    result = np.zeros((3, operators.mesh.mesh.t.shape[1], count), dtype=complex)
    for place, forms in part.pair_forms(left, right):
        # The coefficients of all integrals of the place are summed first.
        weights = {pair: np.zeros((3, count), dtype=complex) for pair in forms}
        for integral in part.by_place[place]:
            q = known[id(integral)]
            g, kind = coefficients_of[:, q], kinds[q]
            for product in integral.products:
                weight = weights[*pair_of(product), integral.radial]
                weight[kind] += product.weight * g
                if kind == STIFFNESS:
                    weight[LOSS] += 1j * product.weight * g.imag
        cells = part.places[place].elements
        for pair, form in forms.items():
            for row in np.flatnonzero(weights[pair].any(axis=1)):
                result[row, cells] += weights[pair][row] * form
    return result


def _kind(integral: Integral) -> int | None:
    """The kind, stiffness or mass, of an integral over cells; None for all others."""
    if integral.on_boundary:
        return None
    taken = {(component.partition("_")[0], kind == "value") for product in integral.products
             for name in (product.row, product.column) for component, kind, _ in OPERATORS[name]}
    components = {component for component, _ in taken}
    if components == {"u"}:
        return MASS if all(value for _, value in taken) else STIFFNESS
    if components == {"p"}:
        return STIFFNESS if all(value for _, value in taken) else MASS
    return None
