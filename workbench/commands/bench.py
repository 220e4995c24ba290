"""``workbench bench``: ports, a check of the bench, and a simulated bench."""

from __future__ import annotations

import argparse
import math
import re
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from geometry.chip import read_chip
from workbench.bench.impedance import impedance
from workbench.bench.pairs import degrees
from workbench.bench.rig import Rig, marker_path
from workbench.bench.setup import BenchSetup, read_bench
from workbench.bench.sine_fit import NoSine, fit_sines
from workbench.commands.parsed_options import model_options, reading_option
from workbench.commands.terminal import print_line, print_table, say_finding
from workbench.fem.operators import assemble
from workbench.files.errors import InputError, choose
from workbench.files.quantities import parse_quantity
from workbench.instruments.circuit import IDEAL, TYPICAL, Device, device_of, open_circuit, resistor
from workbench.instruments.faults import KINDS, Fault, FaultKind
from workbench.instruments.instrument import InstrumentError
from workbench.instruments.opening import found_ports, who_answers
from workbench.instruments.simulated import Drift, SimulatedBench
from workbench.instruments.simulated_oscilloscope import Errors
from workbench.model.problem import build, fill
from workbench.reduced.at_point import reduce
from workbench.report.page import TextTable
from workbench.results.spectrum import Spectrum
from workbench.simulation.solved_spectrum import frequency_grid

if TYPE_CHECKING:
    from rich.console import Console

#: Largest plausible ratio of a signal to the open-circuit voltage, with the errors of probes and generator.
POSSIBLE = 1.1

#: Least amplitude of a signal in converter steps, zero to peak.
LEAST_COUNTS = 4

#: The pairs of probes that a simulated bench may have.
PROBES = {f"{total},{reference}": (total, reference) for total in (1, 10) for reference in (1, 10)}


def run_bench(options: argparse.Namespace, console: Console) -> int:
    """``workbench bench``."""
    actions: dict[str, Callable[[argparse.Namespace, Console], int]] = {
        "list": _list, "check": _check, "simulate": _simulate}
    return actions[options.action](options, console)


def _list(options: argparse.Namespace, console: Console) -> int:
    """Print every port, the named ones too, and their instruments."""
    ports = [(port.name, port.description) for port in found_ports()]
    ports += [(name, "named") for name in options.ports if name not in dict(ports)]
    if not ports:
        console.print("no serial port and no USBTMC device file found; plug the instruments in, or name a port")
        return 1
    rows = []
    for name, description in ports:
        try:
            answer = who_answers(name, timeout=options.timeout)
        except InstrumentError as error:
            answer = f"({str(error).removeprefix(f'{name}: ')})"
        rows.append((name, description, answer or "nothing answers"))
    print_table("Ports", TextTable(("port", "description", "instrument"), tuple(rows)))
    return 0


def _check(options: argparse.Namespace, console: Console) -> int:
    """Identify both instruments, set and read back, capture once, print faults. The drive is off at the end."""
    setup = read_bench(options.bench)
    try:
        with Rig(setup, marker_path(options.bench)) as rig:
            print_line(f"generator      {rig.identities['generator']} at {setup.generator.port}, drive off")
            print_line(f"oscilloscope   {rig.identities['oscilloscope']} at {setup.oscilloscope.port}, a capture made")
            found = _check_signals(setup, rig)
    except InstrumentError as error:
        found = [str(error)]
    for text in found:
        console.print("wrong:", style="bold red", end=" ")
        console.print(text, markup=False)
    if not found:
        print_line("nothing is wrong; the drive is off")
    return 1 if found else 0


def _check_signals(setup: BenchSetup, rig: Rig) -> list[str]:
    """Faults of the signals at mid-sweep, at the smallest amplitude, in words."""
    frequency = round(0.5 * (setup.sweep.low + setup.sweep.high), 2)
    amplitude = math.floor(100.0 * min(*setup.levels, setup.safe_amplitude) + 1e-9) / 100.0
    rig.drive(frequency, amplitude)
    print_line(f"frequency      {frequency:.2f} Hz set and read back; amplitude {amplitude:.2f} Vpp without load")
    total, reference = rig.ranged_capture()
    peaks = [0.5 * float(np.ptp(waveform.volts)) for waveform in (total, reference)]
    channels = total.channel, reference.channel
    for name, channel, peak in zip(("total", "reference"), channels, peaks, strict=True):
        print_line(f"{name:<14} CH{channel}: {2e3 * peak:.4g} mV peak to peak")
    found: list[str] = []
    if total.clipped or reference.clipped:
        found.append("a channel runs off the screen on its coarsest scale: is the probe factor in the file that of the "
                     "probe, is there an offset?")
    if peaks[0] > POSSIBLE * 0.5 * amplitude:
        found.append(f"CH{channels[0]} shows more than the generator gives without load, {amplitude:.2f} Vpp: is the "
                     "probe factor in the file that of the probe?")
    if peaks[0] < LEAST_COUNTS * total.volts_per_count:
        found.append(f"CH{channels[0]} (total) shows no signal: is the probe on the generator's side of the device, "
                     "the generator's main output connected?")
    elif peaks[1] < LEAST_COUNTS * reference.volts_per_count:
        found.append(f"CH{channels[1]} (reference) shows no signal: is the circuit closed, the probe across the "
                     "reference resistor, the resistor not shorted?")
    elif peaks[1] > peaks[0]:
        found.append(f"CH{channels[1]} (reference) shows more than CH{channels[0]} (total): are the probes exchanged, "
                     "or their factors?")
    if not found:
        try:
            fit = fit_sines([total, reference], frequency=frequency)
            z = impedance([fit], setup.reference.resistance).value
            print_line(f"impedance      {abs(z):.4g} ohm at {degrees(z):.1f} degrees, "
                       "without compensation")
            if abs(fit.frequency / frequency - 1.0) > 1e-3:
                found.append(f"the signals have {fit.frequency:.0f} Hz instead of {frequency:.0f} Hz: is this "
                             "generator the one that drives the device?")
        except NoSine as error:
            found.append(f"no sine in the signals ({error}): is the waveform of the generator a sine, is it this one?")
    return found


def _simulate(options: argparse.Namespace, console: Console) -> int:
    device, title = _connected(options, console)
    reference = parse_quantity(options.reference, "resistance", source="command line", field="--reference")
    if not 0.0 < reference < math.inf:
        raise InputError("command line", "--reference", options.reference, "a resistance above zero")
    for name in ("noise", "pace"):
        if not 0.0 <= getattr(options, name) < math.inf:
            raise InputError("command line", f"--{name}", getattr(options, name), "a number not below zero")
    probes = PROBES.get(options.probes)
    if probes is None:
        raise InputError("command line", "--probes", options.probes, "one of " + " ".join(PROBES))
    faults = [_fault(text) for text in options.fault]
    circuit = replace(IDEAL if options.ideal else TYPICAL, reference_resistance=reference)
    ended = threading.Event()
    ends = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(end, lambda _number, _frame: ended.set()) for end in ends]
    try:
        with SimulatedBench(
            device, circuit=circuit, errors=Errors(noise_counts=options.noise), drift=Drift(frequency=options.drift),
            probes=probes, seed=options.seed, pace=options.pace, folder=options.ports,
        ) as bench:
            for fault in faults:
                bench.inject(fault)
            print_line(f"generator     {bench.generator_port}")
            print_line(f"oscilloscope  {bench.oscilloscope_port}")
            sys.stdout.flush()
            console.print(f"serving {title} with a reference resistor of {reference:g} ohm until interrupted (Ctrl-C)",
                          markup=False)
            # In slices: a signal that another thread receives is handled when this one wakes.
            while not ended.wait(0.5):
                pass
    finally:
        for end, handler in zip(ends, before, strict=True):
            signal.signal(end, handler)
    return 0


def _connected(options: argparse.Namespace, console: Console) -> tuple[Device, str]:
    match options.connect:
        case "device":
            pass
        case "open":
            return open_circuit(), "an open circuit"
        case "short":
            return resistor(0.0), "a short circuit"
        case text:
            value = parse_quantity(text, "resistance", source="command line", field="--connect")
            return resistor(value), f"a resistor of {value:g} ohm"
    if options.device is None:
        raise InputError("command line", "DEVICE", None, "a CHIP.toml or a recorded spectrum, or --connect")
    if options.device.suffix != ".toml":
        reading = reading_option(options, options.device, console)
        for finding in reading.findings:
            say_finding(finding.message, console)
        return device_of(reading.spectrum), str(options.device)
    chip = read_chip(options.device)
    requested = model_options(options, chip)
    console.print(f"simulating {chip.name} ...", markup=False)
    state = chip.state(options.state).name
    frequencies = frequency_grid(requested.band, requested.points, source="bench simulate")
    # The simulated device has finer physics than a model that is fitted to it: a liquid sticks to its walls.
    device = fill(chip, state, replace(requested.registry, assumed_losses=True))
    for text in device.findings:
        say_finding(text, console)
    problem = build(device, accuracy=requested.accuracy, band=requested.band)
    model = reduce(
        assemble(problem.mesh, problem.terms), frequencies, problem.values, tolerance=requested.relative_error)
    solved = model.solve(frequencies, problem.values)
    return device_of(Spectrum.from_solver(frequencies, solved.impedance)), f"{chip.name} ({state})"


_FAULT = re.compile(r"(?P<instrument>\w+):(?P<kind>\w+)@(?P<at>\d+)(?:x(?P<count>\d+))?")


def _fault(text: str) -> Fault:
    """A fault from ``generator:silence@120`` or ``generator:silence@120x3``."""
    read = _FAULT.fullmatch(text)
    if read is None:
        raise InputError("command line", "--fault", text, "INSTRUMENT:KIND@COMMAND, such as generator:silence@120")
    instrument = choose(read["instrument"], KINDS, source="command line", field="--fault")
    kind = choose(read["kind"], [kind.value for kind in KINDS[instrument]], source="command line", field="--fault")
    return Fault(instrument, FaultKind(kind), at=int(read["at"]), count=int(read["count"] or 1))
