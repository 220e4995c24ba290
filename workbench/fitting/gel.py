"""The spectrum of a fitted sample by gel thickness, without refits. See Acevedo-Espinosa et al. (RP-UEIS), section 4.3
and Fig. 6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.chip import Chip
from materials.registry import Registry
from workbench.fem.operators import assemble
from workbench.files.errors import InputError
from workbench.fitting.measurement_model import CLOCK, through_bench
from workbench.fitting.prepare import Prepared
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.model.numbers import placed
from workbench.model.problem import build, fill
from workbench.reduced.at_point import reduce
from workbench.results.comparison import Comparison, compare
from workbench.results.spectrum import Origin, Spectrum

COUPLANT = "couplant"

#: The thicknesses (m) of the paper and its mean errors of |Z| (%).
PUBLISHED = {5e-6: 26.19, 20e-6: 25.91, 50e-6: 32.82}


@dataclass(frozen=True, eq=False)
class GelCase:
    """A gel thickness (m), its predicted spectrum, and their mismatch."""

    thickness: float
    spectrum: Spectrum
    comparison: Comparison


def with_gel(chip: Chip, thickness: float) -> Chip:
    """The chip with another thickness (m) of its gel.

    Raises:
        InputError: the chip has no couplant, or is none with that thickness.
    """
    if COUPLANT not in chip.regions:
        raise InputError(chip.file, "layers", ", ".join(chip.regions), f"a layer with role {COUPLANT!r}")
    return chip.with_dimensions({f"{COUPLANT}.thickness": thickness})


def gel_study(
    prepared: Prepared, registry: Registry, *, numbers: Mapping[str, float], thicknesses: Sequence[float],
    accuracy: float | Discretisation = ACCURACY,
) -> tuple[GelCase, ...]:
    """Predict the first recording with `numbers` (SI) and each thickness (m).

    Raises:
        InputError: see :func:`with_gel`.
    """
    recording = prepared.recordings[0]
    chip = prepared.chip.with_dimensions({p.name: numbers[p.name] for p in prepared.parameters if p.is_dimension})
    bench = {p.name: numbers[p.name] for p in prepared.parameters if p.is_bench}
    values = placed(recording.problem.values, {p.name: numbers[p.name] for p in prepared.parameters if p.is_material})
    frequency = recording.measured.frequency
    cases = []
    for thickness in thicknesses:
        problem = build(fill(with_gel(chip, thickness), prepared.state, registry), band=recording.problem.band,
                        accuracy=accuracy)
        model = reduce(assemble(problem.mesh, problem.terms), frequency, values, tolerance=1e-4)
        solution = model.solve(frequency * (1.0 + bench.get(CLOCK, 0.0)), values)
        recorded, _, _ = through_bench(np.conj(solution.impedance), solution.omega, bench)
        spectrum = Spectrum(frequency, recorded, origin=Origin("simulated"))
        cases.append(GelCase(thickness, spectrum, compare(recording.measured, spectrum)))
    return tuple(cases)
