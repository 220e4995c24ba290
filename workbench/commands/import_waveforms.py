"""``workbench import``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from workbench.bench.impedance import impedance
from workbench.bench.pairs import WaveformPair, pairs_spectrum, write_ratios
from workbench.bench.sine_fit import NoSine, fit_sines
from workbench.bench.waveforms import pair_files, read_channels, read_waveform
from workbench.commands.parsed_options import output_folder
from workbench.commands.terminal import print_table
from workbench.files.errors import InputError
from workbench.files.ownership import Outputs
from workbench.files.quantities import parse_quantity
from workbench.instruments.instrument import Waveform
from workbench.report.measurement import pairs_table
from workbench.results.spectrum import write_spectrum

if TYPE_CHECKING:
    from rich.console import Console

#: Files of `import`.
OUTPUTS = Outputs("import", names=("ratios.csv", "spectrum.csv"))


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
            found.append(WaveformPair(name, fit_sines(waveforms), any(w.clipped for w in waveforms)))
        except (InputError, NoSine) as error:
            refused.append(f"{name}: {error}")
    for reason in refused:
        console.print("refused:", style="bold red", end=" ")
        console.print(reason, markup=False)
    if not found:
        raise InputError("command line", "FILE", len(pairs), "at least one pair that can be read")
    folder = output_folder(options, OUTPUTS)
    found.sort(key=lambda pair: pair.fit.frequency)
    write_ratios(found, folder / "ratios.csv")
    values = None
    if resistance is not None:
        values = [impedance([pair.fit], resistance) for pair in found]
        if len(found) > 1:
            frequencies = [pair.fit.frequency for pair in found]
            if len(set(frequencies)) < len(frequencies):
                raise InputError("command line", "FILE", [f"{f:.6g} Hz" for f in frequencies],
                                 "pairs of different frequencies; without --resistance only ratios are written")
            write_spectrum(pairs_spectrum(found, values, resistance, tolerance), folder / "spectrum.csv")
    print_table(f"CH{options.total} over CH{options.reference}", pairs_table(found, values))
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
