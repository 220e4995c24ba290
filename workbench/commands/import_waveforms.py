"""``workbench import``."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from workbench.bench.impedance import PointImpedance, impedance
from workbench.bench.sine_fit import NoSine, SineFit, fit_sines
from workbench.bench.waveforms import pair_files, read_channels, read_waveform
from workbench.commands.asked import output_folder
from workbench.commands.terminal import print_table
from workbench.files.errors import InputError
from workbench.files.quantities import parse_quantity
from workbench.files.writing import write_atomic
from workbench.instruments.instrument import Waveform
from workbench.report.page import TextTable
from workbench.results.spectrum import Origin, Spectrum, write_spectrum

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True, eq=False)
class ImportedPair:
    """One pair: its fit, and the ratio total / reference, e^{+j w t}, with its relative standard uncertainty."""

    name: str
    fit: SineFit
    ratio: complex
    relative: float
    clipped: bool


def run_import_waveforms(options: argparse.Namespace, console: Console) -> int:
    """``workbench import``: ratios of pairs of waveforms and, with a resistor, the impedance."""
    resistance, tolerance = _resistor(options)
    if options.total == options.reference:
        raise InputError("command line", "--reference", options.reference, "another channel than --total")
    pairs = pair_files(options.files, total=options.total, reference=options.reference)
    found = []
    refused = []
    for name, (total, reference) in pairs.items():
        try:
            waveforms = _waveforms(options, total, reference)
            fit = fit_sines(waveforms)
        except (InputError, NoSine) as error:
            refused.append(f"{name}: {error}")
            continue
        ratio = complex(fit.amplitude[0] / fit.amplitude[1])
        relative = float(np.hypot(*(fit.uncertainty / np.abs(fit.amplitude))))
        found.append(ImportedPair(name, fit, ratio, relative, any(w.clipped for w in waveforms)))
    for reason in refused:
        console.print("refused:", style="bold red", end=" ")
        console.print(reason, markup=False)
    if not found:
        raise InputError("command line", "FILE", len(pairs), "at least one pair that can be read")
    folder = output_folder(options.output)
    found.sort(key=lambda pair: pair.fit.frequency)
    lines = ["pair,frequency_hz,ratio_magnitude,ratio_phase_deg,relative_uncertainty,clipped"]
    lines += [f"{p.name},{p.fit.frequency!r},{abs(p.ratio)!r},{_degrees(p.ratio)!r},{p.relative!r},{int(p.clipped)}"
              for p in found]
    write_atomic(folder / "ratios.csv", "\n".join(lines) + "\n")
    values = None
    if resistance is not None:
        values = [impedance([pair.fit], resistance) for pair in found]
        if len(found) > 1:
            write_spectrum(_spectrum(found, values, resistance, tolerance), folder / "spectrum.csv")
    print_table(f"CH{options.total} over CH{options.reference}", _table(found, values))
    if len(found) == 1 and values is not None:
        console.print("one frequency: no spectrum.csv was written, which takes captures at two frequencies or more",
                      style="yellow", markup=False)
    for pair in found:
        if pair.clipped:
            console.print(f"{pair.name}: a crest is cut flat; the ratio is not to be trusted", style="yellow",
                          markup=False)
    return 1 if refused else 0


def _waveforms(options: argparse.Namespace, total: Path, reference: Path) -> tuple[Waveform, Waveform]:
    """The two channels of a pair, in one file or in two."""
    if total == reference:
        channels = read_channels(total)
        return channels[options.total], channels[options.reference]
    return read_waveform(total), read_waveform(reference)


def _resistor(options: argparse.Namespace) -> tuple[float | None, float]:
    """Resistance (ohm) or None, and its limits as a fraction."""
    tolerance = parse_quantity(options.tolerance, "share", source="command line", field="--tolerance")
    if not 0.0 <= tolerance < 1.0:
        raise InputError("command line", "--tolerance", options.tolerance, 'from "0 %" to less than "100 %"')
    if options.resistance is None:
        return None, tolerance
    resistance = parse_quantity(options.resistance, "resistance", source="command line", field="--resistance")
    if resistance <= 0.0:
        raise InputError("command line", "--resistance", options.resistance, "a resistance above zero")
    return resistance, tolerance


def _spectrum(
    pairs: list[ImportedPair], values: list[PointImpedance], resistance: float, tolerance: float
) -> Spectrum:
    """The pairs as a spectrum.

    Raises:
        InputError: a frequency twice.
    """
    frequency = np.array([pair.fit.frequency for pair in pairs])
    if np.any(np.diff(frequency) <= 0.0):
        raise InputError("command line", "FILE", [f"{f:.6g} Hz" for f in frequency],
                         "pairs of different frequencies; without --resistance only ratios are written")
    impedances = np.array([value.value for value in values])
    noise = np.array([value.random for value in values])
    common = np.abs(impedances) * tolerance / math.sqrt(3.0)
    settings = {"reference resistor": f"{resistance:g} ohm, limits {tolerance:.3%}", "compensation": "none"}
    return Spectrum(frequency, impedances, np.hypot(noise, common),
                    Origin("measured", ", ".join(pair.name for pair in pairs), settings=settings))


def _table(pairs: list[ImportedPair], values: list[PointImpedance] | None) -> TextTable:
    columns = ("pair", "frequency (Hz)", "ratio", "phase (degrees)", "uncertainty (%)")
    rows = [(p.name, f"{p.fit.frequency:.6g}", f"{abs(p.ratio):.5g}", f"{_degrees(p.ratio):.2f}",
             f"{100.0 * p.relative:.2g}") for p in pairs]
    if values is None:
        return TextTable(columns, tuple(rows))
    return TextTable((*columns, "|Z| (ohm)", "phase of Z (degrees)"), tuple(
        (*row, f"{abs(v.value):.5g}", f"{_degrees(v.value):.2f}") for row, v in zip(rows, values, strict=True)))


def _degrees(value: complex) -> float:
    return math.degrees(math.atan2(value.imag, value.real))
