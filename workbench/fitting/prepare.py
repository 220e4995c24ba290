"""The input of a fit: problems on two meshes, free parameters, starts.

A search ends somewhere also for a recording of another device. `check_device` therefore compares quantities that hardly
depend on the ceramic - static capacitance, strongly coupled resonance - with those of the geometry beforehand.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.measure import Axisymmetric, Measure, Straight
from geometry.names import TRANSDUCER
from geometry.parts import SIGNS
from geometry.straight import check_stated_length
from materials.kinds import IsotropicSolid, Material, Piezoelectric
from materials.registry import Registry
from workbench.files.errors import InputError, choose
from workbench.files.quantities import frequency_text
from workbench.fitting.held import constants, shown
from workbench.fitting.objective import FitRecording
from workbench.fitting.parameter import (
    POLYMER_FOUR,
    TRANSDUCER_TEN,
    Parameter,
    bench_parameter,
    dimension_parameter,
    material_parameter,
    parameters,
    shared_gain,
)
from workbench.fitting.search import SEARCHED_POINTS
from workbench.model.discretisation import ACCURACY, Discretisation, discretisation
from workbench.model.hidden import hidden_coefficients
from workbench.model.numbers import ParameterName
from workbench.model.problem import build, fill
from workbench.results.brief import Brief
from workbench.results.circuit import fit_circuit
from workbench.results.merit import Figures, NoResonance, figures
from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]

#: Kinds of fits, and the parameters that the paper frees in each.
KINDS: Mapping[str, tuple[str, ...]] = {"pzt": TRANSDUCER_TEN, "polymer": POLYMER_FOUR}

#: In a list of free parameters: those that the recording shows of a ceramic (`held.shown`), the paper's of a sample.
DEFAULT = "default"

#: The search is made on a mesh of this share of the elements per wavelength.
COARSE_MESH = 0.7

#: The static capacitance may lie this factor outside what geometry and material give between clamped and free: the
#: permittivities of data-sheet ceramics differ by 2.5, and its estimate from a narrow window by as much.
CAPACITANCE_FACTOR = 3.0

#: A resonance of at least this effective coupling is the fundamental one through the thickness (0.4 to 0.5) or along
#: the radius (0.5 to 0.6); it may lie this factor from where speed of sound and geometry put it.
STRONG, FREQUENCY_FACTOR = 0.3, 2.0

#: Phase across the radius of the first mode along it: of a thin disc the first root of x J0(x) = (1 - nu) J1(x) for
#: Poisson's ratio 0.31 of poled ceramics, of a thin plate in plane strain a quarter of a wave across half its width.
FIRST_PHASE: Mapping[type[Measure], float] = {Axisymmetric: 2.05, Straight: 0.5 * math.pi}


@dataclass(frozen=True, eq=False, repr=False)
class Prepared(Brief):
    """The input of `joint.fit_parameters`, and the device it is about.

    ``material`` is the one whose coefficients are free, as it fills its region, with the density that the chip states;
    ``coarse`` holds the recordings on the mesh of the search.
    """

    kind: str
    chip: Chip
    state: str
    material: Material
    recordings: tuple[FitRecording, ...]
    coarse: tuple[FitRecording, ...]
    parameters: tuple[Parameter, ...]


def prepare(
    chip: Chip, registry: Registry, *, kind: str, name: str, measured: Spectrum, state: str | None = None,
    material: str | None = None, region: str | None = None, free: Sequence[str] = (DEFAULT,),
    band: tuple[float, float] | None = None, accuracy: float | Discretisation = ACCURACY, check: bool = True,
) -> Prepared:
    """One recording of a chip, ready to fit; arguments as of `recordings.fit`.

    The gain that all points of the recording share is free too, if it is uncertain.

    Args:
        name: of the recording, in messages and results.
        check: refuse a recording that cannot be of this device.

    Raises:
        InputError: no such name, a material of another kind, too few points, or a recording that cannot be of this
            device (see :func:`check_device`).
        MeshError: the mesh could not be made.
    """
    choose(kind, KINDS, source="fit", field="kind")
    check_stated_length(chip.measure, chip.file, "the impedance, which is fitted to the recording,")
    state = chip.state(state).name
    where = free_region(chip, state, kind, region)
    if material is not None:
        chip = with_material(chip, state, where, material)
    device = fill(chip, state, registry)
    if where not in device.materials:
        raise InputError(chip.file, where, "vacuum", "a region with a material in it")
    freed = device.materials[where]
    if not isinstance(freed, Piezoelectric if kind == "pzt" else IsotropicSolid):
        raise InputError(chip.file, f"material of {where}", freed.name, "a piezoelectric material" if kind == "pzt"
                         else "an isotropic solid")
    part = in_band(measured, chip, band, name=name)
    if check:
        check_device(part, chip, device.materials, name=name)
    meshed_band = (float(part.frequency[0]), float(part.frequency[-1]))
    fine, coarse = (FitRecording(name, build(device, band=meshed_band, accuracy=mesh), part, chip)
                    for mesh in (discretisation(accuracy), discretisation(accuracy).refined(COARSE_MESH)))
    moved = parameters(fine.problem, chip, freed.name, [item for item in free if item != DEFAULT])
    if DEFAULT in free:
        beside = {p.name for p in moved}
        if kind == "pzt":
            candidates = [p for p in constants(coarse.problem, freed) if p.name not in beside]
            added = shown(coarse.thinned(SEARCHED_POINTS), candidates)
        else:
            added = parameters(coarse.problem, None, freed.name, KINDS[kind])
        moved = (*(p for p in added if p.name not in beside), *moved)
    if part.frequency.size < len(moved):
        raise InputError(name, "points", part.frequency.size,
                         f"at least as many as free parameters, {len(moved)}: free fewer or record more points")
    for hidden in hidden_coefficients(fine.problem):
        if any(parameter.parsed.key == hidden for parameter in moved):
            raise InputError("fit", "free", hidden, "a coefficient that plane strain shows: the spectrum of a straight "
                             "chip does not depend on this one; a disc of the material shows it")
    if part.shared_uncertainty and not any(p.is_bench and p.parsed.coefficient == "gain" for p in moved):
        moved = (*moved, shared_gain(part.shared_uncertainty))
    return Prepared(kind, chip, state, freed, (fine,), (coarse,), moved)


def free_region(chip: Chip, state: str, kind: str, region: str | None) -> str:
    """The region whose material is free.

    Raises:
        InputError: the chip has no such region, or no sample where none is named.
    """
    regions = chip.materials(state)
    if region is not None:
        return choose(region, regions, source=chip.file, field="region")
    if kind == "pzt":
        return TRANSDUCER
    if "sample" not in regions:
        raise InputError(chip.file, "layers", ", ".join(regions), "a layer with role 'sample', or the region whose "
                         "material is to be fitted named")
    return "sample"


def with_material(chip: Chip, state: str, region: str, material: str) -> Chip:
    """The chip with another material in a region, in one state. All places of the same material change."""
    names = chip.materials(state)
    replaced = {other: material for other, name in names.items() if name == names[region]}
    changed = replace(chip.state(state), materials={**chip.state(state).materials, **replaced})
    return replace(chip, states=tuple(changed if s.name == state else s for s in chip.states))


def in_band(measured: Spectrum, chip: Chip, band: tuple[float, float] | None, *, name: str) -> Spectrum:
    """The part of a recording in `band` (Hz), or the chip's own.

    Raises:
        InputError: fewer than two points lie there.
    """
    low, high = chip.band if band is None else band
    frequency = measured.frequency
    if np.count_nonzero((frequency >= low) & (frequency <= high)) < 2:
        raise InputError(name, "frequency", frequency_text(*frequency[[0, -1]]), f"2 points or more in the "
                         f"band, {frequency_text(low, high)}; a run may name another band")
    return measured.restricted(low, high)


def other_ceramics(prepared: Prepared, registry: Registry, besides: Sequence[str] = ()) -> tuple[str, ...]:
    """The names of other ceramics of a registry; none for a sample. Saved fits and those `besides` are excluded."""
    if not isinstance(prepared.material, Piezoelectric):
        return ()
    known = {prepared.material.name, *(registry.find(name)[0] for name in besides)}
    return tuple(name for name in registry.names() if "@" not in name and name not in known
                 and isinstance(registry.load(name, notes=[]), Piezoelectric))


def material_starts(prepared: Prepared, registry: Registry, names: Sequence[str]) -> dict[str, Real]:
    """Further starts (p,) by name: free coefficients of other materials.

    Losses a material does not state start by the rule of `parameter`. Fixed coefficients do not change: `prepare` uses
    another entry as a whole by its `material`. The search moves a parameter outside its bounds inside.

    Raises:
        InputError: no such material, or one of another kind.
    """
    result: dict[str, Real] = {}
    freed = prepared.material
    for name in names:
        other = registry.load(name, notes=[])
        if type(other) is not type(freed):
            raise InputError("fit", "start", name, f"a material of the kind of {freed.name}")
        values = {f"{other.name}.{key}": value for key, value in other.parameters().items()}
        beside = replace(prepared.recordings[0].problem, values=values, materials={TRANSDUCER: other})
        # A weighed density belongs to the part, not to the data sheet.
        result[other.name] = np.array([
            material_parameter(beside, other.name, p.parsed.local).start
            if p.is_material and p.parsed.owner == freed.name and p.parsed.local != "density" else p.start
            for p in prepared.parameters])
    return result


def prepare_together(group: Sequence[Prepared], *, own: Sequence[str] = ()) -> Prepared:
    """Several recordings in one fit, with parameters shared by name.

    Bench elements and `own` are not shared. `own` names dimensions or bench elements beside the free parameters.

    Raises:
        InputError: two recordings of one name, or a dimension that is free in one recording and is not in another.
    """
    recordings = [r for prepared in group for r in prepared.recordings]
    for name, count in Counter(r.name for r in recordings).items():
        if count > 1:
            raise InputError("fit", "recordings", name, "a name of its own for each recording")
    by_name: dict[tuple[str, tuple[str, ...]], Parameter] = {}
    for prepared in group:
        extra = [bench_parameter(name) if ParameterName.parse(name).is_bench
                 else dimension_parameter(prepared.chip, name) for name in own]
        for parameter in (*prepared.parameters, *extra):
            separate = parameter.is_bench or parameter.name in own
            acting = (prepared.recordings[0].name,) if separate else ()
            by_name.setdefault((parameter.name, acting), replace(parameter, recordings=acting))
    for parameter in by_name.values():
        for prepared in group:
            if parameter.is_dimension and not parameter.recordings and (
                    parameter.name not in prepared.chip.dimensions()):
                raise InputError(prepared.chip.file, "free", parameter.name, "a dimension of every chip of the group, "
                                 "or one named as each recording's own")
    return replace(group[0], recordings=tuple(recordings), coarse=tuple(r for p in group for r in p.coarse),
                   parameters=tuple(by_name.values()))


def check_device(measured: Spectrum, chip: Chip, materials: Mapping[str, Material], *, name: str) -> None:
    """Refuse a recording that cannot be of this chip.

    Raises:
        InputError: no resonance in the window, a static capacitance that is not within :data:`CAPACITANCE_FACTOR` of
            eps A / h with the permittivity between clamped and free, or a strongly coupled resonance that is not within
            :data:`FREQUENCY_FACTOR` of c / (2 h) or of the first radial mode; both numbers are given.
    """
    transducer = materials[TRANSDUCER]
    assert isinstance(transducer, Piezoelectric)
    layer, across = chip.transducer, chip.measure.across.replace("_", " ")
    wrong = (f"{chip.file} gives: this recording is not of this device, or one of thickness "
             f"{1e3 * layer.thickness.value:.4g} mm and {across} {1e3 * layer.radius.value:.4g} mm is wrong")
    merit = _resonance(measured, name)
    clamped, free = _capacitances(chip, transducer)
    # Factors by which it is too small or too large; any one may be misled, by a mode beside the antiresonance for one.
    off = {value: max(clamped / value, value / free) for value in _static_capacitances(measured, merit)}
    capacitance = min(off, key=lambda value: off[value])
    if off[capacitance] > CAPACITANCE_FACTOR:
        raise InputError(name, "capacitance", f"{1e12 * capacitance:.0f} pF measured",
                         f"near the {1e12 * clamped:.0f} pF (clamped) to {1e12 * free:.0f} pF (free) that {wrong}")
    if merit is None or merit.antiresonance is None or not merit.antiresonance.k_effective > STRONG:
        return
    through, along = _frequencies(chip, transducer)
    if all(abs(math.log(merit.f0 / expected)) > math.log(FREQUENCY_FACTOR) for expected in (through, along)):
        raise InputError(name, "resonance", f"{merit.f0 / 1e3:.4g} kHz measured, strongly coupled",
                         f"one near {through / 1e3:.4g} kHz (through the thickness) or {along / 1e3:.4g} kHz "
                         f"(along the {across}), which {wrong}")


def _resonance(measured: Spectrum, name: str) -> Figures | None:
    """Figures of the recording; None without a whole resonance and antiresonance.

    Raises:
        InputError: the window holds neither a whole resonance nor a whole antiresonance.
    """
    try:
        return figures(measured)
    except NoResonance as missing:
        if missing.candidates:
            return None
    try:
        figures(Spectrum(measured.frequency, measured.admittance))
    except NoResonance as missing:
        if not missing.candidates:
            low, high = measured.frequency[[0, -1]] / 1e3
            raise InputError(name, "window", f"{low:.6g} to {high:.6g} kHz", "a window with a resonance in it: |Z| "
                             "passes through it without a dip or a peak, so it says little of the material") from None
    return None


def _static_capacitances(measured: Spectrum, merit: Figures | None) -> list[float]:
    """Estimates of a recording's clamped capacitance (F): mean, and antiresonance or circuit."""
    # |Z| w C lies below one at resonances as far as above it at antiresonances.
    estimates = [float(np.exp(-np.mean(np.log(2.0 * np.pi * measured.frequency * measured.magnitude))))]
    anti = None if merit is None else merit.antiresonance
    if anti is not None and 0.0 < anti.circuit_capacitance < math.inf:
        estimates.append(anti.circuit_capacitance)
    elif merit is not None:
        with suppress(ValueError, RuntimeError):
            estimates.append(fit_circuit(measured).parameters["C0"].value)
    return [value for value in estimates if value > 0.0]


def _capacitances(chip: Chip, material: Piezoelectric) -> tuple[float, float]:
    """Clamped and free capacitance (F) of the transducer's electrodes."""
    layer = chip.transducer
    areas = [chip.measure.device_volume(0.0 if disc.inner_radius is None else disc.inner_radius.value,
                                        layer.outer_radius if disc.radius is None else disc.radius.value, 1.0)
             for disc in (chip.electrodes.live_disc, chip.electrodes.ground_disc)]
    # eps^T = eps^S + e c^-1 e^t; the strains along the radius and around it are equal.
    c11, c12, c13, c33, e31, e33 = _real(material, "c11", "c12", "c13", "c33", "e31", "e33")
    stiffness = np.array([[2.0 * (c11 + c12), 2.0 * c13], [2.0 * c13, c33]])
    coupling = np.array([2.0 * e31, e33])
    clamped = material.absolute_eps33.real
    free = clamped + float(coupling @ np.linalg.solve(stiffness, coupling))
    # The charge that a voltage V moves, by the voltages a V of the two halves: a half holds a^2 of its capacitance.
    signs = np.array([SIGNS[sign] for sign in chip.electrodes.halves or ("+", "+")])
    area = min(areas) * float(np.mean((chip.electrodes.share * signs) ** 2))
    return clamped * area / layer.thickness.value, free * area / layer.thickness.value


def _frequencies(chip: Chip, material: Piezoelectric) -> tuple[float, float]:
    """Fundamental frequencies (Hz) of the transducer, through its thickness and across.

    The first is the antiresonance c / (2 h) with the stiffness at constant electric displacement, the second
    :data:`FIRST_PHASE` c / (2 pi a) with that of a thin plate.
    """
    layer = chip.transducer
    c11, c13, c33, e33 = _real(material, "c11", "c13", "c33", "e33")
    through = math.sqrt((c33 + e33**2 / material.absolute_eps33.real) / material.density)
    along = math.sqrt((c11 - c13**2 / c33) / material.density)
    return through / (2.0 * layer.thickness.value), (
        FIRST_PHASE[type(chip.measure)] * along / (2.0 * math.pi * layer.outer_radius))


def _real(material: Piezoelectric, *keys: str) -> list[float]:
    return [complex(getattr(material, key)).real for key in keys]
