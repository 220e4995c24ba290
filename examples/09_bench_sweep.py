"""A sweep on the bench
=====================

Generator, oscilloscope and a reference resistor measure an impedance point by point. The bench is the simulated one,
two ports that speak the protocols of the instruments; with your own, the file names their ports instead. It holds a
disc whose spectrum is a file. Every point is on the disk before the next one is begun; the drive ends at zero.

Reference number: f0 is 1.0332 MHz in place of the disc's own 1.0339 MHz, for leads and channels are not compensated.
"""

import tempfile
from pathlib import Path

import numpy as np

import workbench as wb

ROOT = Path(wb.__file__).resolve().parent.parent

BENCH = """
generator = {{ port = "{generator}", pause = "0 s" }}
oscilloscope = {{ port = "{oscilloscope}" }}
reference = {{ resistance = "0.5 ohm", tolerance = "1 %" }}
sweep = {{ from = "1.02 MHz", to = "1.05 MHz", step = "1 kHz" }}
drive = {{ amplitude = "5 Vpp" }}
limits = {{ device_voltage = "5 Vpp", device_current = "100 mA" }}
acquisition = {{ settle = "0 s", captures = 2 }}
"""

disc = wb.read_recording(ROOT / "tests" / "data" / "reference" / "free_disc_fitted_rho7500.csv").spectrum
impedance = disc.interpolant()

# The bench may be set to frequencies that the file does not have: there the disc keeps the value of the nearer end.
held = wb.SimulatedBench(lambda frequency: complex(impedance(np.clip(frequency, 0.92e6, 1.14e6))), seed=1)
with tempfile.TemporaryDirectory() as folder, held as bench:
    path = Path(folder) / "bench.toml"
    path.write_text(BENCH.format(generator=bench.generator_port, oscilloscope=bench.oscilloscope_port))
    run = wb.measure(wb.read_bench(path), Path(folder) / "disc.h5")
    print(f"{len(run.points)} points, complete: {run.complete}; the drive is now {bench.drive} V")

points = sorted(run.points, key=lambda point: point.frequency)
measured = wb.Spectrum(np.array([point.frequency for point in points]), np.array([p.impedance for p in points]),
                       np.array([point.uncertainty for point in points]))
print(f"f0 {wb.figures(measured).f0 / 1e6:.4f} MHz, the disc's own {wb.figures(disc).f0 / 1e6:.4f} MHz")
print(f"MAPE {wb.compare(measured, disc).mape_percent:.1f} %")

out = Path("out")
out.mkdir(exist_ok=True)
print(wb.draw_spectra({"measured": measured, "disc": disc.restricted(1.02e6, 1.05e6)}, out / "bench_sweep.png",
                      measured=["measured"], title="a sweep, not compensated"))
