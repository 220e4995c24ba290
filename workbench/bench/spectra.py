"""Results of a run: a spectrum for every drive level, with flags."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench import readers
from workbench.bench.compensation import Compensation, Load, compensate
from workbench.bench.impedance import common_uncertainty
from workbench.bench.plan import combined_points
from workbench.bench.run_file import Run, RunPoint, read_run
from workbench.bench.setup import BenchSetup, Standards
from workbench.files.errors import InputError
from workbench.results.brief import Brief
from workbench.results.spectrum import Origin, Spectrum

#: Inductance (henry) of a lead of some 10 cm: the error without compensation.
_USUAL_LEAD = 0.2e-6

#: Ratio (rms) of the differences of passes to their noise above which they have drifted.
_DRIFT = 1.5


@dataclass(frozen=True, eq=False, repr=False)
class LevelSpectrum(Brief):
    """The spectrum at one drive level (V peak to peak, open circuit).

    ``spectrum`` has the whole standard uncertainty: ``noise`` (n,) ohm, different at every point, and ``common``, a
    fraction of Z that all points share. ``uncompensated`` is as measured. ``drift`` is the rms difference of the passes
    over their noise, nan for one pass. ``flags`` are about the whole, ``point_flags`` (Hz, words) about points.
    """

    level: float
    spectrum: Spectrum
    noise: NDArray[np.float64]
    common: float
    uncompensated: Spectrum
    drift: float
    flags: tuple[str, ...]
    point_flags: tuple[tuple[float, str], ...]


def read_compensation(standards: Standards) -> Compensation:
    """The recordings of the fixture named in BENCH.toml. They are run files, or spectra in any format of
    :mod:`workbench.readers`."""
    columns = None if standards.columns is None else readers.read_column_map(standards.columns)
    load = None
    if standards.load is not None and standards.load_resistance is not None:
        load = Load(_standard(standards.load, columns), standards.load_resistance, standards.load_tolerance)
    return Compensation(None if standards.open is None else _standard(standards.open, columns),
                        None if standards.short is None else _standard(standards.short, columns), load)


def _standard(path: Path, columns: readers.ColumnMap | None) -> Spectrum:
    if path.suffix not in (".h5", ".hdf5"):
        return readers.read_recording(path, columns=columns).spectrum
    run = read_run(path)
    levels = {point.level for point in run.points}
    if len(levels) != 1 or len({point.frequency for point in run.points}) < 2:
        raise InputError(str(path), "points", f"{len(run.points)} points at {len(levels)} drive levels",
                         "a run over 2 frequencies or more at one level")
    return replace(combined_points(run.points), origin=Origin("measured", str(path)))


def level_spectra(run: Run, setup: BenchSetup, compensation: Compensation) -> tuple[LevelSpectrum, ...]:
    """A spectrum for every drive level with two frequencies or more. Levels are in the setup's order."""
    by_level = [(level, [point for point in run.points if point.level == level]) for level in setup.levels]
    return tuple(_level_spectrum(level, points, run, setup, compensation) for level, points in by_level
                 if len({point.frequency for point in points}) >= 2)


def results(
    levels: Sequence[LevelSpectrum], compensation: Compensation
) -> dict[str, dict[str, NDArray[np.float64] | NDArray[np.complex128]]]:
    """Spectra and calibration as arrays by group and name."""
    found: dict[str, dict[str, NDArray[np.float64] | NDArray[np.complex128]]] = {}
    for level in levels:
        group = found[f"spectrum {level.level:g} Vpp"] = _arrays(level.spectrum)
        group |= {"noise": level.noise, "common": np.array(level.common),
                  "uncompensated": level.uncompensated.impedance}
    load = compensation.load
    recorded = {"open": compensation.open, "short": compensation.short, "load": None if load is None else load.recorded}
    for name, spectrum in recorded.items():
        if spectrum is not None:
            found[f"calibration {name}"] = _arrays(spectrum)
    if load is not None:
        found["calibration load"] |= {"resistance": np.array(load.resistance), "tolerance": np.array(load.tolerance)}
    return found


def _arrays(spectrum: Spectrum) -> dict[str, NDArray[np.float64] | NDArray[np.complex128]]:
    arrays: dict[str, NDArray[np.float64] | NDArray[np.complex128]] = {
        "frequency": spectrum.frequency, "impedance": spectrum.impedance}
    return arrays if spectrum.uncertainty is None else {**arrays, "uncertainty": spectrum.uncertainty}


def _level_spectrum(
    level: float, points: Sequence[RunPoint], run: Run, setup: BenchSetup, compensation: Compensation
) -> LevelSpectrum:
    measured = combined_points(points)
    drift = _drift(points, measured)
    if drift > _DRIFT and measured.uncertainty is not None:
        # The uncertainty is multiplied by the ratio.
        measured = replace(measured, uncertainty=measured.uncertainty * drift)
    measured = replace(measured, origin=_origin(level, run, setup, compensation))
    device = compensate(measured, compensation)
    assert device.uncertainty is not None  # compensate() always states it
    if compensation.load is None:
        common = common_uncertainty(setup.reference.tolerance, setup.acquisition.gain_accuracy)
    else:
        common = compensation.load.tolerance / math.sqrt(3.0)
    whole = replace(device, uncertainty=np.hypot(device.uncertainty, common * device.magnitude),
                    shared_uncertainty=common)
    words = [(point.frequency, flag) for point in points for flag in point.flags]
    return LevelSpectrum(level, whole, device.uncertainty, common, measured, drift,
                         _flags(run, device, measured, compensation, drift, words), tuple(words))


def _drift(points: Sequence[RunPoint], mean: Spectrum) -> float:
    """Root of the reduced chi-square of repeated points about their mean. nan if there are none."""
    value = dict(zip(mean.frequency, mean.impedance, strict=True))
    squares = sum(abs(p.impedance - value[p.frequency]) ** 2 / p.uncertainty**2 for p in points)
    freedom = 2 * (len(points) - len(mean.frequency))
    return math.sqrt(squares / freedom) if freedom else math.nan


def _origin(level: float, run: Run, setup: BenchSetup, compensation: Compensation) -> Origin:
    started = datetime.fromtimestamp(run.created, tz=UTC).isoformat(timespec="seconds")
    settings = {"run": run.run_id, "drive": f"{level:g} Vpp open circuit",
                "reference resistor": f"{setup.reference.resistance:g} ohm, limits {setup.reference.tolerance:.3%}",
                "compensation": str(compensation), "setup sha256": hashlib.sha256(run.setup_text.encode()).hexdigest(),
                **setup.metadata}
    return Origin("measured", instrument="; ".join(run.instruments.values()), date=started, settings=settings)


def _flags(
    run: Run, device: Spectrum, measured: Spectrum, compensation: Compensation, drift: float,
    words: Sequence[tuple[float, str]],
) -> tuple[str, ...]:
    found = []
    if not run.complete:
        found.append("the run is not complete: resume it, or use it as it is")
    lowest = int(np.argmin(device.magnitude))
    at, least = float(device.frequency[lowest]), float(device.magnitude[lowest])
    if compensation.short is None:
        reactance = 2.0 * math.pi * at * _USUAL_LEAD
        if reactance > 0.01 * least:
            found.append(
                f"the cable was not compensated (no short was recorded): {_USUAL_LEAD * 1e6:g} uH of lead are "
                f"{reactance:.2g} ohm at {at / 1e6:.4g} MHz, {100.0 * reactance / least:.0f} % of the smallest |Z|")
    else:
        moved = np.abs(device.impedance / measured.impedance - 1.0)
        most = int(np.argmax(moved))
        found.append(f"compensation ({compensation}) moves Z by {100.0 * float(np.median(moved)):.2g} % in the middle "
                     f"and by {100.0 * float(moved[most]):.2g} % at {device.frequency[most] / 1e6:.4g} MHz")
    if compensation.short is not None and (compensation.open is None or compensation.load is None):
        found.append(f"of open, short and load only {compensation} was recorded: the effect of the others is not in "
                     "the uncertainty")
    if drift > _DRIFT:
        found.append(f"passes disagree by {drift:.1f} times their noise: the device or the bench drifts; the "
                     "uncertainty was enlarged by as much")
    counts = Counter(flag.split(":")[0] for _, flag in words)
    found += [f"{kind}: {count} points" for kind, count in counts.items()]
    return tuple(found)
