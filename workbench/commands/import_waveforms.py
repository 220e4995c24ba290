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
from workbench.files.quantities import frequency_text, parse_quantity
from workbench.instruments.instrument import Waveform
from workbench.report.measurement import pairs_table
from workbench.results.spectrum import write_spectrum

if TYPE_CHECKING:
    from rich.console import Console

#: Files of `import`.
OUTPUTS = Outputs("import", names=("ratios.csv", "spectrum.csv"))


def run_import_waveforms(options: argparse.Namespace, console: Console) -> int:
    """``workbench import``: ratios of pairs of waveforms, and the impedance. The impedance needs a resistor or a
    current probe."""
    resistance, tolerance = _resistor(options)
    probe = options.current is not None
    second = options.current if probe else options.reference
    if options.total == second:
        raise InputError("command line", "--current" if probe else "--reference", second, "another channel than "
                         "--total")
    pairs = pair_files(options.files, total=options.total, reference=second)
    found, refused, unstated = [], [], False
    for name, (total, reference) in pairs.items():
        try:
            waveforms = _waveforms((total, options.total), (reference, second))
            _check_units(waveforms, (total, reference), probe=probe, resistance=resistance)
            unstated |= waveforms[1].unit != "A"
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
    if probe and resistance is None:
        resistance = 1.0
        if unstated:
            console.print(f"CH{second} states no unit: its numbers are read as ampere; --resistance \"0.1 ohm\" "
                          "states a probe of 0.1 V/A", style="yellow", markup=False)
    if resistance is not None:
        values = [impedance([pair.fit], resistance, probe=probe) for pair in found]
        if len(found) > 1:
            frequencies = [pair.fit.frequency for pair in found]
            if len(set(frequencies)) < len(frequencies):
                raise InputError("command line", "FILE", [frequency_text(f) for f in frequencies],
                                 "pairs of different frequencies; without --resistance or --current only ratios are "
                                 "written")
            spectrum = pairs_spectrum(found, values, resistance, tolerance, probe=probe)
            write_spectrum(spectrum, folder / "spectrum.csv")
    print_table(f"CH{options.total} over CH{second}", pairs_table(found, values))
    if len(found) == 1 and values is not None:
        console.print("one frequency: no spectrum.csv was written, which needs captures at two frequencies or more",
                      style="yellow", markup=False)
    for pair in found:
        if pair.clipped:
            console.print(f"{pair.name}: a crest is cut flat; the ratio is not to be trusted", style="yellow",
                          markup=False)
    return 1 if refused else 0


def _waveforms(total: tuple[Path, int], reference: tuple[Path, int]) -> tuple[Waveform, Waveform]:
    if total[0] == reference[0]:
        channels = read_channels(total[0], wanted=(total[1], reference[1]))
        return channels[total[1]], channels[reference[1]]
    return read_waveform(total[0]), read_waveform(reference[0])


def _check_units(
    waveforms: tuple[Waveform, Waveform], files: tuple[Path, Path], *, probe: bool, resistance: float | None
) -> None:
    total, second = waveforms
    if total.unit == "A":
        raise InputError(str(files[0]), f"CH{total.channel}", "A", "V: --total names the channel of the voltage")
    if second.unit == "A" and not probe:
        raise InputError(str(files[1]), f"CH{second.channel}", "A", "V across the resistor; of a current through the "
                         f"device --current {second.channel} without --resistance makes Z = V / I")
    if second.unit == "A" and resistance is not None:
        raise InputError("command line", "--resistance", f"{resistance:g} ohm", f"none, since CH{second.channel} is in "
                         "A")
    if second.unit == "V" and probe and resistance is None:
        raise InputError(str(files[1]), f"CH{second.channel}", "V", "A, or the volts per ampere of the current probe: "
                         '--resistance "0.1 ohm" for 0.1 V/A')


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
