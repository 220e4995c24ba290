"""The bench on its simulated twin: accuracy, faults, kills, the adaptive sweep, and captures made by others.

    .venv/bin/python tests/benchmarks/bench.py accuracy [--sweeps 6]     open, short, load and a filled chip, +-12 %
    .venv/bin/python tests/benchmarks/bench.py faults [--faults 200]     faults of every kind at random commands
    .venv/bin/python tests/benchmarks/bench.py kills [--kills 50]        `workbench measure` killed with SIGKILL
    .venv/bin/python tests/benchmarks/bench.py adaptive [--sweeps 8]     100 points against 481 on the filled chip
    .venv/bin/python tests/benchmarks/bench.py captures --recordings DIR real two-channel captures and shunt files

The device is the filled chip of tests/data/reference, from an independent solver. Every command prints its figures.
"""

from __future__ import annotations

import argparse
import collections
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from known_fixture import fixture_from_load  # noqa: E402

from workbench.bench.compensation import Compensation, Load  # noqa: E402
from workbench.bench.rig import Rig, marker_path  # noqa: E402
from workbench.bench.run_file import Run, read_run  # noqa: E402
from workbench.bench.setup import BenchSetup, read_bench  # noqa: E402
from workbench.bench.sine_fit import fit_sines  # noqa: E402
from workbench.bench.spectra import level_spectra, read_compensation  # noqa: E402
from workbench.bench.sweep import BenchFailure, measure  # noqa: E402
from workbench.bench.waveforms import pair_files, read_waveform  # noqa: E402
from workbench.instruments.circuit import TYPICAL, device_of, open_circuit, resistor  # noqa: E402
from workbench.instruments.faults import GENERATOR, KINDS, OSCILLOSCOPE, Fault  # noqa: E402
from workbench.instruments.instrument import InstrumentError  # noqa: E402
from workbench.instruments.simulated import SimulatedBench  # noqa: E402
from workbench.readers import ColumnMap, RecordedQuantity, read_recording  # noqa: E402
from workbench.results.merit import figures  # noqa: E402
from workbench.results.spectrum import Spectrum  # noqa: E402

#: The clock error of the simulated generator: the device is asked at the frequency that is really there.
CLOCK = 1.0 + 5e-6

#: Known values of the two-channel recordings of a series resonant circuit: henry, farad.
INDUCTANCE, CAPACITANCE = 10.11e-3, 2.093e-9


def filled_chip() -> Spectrum:
    """The reference spectrum of the filled chip."""
    path = ROOT / "tests" / "data" / "reference" / "chip_filled.csv"
    frequency, real, imaginary = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
    return Spectrum(frequency, real + 1j * imaginary)


def write_setup(
    bench: SimulatedBench, path: Path, *, sweep: str, captures: int = 4, timeout: float = 0.25,
    compensated: bool = False, reference: str = "0.5 ohm",
) -> BenchSetup:
    """A BENCH.toml for the simulated bench, read back; `compensated` names open.h5, short.h5 and load.h5 beside it."""
    compensation = ('[compensation]\nopen = "open.h5"\nshort = "short.h5"\nload = "load.h5"\n'
                    'load_resistance = "50 ohm"\nload_tolerance = "0.1 %"\n') if compensated else ""
    path.write_text(f"""[generator]
port = "{bench.generator_port}"
pause = "0 s"
timeout = "{timeout} s"
[oscilloscope]
port = "{bench.oscilloscope_port}"
timeout = "{timeout} s"
acquisition_timeout = "{2 * timeout} s"
[reference]
resistance = "{reference}"
tolerance = "1 %"
[sweep]
{sweep}
[drive]
amplitude = "5 Vpp"
[acquisition]
settle = "0 s"
captures = {captures}
{compensation}""", encoding="utf-8")
    return read_bench(path)


@dataclass(frozen=True)
class Accuracy:
    """MAPE of |Z| (%) with and without compensation, share of points whose 95 % interval holds the truth (real and
    imaginary parts counted each), and the flags without compensation.

    ``covered`` is for the whole uncertainty, ``covered_by_noise`` for that of the noise, with the load's true value put
    in place of the stated one.
    """

    points: int
    compensated: float
    uncompensated: float
    covered: float
    covered_by_noise: float
    flags: tuple[str, ...]


def accuracy(folder: Path, *, seed: int, step: str = "500 Hz") -> Accuracy:
    """Open, short and load of 50 ohm recorded with the same bench, then the filled chip over +-12 % of 1.03 MHz.

    The load's stated tolerance is 0.1 % and its true value is drawn from it, so that the whole uncertainty is tested.
    """
    chip = filled_chip()
    deviation = np.random.default_rng(seed).uniform(-1e-3, 1e-3)
    connected = {"open": open_circuit(), "short": resistor(0.0), "load": resistor(50.0 * (1.0 + deviation)),
                 "device": device_of(chip)}
    sweep = f'centre = "1.03 MHz"\nspan = "12 %"\nstep = "{step}"'
    with SimulatedBench(device_of(chip), seed=seed) as bench:
        for name, device in connected.items():
            bench.connect(device)
            setup = write_setup(bench, folder / f"{name}.toml", sweep=sweep, compensated=name == "device")
            run = measure(setup, folder / f"{name}.h5")
        compensated = level_spectra(run, setup, read_compensation(setup.standards))[0]
        plain = level_spectra(run, setup, Compensation())[0]
        truth = np.array([bench.truth(f * CLOCK) for f in run_frequencies(run)])
    uncertainty = compensated.spectrum.uncertainty
    assert uncertainty is not None

    def covered(factor: float, uncertainty: np.ndarray) -> float:
        error = factor * compensated.spectrum.impedance - truth
        return float(np.mean(np.abs([error.real, error.imag]) <= 1.96 * uncertainty))

    def mape(spectrum: Spectrum) -> float:
        return 100.0 * float(np.mean(np.abs(spectrum.magnitude / np.abs(truth) - 1.0)))

    return Accuracy(len(truth), mape(compensated.spectrum), mape(plain.spectrum), covered(1.0, uncertainty),
                    covered(1.0 + deviation, compensated.noise), plain.flags)


def run_frequencies(run: Run) -> list[float]:
    return sorted({point.frequency for point in run.points})


def expected_reading(bench: SimulatedBench, frequency: float) -> complex:
    """What eq. 25 gives on the simulated bench at `frequency` (Hz) when nothing goes wrong, without noise (ohm)."""
    total, reference = TYPICAL.responses(frequency * CLOCK, bench.truth(frequency * CLOCK))
    return 0.5 * (total - reference) / reference


def furthest(run: Run, bench: SimulatedBench) -> float:
    """The largest distance of a point from what it should read, over its stated uncertainty."""
    return max(abs(p.impedance - expected_reading(bench, p.frequency)) / p.uncertainty for p in run.points)


@dataclass(frozen=True)
class Endured:
    """What happened to sweeps under faults or kills.

    ``struck`` by kind; ``stops`` is how often the sweep ended early; ``left_on`` how often the drive was on when it
    should have been off; ``lost`` how often points that had been on disk were not any more, or others; ``furthest`` as
    in :func:`furthest`, over all points of all runs.
    """

    struck: collections.Counter[str]
    points: int
    stops: int
    left_on: int
    lost: int
    furthest: float


def faults(folder: Path, *, count: int, seed: int) -> Endured:
    """Sweeps of 25 points with 20 or more faults each, until `count` have struck; every stop is resumed.

    Faults are of every kind, at random commands of either instrument, up to three times in a row.
    """
    random = np.random.default_rng(seed)
    struck: collections.Counter[str] = collections.Counter()
    points = stops = left_on = lost = 0
    worst = 0.0
    number = 0
    while struck.total() < count:
        number += 1
        path = folder / f"run_{number}.h5"
        with SimulatedBench(device_of(filled_chip()), seed=seed + number) as bench:
            setup = write_setup(bench, folder / "faults.toml", captures=2, timeout=0.1,
                                sweep='from = "0.91 MHz"\nto = "1.15 MHz"\nstep = "10 kHz"')
            for _ in range(20):
                instrument = (GENERATOR, OSCILLOSCOPE)[random.integers(2)]
                kind = KINDS[instrument][random.integers(len(KINDS[instrument]))]
                # A sweep sends about 100 commands to the generator and 1500 to the oscilloscope.
                at = int(random.integers(100 if instrument == GENERATOR else 1500))
                bench.inject(Fault(instrument, kind, at=at, count=int(random.choice([1, 1, 1, 2, 3])), seconds=0.15))
            known: list[tuple[float, complex]] = []
            run = None
            for attempt in range(50):
                try:
                    run = measure(setup, path, resume=attempt > 0, sleep=lambda seconds: time.sleep(min(seconds, 0.2)))
                except (BenchFailure, InstrumentError):
                    stops += 1
                    left_on += bench.drive != 0.0
                    now = on_disk(path)
                    lost += now[:len(known)] != known
                    known = now
                    time.sleep(0.2)
                else:
                    break
            if run is None:
                raise RuntimeError("a sweep did not end in 50 attempts")
            left_on += bench.drive != 0.0
            lost += [(p.frequency, p.impedance) for p in run.points][:len(known)] != known
            lost += run_frequencies(run) != [float(f) for f in setup.sweep.grid()]
            points += len(run.points)
            worst = max(worst, furthest(run, bench))
            for name in (GENERATOR, OSCILLOSCOPE):
                struck.update(str(fault.kind) for _, fault in bench.struck(name))
    return Endured(struck, points, stops, left_on, lost, worst)


def on_disk(path: Path) -> list[tuple[float, complex]]:
    """Frequency and impedance of the points that a run has on disk, its journal included; none if there is no run."""
    try:
        return [(point.frequency, point.impedance) for point in read_run(path).points]
    except ValueError:
        return []


def kills(folder: Path, *, count: int, seed: int, show: Callable[[str], None] = lambda text: None) -> Endured:
    """`workbench measure --resume` in a process of its own, killed `count` times with SIGKILL: two times in three some
    moments after it has measured a point, else at any moment from its start. After each kill the port's next owner is
    asked for nothing but the safe state."""
    random = np.random.default_rng(seed)
    struck: collections.Counter[str] = collections.Counter()
    points = stops = left_on = lost = 0
    worst = 0.0
    number = 0
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}

    while struck.total() < count:
        number += 1
        path = folder / f"run_{number}.h5"
        with SimulatedBench(device_of(filled_chip()), seed=seed + number) as bench:
            setup = write_setup(bench, folder / "kills.toml",
                                sweep='from = "0.91 MHz"\nto = "1.15 MHz"\nstep = "2 kHz"')
            command = [sys.executable, "-m", "workbench.cli", "measure", setup.path, "-o", str(path), "--resume"]
            known: list[tuple[float, complex]] = []
            while struck.total() < count:
                with subprocess.Popen(
                    command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                ) as it:
                    if random.random() < 2 / 3:
                        while it.poll() is None and len(on_disk(path)) == len(known):
                            time.sleep(0.02)
                        time.sleep(float(random.uniform(0.0, 0.3)))
                    else:
                        time.sleep(float(random.uniform(0.2, 4.0)))
                    seen = on_disk(path)
                    it.kill()
                    it.wait()
                if it.returncode == 0:
                    break  # it had come to its end before
                struck["kill -9, drive on" if bench.drive else "kill -9, drive off"] += 1
                now = on_disk(path)
                lost += seen[:len(known)] != known or now[:len(seen)] != seen
                known = now
                with Rig(setup, marker_path(path)):
                    left_on += bench.drive != 0.0
                left_on += marker_path(path).exists()
                show(f"{struck.total()} kills, {len(now)} points on disk")
            # What is left, by the same command; a finished run is taken up too, and has nothing left to do.
            subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            run = read_run(path)
            left_on += bench.drive != 0.0
            lost += [(p.frequency, p.impedance) for p in run.points][:len(known)] != known
            lost += not run.complete or run_frequencies(run) != [float(f) for f in setup.sweep.grid()]
            points += len(run.points)
            worst = max(worst, furthest(run, bench))
    return Endured(struck, points, stops, left_on, lost, worst)


@dataclass(frozen=True)
class SweepError:
    """Points used, and the errors of f0 (Hz), Z_min (%) and Q (%) against the noise-free reading of the same bench."""

    points: int
    f0: float
    z_min: float
    q: float


def sweep_error(folder: Path, *, kind: str, seed: int) -> SweepError:
    """One sweep of the filled chip over +-12 % of 1 MHz on the simulated bench."""
    sweep = f'from = "0.91 MHz"\nto = "1.15 MHz"\nstep = "500 Hz"\nkind = "{kind}"\npoints = 100'
    with SimulatedBench(device_of(filled_chip()), seed=seed) as bench:
        setup = write_setup(bench, folder / f"{kind}_{seed}.toml", sweep=sweep)
        run = measure(setup, folder / f"{kind}_{seed}.h5")
        measured = figures(level_spectra(run, setup, Compensation())[0].spectrum)
        fine = np.arange(0.91e6, 1.15e6, 100.0)
        truth = figures(Spectrum(fine, np.array([expected_reading(bench, f) for f in fine])))
    return SweepError(len(run.points), measured.f0 - truth.f0, 100.0 * (measured.z_min / truth.z_min - 1.0),
                      100.0 * (measured.q / truth.q - 1.0))


def resonant_circuit(recordings: Path) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) of the pairs and the errors (degrees) of their phases against theory.

    Capacitor over generator voltage of L and C in series, H = 1 / (1 - w^2 L C' + j w R C'): L and C are known, the
    loss of the loop and the capacitance of the probe across C are not stated, and are the two numbers fitted to all
    pairs.
    """
    folder = recordings / "nolicence-tds1012b-rlc-two-channel"
    fits = [fit_sines([read_waveform(a), read_waveform(b)])
            for a, b in pair_files([folder], total=1, reference=2).values()]
    frequency = np.array([fit.frequency for fit in fits])
    ratio = np.array([fit.amplitude[0] / fit.amplitude[1] for fit in fits])
    omega = 2.0 * np.pi * frequency

    def residual(numbers: np.ndarray) -> np.ndarray:
        capacitance = CAPACITANCE + 1e-12 * numbers[1]
        theory = 1.0 / (1.0 - omega**2 * INDUCTANCE * capacitance + 1j * omega * numbers[0] * capacitance)
        logarithm = np.log(ratio / theory)
        return np.concatenate([logarithm.real, logarithm.imag])

    found = least_squares(residual, np.array([545.0, 50.0]))
    return frequency, np.degrees(found.fun[len(frequency):])


def shunt(recordings: Path) -> dict[str, tuple[complex, complex]]:
    """By instrument: the 47 ohm resistor at 1 MHz as read, and with the fixture taken out (ohm).

    The fixture (a gain and a series inductance) is that of the known resistor from 100 to 700 kHz: 1 MHz is predicted.
    """
    folder = recordings / "format-samples"
    files = {
        "Rohde & Schwarz": ("RohdeSchwarz_47R_100R_shunt.csv", ColumnMap(2, 3, 4, RecordedQuantity(
            "gain", "polar", "dB", "deg", reference_resistance=100.0))),
        "Moku:Go": ("MokuGo_47R_100R_shunt.csv", ColumnMap(1, 6, 7, RecordedQuantity(
            "gain", "polar", "dB", "deg", reference_resistance=100.0, inverse=True))),
    }
    found = {}
    for name, (file, columns) in files.items():
        spectrum = read_recording(folder / file, columns=columns).spectrum
        fixture = fixture_from_load(Load(spectrum, 47.0), band=(100e3, 700e3))
        at = [1e6, 1.01e6]
        found[name] = (complex(spectrum.on(at).impedance[0]), complex(fixture.remove(spectrum).on(at).impedance[0]))
    return found


def main() -> None:
    """Run one of the commands and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("accuracy", "faults", "kills", "adaptive", "captures"))
    parser.add_argument("--sweeps", type=int, default=6)
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--recordings", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        match options.what:
            case "accuracy":
                _print_accuracy(folder, options)
            case "adaptive":
                _print_adaptive(folder, options)
            case "faults":
                _print_endured(faults(folder, count=options.faults, seed=options.seed))
            case "kills":
                _print_endured(kills(folder, count=options.kills, seed=options.seed, show=print))
            case "captures":
                if options.recordings is None:
                    parser.error("captures needs --recordings")
                frequency, errors = resonant_circuit(options.recordings)
                print(f"{len(frequency)} pairs, largest error of phase {np.max(np.abs(errors)):.2f} degrees")
                for name, (raw, value) in shunt(options.recordings).items():
                    print(f"{name}: {abs(raw):.2f} ohm at {np.degrees(np.angle(raw)):.2f} degrees as read, "
                          f"{abs(value):.2f} ohm ({100 * (abs(value) / 47 - 1):+.2f} %) at "
                          f"{np.degrees(np.angle(value)):+.2f} degrees compensated")


def _print_accuracy(folder: Path, options: argparse.Namespace) -> None:
    rows = []
    for seed in range(options.seed, options.seed + options.sweeps):
        for path in folder.iterdir():
            path.unlink()
        rows.append(accuracy(folder, seed=seed))
        print(f"seed {seed}: {rows[-1].points} points, MAPE {rows[-1].compensated:.3f} % compensated, "
              f"{rows[-1].uncompensated:.2f} % not; covered {100 * rows[-1].covered:.1f} %, by noise alone with the "
              f"load's true value {100 * rows[-1].covered_by_noise:.1f} %")
    print(f"worst MAPE {max(r.compensated for r in rows):.3f} %, covered over all "
          f"{100 * np.mean([r.covered for r in rows]):.1f} %, by noise alone "
          f"{100 * np.mean([r.covered_by_noise for r in rows]):.1f} %; without compensation: {rows[0].flags[0]}")


def _print_adaptive(folder: Path, options: argparse.Namespace) -> None:
    for kind in ("linear", "adaptive"):
        errors = [sweep_error(folder, kind=kind, seed=options.seed + n) for n in range(options.sweeps)]

        def rms(name: str, errors: list[SweepError] = errors) -> float:
            return float(np.sqrt(np.mean([getattr(error, name) ** 2 for error in errors])))

        print(f"{kind}: at most {max(e.points for e in errors)} points; rms error of f0 {rms('f0'):.1f} Hz, of Z_min "
              f"{rms('z_min'):.3f} %, of Q {rms('q'):.3f} %")


def _print_endured(found: Endured) -> None:
    print(", ".join(f"{kind} {count}" for kind, count in sorted(found.struck.items())))
    print(f"{found.struck.total()} of {len(found.struck)} kinds over {found.points} points: {found.stops} stops, "
          f"{found.lost} times something lost, drive left on {found.left_on} times, furthest point "
          f"{found.furthest:.1f} uncertainties from the truth")


if __name__ == "__main__":
    main()
