"""From a chip and a recording to the input of a fit: problems on two meshes, free parameters, starts - and a first
look.

A search takes a minute, and on a recording of something else it ends somewhere too. `check_device` therefore compares
quantities that hardly depend on the ceramic - the static capacitance, the frequency of the strongly coupled resonance -
with those of the geometry, before anything is meshed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.measure import Axisymmetric, Measure, Straight
from geometry.names import TRANSDUCER
from materials.kinds import IsotropicSolid, Material, Piezoelectric
from materials.registry import Registry
from workbench.files.errors import InputError, choose
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
from workbench.model.discretisation import ACCURACY, Discretisation, discretisation
from workbench.model.hidden import hidden_coefficients
from workbench.model.numbers import ParameterName
from workbench.model.problem import build, fill
from workbench.results.brief import Brief
from workbench.results.circuit import fit_circuit
from workbench.results.merit import Antiresonance, Figures, NoResonance, figures
from workbench.results.spectrum import Spectrum

Real = NDArray[np.float64]

#: Kinds of fits, and the parameters that each frees by default.
KINDS: Mapping[str, tuple[str, ...]] = {"pzt": TRANSDUCER_TEN, "polymer": POLYMER_FOUR}

#: In a list of free parameters: those of the kind.
DEFAULT = "default"

#: The search is made on a mesh of this share of the elements per wavelength.
COARSE = 0.7

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

    ``material`` is the one whose coefficients are free, as it fills its region (with the chip's density for it), in the
    state the fit starts from; ``coarse`` holds the same recordings on the mesh of the search.
    """

    kind: str
    chip: Chip
    state: str
    material: Material
    recordings: tuple[FitRecording, ...]
    coarse: tuple[FitRecording, ...]
    parameters: tuple[Parameter, ...]


def prepare(
    chip: Chip,
    registry: Registry,
    *,
    kind: str,
    name: str,
    measured: Spectrum,
    state: str | None = None,
    material: str | None = None,
    region: str | None = None,
    free: Sequence[str] = (DEFAULT,),
    band: tuple[float, float] | None = None,
    accuracy: float | Discretisation = ACCURACY,
    check: bool = True,
) -> Prepared:
    """One recording of a chip, ready to be fitted.

    A gain of all points of the recording is free beside the parameters that are asked for.

    Args:
        kind: "pzt" frees the transducer's material, "polymer" that of the sample.
        name: of the recording, in messages and results.
        state: of the chip; its last by default.
        material: what the fit starts from, in place of the chip's material of that region.
        region: whose material is free, in place of the kind's own.
        free: names of parameters (see `parameter.parameters`); "default" stands for those of the kind.
        band: in Hz; the chip's own by default. The part of the recording within it is fitted.
        accuracy: relative error of Z that the mesh is made for, or a discretisation of your own.
        check: refuse a recording that cannot be of this device.

    Raises:
        InputError: no such name, a material of another kind, too few points, or a recording that cannot be of this
            device (see :func:`check_device`).
        MeshError: the mesh could not be made.
    """
    choose(kind, KINDS, source="fit", field="kind")
    state = chip.state(state).name
    where = free_region(chip, state, kind, region)
    if material is not None:
        chip = with_material(chip, state, where, material)
    device = fill(chip, state, registry)
    filling = device.materials
    if where not in filling:
        raise InputError(chip.file, where, "vacuum", "a region with a material in it")
    freed = filling[where]
    expected = Piezoelectric if kind == "pzt" else IsotropicSolid
    if not isinstance(freed, expected):
        raise InputError(chip.file, f"material of {where}", freed.name, "a piezoelectric material" if kind == "pzt"
                         else "an isotropic solid")
    wanted = [name for item in free for name in (KINDS[kind] if item == DEFAULT else (item,))]
    part = in_band(measured, chip, band, name=name)
    if part.frequency.size < len(wanted):
        raise InputError(name, "points", part.frequency.size,
                         f"at least as many as free parameters, {len(wanted)}: free fewer or record more points")
    if check:
        check_device(part, chip, filling, name=name)
    meshed_band = (float(part.frequency[0]), float(part.frequency[-1]))
    fine, coarse = (
        build(device, band=meshed_band, accuracy=mesh)
        for mesh in (discretisation(accuracy), discretisation(accuracy).refined(COARSE)))
    moved = parameters(fine, chip, freed.name, wanted)
    for hidden in hidden_coefficients(fine):
        if any(parameter.parsed.key == hidden for parameter in moved):
            raise InputError("fit", "free", hidden, "a coefficient that plane strain shows: the spectrum of a straight "
                             "chip does not depend on this one; a disc of the material shows it")
    if part.shared_uncertainty and not any(p.is_bench and p.parsed.coefficient == "gain" for p in moved):
        moved = (*moved, shared_gain(part.shared_uncertainty))
    return Prepared(kind, chip, state, freed, (FitRecording(name, fine, part, chip),),
                    (FitRecording(name, coarse, part, chip),), moved)


def free_region(chip: Chip, state: str, kind: str, region: str | None) -> str:
    """The region whose material is free.

    Raises:
        InputError: the chip has no such region, or no sample and no other region was named.
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
    """The chip with another material, in one state, in a region and wherever else the same material is."""
    names = chip.materials(state)
    replaced = {other: material for other, name in names.items() if name == names[region]}
    changed = replace(chip.state(state), materials={**chip.state(state).materials, **replaced})
    return replace(chip, states=tuple(changed if s.name == state else s for s in chip.states))


def in_band(measured: Spectrum, chip: Chip, band: tuple[float, float] | None, *, name: str) -> Spectrum:
    """The part of a recording in the band (Hz), the chip's own unless given.

    Raises:
        InputError: fewer than two points lie there.
    """
    low, high = chip.band if band is None else band
    frequency = measured.frequency
    if np.count_nonzero((frequency >= low) & (frequency <= high)) < 2:
        raise InputError(name, "frequency", f"{frequency[0]:g} to {frequency[-1]:g} Hz", f"2 points or more in the "
                         f"band, {low:g} to {high:g} Hz; another band may be asked for")
    return measured.restricted(low, high)


def material_starts(prepared: Prepared, registry: Registry, names: Sequence[str]) -> dict[str, Real]:
    """Further starts: the free parameters as other materials of the registry have them, labelled by their names.

    Losses a material does not state start by the rule of `parameter`; what is no coefficient of the freed material
    starts where it does anyway. A number outside the bounds is moved inside when the search begins.

    Raises:
        InputError: no such material, or one of another kind.
    """
    result: dict[str, Real] = {}
    for name in names:
        other = registry.load(name)
        if type(other) is not type(prepared.material):
            raise InputError("fit", "start", name, f"a material of the kind of {prepared.material.name}")
        values = {f"{other.name}.{key}": value for key, value in other.parameters().items()}
        beside = replace(prepared.recordings[0].problem, values=values, materials={TRANSDUCER: other})
        vector = []
        for parameter in prepared.parameters:
            own = parameter.parsed.local
            # A weighed density belongs to the part, not to the data sheet.
            moves = (parameter.is_material and parameter.parsed.owner == prepared.material.name and own != "density")
            vector.append(material_parameter(beside, other.name, own).start if moves else parameter.start)
        result[other.name] = np.array(vector)
    return result


def prepare_together(group: Sequence[Prepared], *, own: Sequence[str] = ()) -> Prepared:
    """Several recordings fitted at once: parameters of one name are shared, except those named in `own`.

    Bench elements are always each recording's own. `own` names dimensions or bench elements, on top of what every
    recording frees itself.

    Raises:
        InputError: two recordings of one name, or a dimension that is free in one recording and is not in another.
    """
    names = [r.name for p in group for r in p.recordings]
    for name in names:
        if names.count(name) > 1:
            raise InputError("fit", "recordings", name, "a name of its own for each recording")
    found: dict[tuple[str, tuple[str, ...]], Parameter] = {}
    for prepared in group:
        label = (prepared.recordings[0].name,)
        extra = [bench_parameter(name) if ParameterName.parse(name).is_bench
                 else dimension_parameter(prepared.chip, name) for name in own]
        for parameter in (*prepared.parameters, *extra):
            separate = parameter.is_bench or parameter.name in own
            key = (parameter.name, label if separate else ())
            found.setdefault(key, replace(parameter, recordings=key[1]))
    for parameter in found.values():
        if parameter.is_dimension and not parameter.recordings:
            for prepared in group:
                if parameter.name not in prepared.chip.dimensions():
                    raise InputError(prepared.chip.file, "free", parameter.name, "a dimension of every chip of the "
                                     "group, or one named as each recording's own")
    first = group[0]
    return Prepared(first.kind, first.chip, first.state, first.material,
                    tuple(r for p in group for r in p.recordings), tuple(r for p in group for r in p.coarse),
                    tuple(found.values()))


# --------------------------------------------------------------------------------------------------------------------
# Whether a recording can be of this device at all.


def check_device(measured: Spectrum, chip: Chip, materials: Mapping[str, Material], *, name: str) -> None:
    """Refuse a recording that cannot be of this chip.

    Three questions: is there a resonance in the window; is the static capacitance within a factor of
    :data:`CAPACITANCE_FACTOR` of eps A / h, with the permittivity between clamped and free; and does a strongly coupled
    resonance lie within a factor of :data:`FREQUENCY_FACTOR` of c / (2 h) or of the first radial mode.

    Raises:
        InputError: one of the answers is no; both numbers are given.
    """
    transducer = materials[TRANSDUCER]
    assert isinstance(transducer, Piezoelectric)
    merit = _resonance(measured, name)
    clamped, free = _capacitances(chip, transducer)
    # Factors by which it is too small or too large; any one may be misled, by a mode beside the antiresonance for one.
    off = {value: max(clamped / value, value / free) for value in _static_capacitances(measured, merit)}
    capacitance = min(off, key=lambda value: off[value])
    if off[capacitance] > CAPACITANCE_FACTOR:
        raise InputError(name, "capacitance", f"{1e12 * capacitance:.0f} pF measured",
                         f"near the {1e12 * clamped:.0f} pF (clamped) to {1e12 * free:.0f} pF (free) that {chip.file} "
                         f"gives: this recording is not of this device, or one of {_sizes(chip)} is wrong")
    if merit is None or merit.antiresonance is None or not merit.antiresonance.k_effective > STRONG:
        return
    thickness, across = _frequencies(chip, transducer)
    if all(abs(math.log(merit.f0 / expected)) > math.log(FREQUENCY_FACTOR) for expected in (thickness, across)):
        raise InputError(name, "resonance", f"{merit.f0 / 1e3:.4g} kHz measured, strongly coupled",
                         f"one near {thickness / 1e3:.4g} kHz (through the thickness) or {across / 1e3:.4g} kHz "
                         f"(along the {_across(chip)}), which {chip.file} gives: this recording is not of this device, "
                         f"or one of {_sizes(chip)} is wrong")


def _sizes(chip: Chip) -> str:
    layer = chip.transducer
    return (f"thickness {1e3 * layer.thickness.value:.4g} mm and {_across(chip)} "
            f"{1e3 * layer.radius.value:.4g} mm")


def _across(chip: Chip) -> str:
    return chip.measure.across.replace("_", " ")


def _resonance(measured: Spectrum, name: str) -> Figures | None:
    """Figures of the recording; None where a part of a resonance or antiresonance is all there is.

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
    """The clamped capacitance (F) that a recording shows: as a mean, and of the antiresonance or else the circuit."""
    # |Z| w C lies below one at resonances as far as above it at antiresonances.
    found = [float(np.exp(-np.mean(np.log(2.0 * np.pi * measured.frequency * measured.magnitude))))]
    anti: Antiresonance | None = None if merit is None else merit.antiresonance
    if anti is not None and math.isfinite(anti.circuit_capacitance) and anti.circuit_capacitance > 0.0:
        found.append(anti.circuit_capacitance)
    elif merit is not None:
        with suppress(ValueError, RuntimeError):
            found.append(fit_circuit(measured).parameters["C0"].value)
    return [value for value in found if value > 0.0]


def _capacitances(chip: Chip, material: Piezoelectric) -> tuple[float, float]:
    """Capacitance (F) of the electrodes with the transducer clamped, and free to strain in every direction."""
    layer = chip.transducer
    areas = []
    for disc in (chip.electrodes.live_disc, chip.electrodes.ground_disc):
        outer = layer.outer_radius if disc.radius is None else disc.radius.value
        inner = 0.0 if disc.inner_radius is None else disc.inner_radius.value
        areas.append(chip.measure.device_volume(inner, outer, 1.0))
    # eps^T = eps^S + e c^-1 e^t; the strains along the radius and around it are equal.
    stiffness = np.array([[2.0 * (material.c11 + material.c12).real, 2.0 * complex(material.c13).real],
                          [2.0 * complex(material.c13).real, complex(material.c33).real]])
    coupling = np.array([2.0 * complex(material.e31).real, complex(material.e33).real])
    clamped = material.absolute_eps33.real
    free = clamped + float(coupling @ np.linalg.solve(stiffness, coupling))
    return clamped * min(areas) / layer.thickness.value, free * min(areas) / layer.thickness.value


def _frequencies(chip: Chip, material: Piezoelectric) -> tuple[float, float]:
    """Fundamental frequencies (Hz) of the transducer alone through its thickness (antiresonance) and along its radius,
    or across its width.

    c / (2 h) with the stiffness at constant electric displacement, and :data:`FIRST_PHASE` c / (2 pi a) with that of a
    thin plate.
    """
    layer = chip.transducer
    c11, c13, c33, e33 = (complex(getattr(material, key)).real for key in ("c11", "c13", "c33", "e33"))
    through = math.sqrt((c33 + e33**2 / material.absolute_eps33.real) / material.density)
    along = math.sqrt((c11 - c13**2 / c33) / material.density)
    return through / (2.0 * layer.thickness.value), (
        FIRST_PHASE[type(chip.measure)] * along / (2.0 * math.pi * layer.outer_radius))

