"""The discrepancy of a model: small, smooth, unknown relative changes of stiffness, mass and loss within the parts.

A part of a real device is not as homogeneous as its material's constants, and a mesh not as fine as its fields. Each
region's stiffness, mass and loss is therefore allowed to differ by a random field (Kennedy and O'Hagan 2001, J. R.
Stat. Soc. B 63, 425) of zero mean, unit variance (which the accuracy of the model scales) and the correlation

    <a(x) a(x')> = exp(-|x - x'|^2 / (2 l^2)),   l a quarter of the shortest wavelength in the region,

the same in all states. A field is a sum of cosines over the region's rectangle with independent amplitudes, whose
variances are the spectrum of that correlation (Rasmussen and Williams 2006, Gaussian Processes for Machine Learning,
section 4.2). The change of ln Z by each cosine, one discrepancy mode, is a quadratic form of the states
(:func:`changes`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from geometry.names import parent_place
from materials.kinds import Fluid, IsotropicSolid, Material, Piezoelectric
from workbench.fem.operators import FullOperators
from workbench.fem.solve import Solution
from workbench.fitting.objective import Objective
from workbench.physics.term import OPERATORS, Integral
from workbench.reduced.predictor import Prediction

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Kinds of fields. A region's own loss changes relative to its value.
STIFFNESS, MASS, LOSS = "stiffness", "mass", "loss"

#: Points of a recording that states are made at.
POINTS = 121

#: Cosines whose amplitude has less than this share of the variance of the first are left out.
LEFT_OUT = 0.05


#: A region, the kind of the field there, and half waves along r and z.
Key = tuple[str, str, int, int]


@dataclass(frozen=True, eq=False)
class DiscrepancyModes:
    """Changes of the data by smooth fields within parts.

    ``columns`` (m, k) are the changes of the real and then the imaginary parts of ln Z, recording after recording, by
    one standard deviation of each mode at a relative size of one; ``keys`` (k,) the region, the kind and the numbers of
    the cosine of each.
    """

    columns: Real
    keys: tuple[Key, ...]

    @classmethod
    def of(cls, columns: Mapping[Key, Real]) -> DiscrepancyModes:
        """The modes from the column (m,) of each."""
        return cls(np.stack(list(columns.values()), axis=1), tuple(columns))

    @property
    def regions(self) -> tuple[str, ...]:
        """The region of each (k,)."""
        return tuple(region for region, *_ in self.keys)

    def of_region(self, region: str) -> Real:
        """The columns of one region."""
        return self.columns[:, [k for k, each in enumerate(self.regions) if each == region]]

    def stacked(self, other: DiscrepancyModes) -> DiscrepancyModes:
        """The modes of these recordings and then of others of one device."""
        ends = len(self.columns), len(self.columns) + len(other.columns)
        columns = {key: np.zeros(ends[1]) for key in (*self.keys, *other.keys)}
        for rows, each in ((slice(ends[0]), self), (slice(*ends), other)):
            for key, column in zip(each.keys, each.columns.T, strict=True):
                columns[key][rows] = column
        return DiscrepancyModes.of(columns)


@dataclass(frozen=True, eq=False)
class PredictedRecording:
    """A recording predicted at n frequencies (Hz): ``slopes`` (3, cells, n) of :func:`changes`."""

    frequency: Real
    operators: FullOperators
    slopes: Complex


def predicted_recordings(objective: Objective, x: Real) -> list[PredictedRecording]:
    """Every recording of an objective as predicted at x (p,); recordings of one solution share their slopes."""
    found: list[PredictedRecording] = []
    known: list[tuple[Solution, FullOperators, Complex]] = []
    for k in range(len(objective.predictors)):
        _, _, prediction = objective.predict(x, k, ())
        same = next((each for each in known if each[0] is prediction.solution), None)
        if same is None:
            operators, states = prediction.full
            same = prediction.solution, operators, changes(operators, states, prediction)
            known.append(same)
        found.append(PredictedRecording(objective.recordings[k].measured.frequency, *same[1:]))
    return found


def discrepancy_modes(objective: Objective, x: Real) -> tuple[DiscrepancyModes, DiscrepancyModes]:
    """The :class:`DiscrepancyModes` at x (p,) of a usual discrepancy, and of changes of any size within a region.

    In the latter a loss differs relative to the stiffness. States are computed at about :data:`POINTS` of the points of
    a recording, and a spline gives the points between.
    """
    every = predicted_recordings(objective.thinned(POINTS), x)
    total = sum(2 * recording.measured.frequency.size for recording in objective.recordings)
    columns: tuple[dict[Key, Real], ...] = ({}, {})
    start = 0
    for each, recording in zip(every, objective.recordings, strict=True):
        frequency = recording.measured.frequency
        middle = float(np.mean(frequency[[0, -1]]))
        found = list(_of_recording(each, recording.problem.materials, middle))
        slopes = np.stack([slope for *_, slope in found], axis=1)
        if frequency.size > each.frequency.size:
            slopes = CubicSpline(each.frequency, slopes)(frequency)
        rows = slice(start, start + 2 * frequency.size)
        for (region, kind, mode, of, _), slope in zip(found, slopes.T, strict=True):
            for which in of:
                column = columns[which].setdefault((region, kind, *mode), np.zeros(total))
                column[rows] += np.concatenate([slope.real, slope.imag])
        start = rows.stop
    return DiscrepancyModes.of(columns[0]), DiscrepancyModes.of(columns[1])


def _of_recording(
    found: PredictedRecording, materials: Mapping[str, Material], frequency: float
) -> Iterator[tuple[str, str, tuple[int, int], tuple[int, ...], Complex]]:
    """Region, kind, number of the cosine, the one of the two results of :func:`discrepancy_modes` it belongs to, and d
    ln Z (n,) of every mode of a recording."""
    mesh = found.operators.mesh.mesh
    for region, cells in mesh.subdomains.items():
        # A layer's part of a region, or one that holds nothing in this state.
        if parent_place(region) != region or region not in materials:
            continue
        corners = mesh.p[:, mesh.t[:, cells]]
        low, high = corners.min(axis=(1, 2)), corners.max(axis=(1, 2))
        low[0] = 0.0
        share = (corners.mean(axis=1) - low[:, None]) / (high - low)[:, None]
        length = 0.25 * _slowest(materials[region]) / frequency
        for mode, weight in cosines(high - low, length):
            shape = weight * np.cos(np.pi * mode[0] * share[0]) * np.cos(np.pi * mode[1] * share[1])
            for number, kind in enumerate((STIFFNESS, MASS, LOSS)):
                slopes = found.slopes[number, cells]
                if slopes.any():
                    slope = np.conj(shape @ slopes)
                    yield region, kind, mode, (0,) if kind == LOSS else (0, 1), slope
                    if kind == STIFFNESS:
                        yield region, LOSS, mode, (1,), 1j * slope


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
    kept = variance > LEFT_OUT
    return [((i, j), float(amplitude[i, j])) for i, j in zip(*np.nonzero(kept), strict=True)]


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
    kinds = [_kind(integral) for integral in operators.integrals]
    g = prediction.solution.coefficients
    used = [q for q, kind in enumerate(kinds) if kind is not None and g[:, q].any()]
    result = np.zeros((3, operators.mesh.mesh.t.shape[1], g.shape[0]), dtype=complex)
    for q, forms in zip(used, operators.of(np.array(used)).element_quadratic(states, states), strict=True):
        cells = operators.places[operators.integrals[q].domain].elements
        stiff = kinds[q] == STIFFNESS
        result[0 if stiff else 1][cells] += g[:, q] * forms
        if stiff and g[:, q].imag.any():
            result[2][cells] += 1j * g[:, q].imag * forms
    return result / prediction.solution.charge


def _kind(integral: Integral) -> str | None:
    """The kind, stiffness or mass, of an integral over cells; None for all others."""
    if integral.on_boundary:
        return None
    taken = {(component[0], kind == "value") for product in integral.products
             for name in (product.row, product.column) for component, kind, _ in OPERATORS[name]}
    components = {component for component, _ in taken}
    if components == {"u"}:
        return MASS if all(value for _, value in taken) else STIFFNESS
    if components == {"p"}:
        return STIFFNESS if all(value for _, value in taken) else MASS
    return None
