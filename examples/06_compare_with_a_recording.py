"""Compare with a recording
=========================

A recording beside a simulation: how far they are apart, and f0, Z_min and Q of both. The recording may be a file of the
Keysight E4990A, of the HP 4294A, Touchstone, or any table whose headings say what its columns are.

Reference number: on the default mesh the two agree to 0.022 % rms of ln(Z/Z_ref); on this coarse one to 1 %.
"""

from pathlib import Path

import workbench as wb

ROOT = Path(wb.__file__).resolve().parent.parent
DATA = ROOT / "tests" / "data"

# What each column of a table was taken for is always said.
for name in ("e4990a_z_theta.csv", "4294a_admittance.txt", "reflection.s1p", "table.txt", "semicolons.csv"):
    reading = wb.read_recording(DATA / "spectra" / name)
    print(f"{name:24}", abs(reading.spectrum.impedance[0]).round(3), "ohm;", reading.read_as or "a known format")

recording = wb.read_recording(DATA / "reference" / "chip_filled.csv")
run = wb.simulate(wb.read_chip(ROOT / "geometry" / "chips" / "reference_chip.toml"), "filled", accuracy=5e-3)
comparison = wb.compare(recording.spectrum, run.spectrum)

print(f"rms of ln(Z/Z_ref) {100 * comparison.rms_log_residual:.3f} %, MAPE {comparison.mape_percent:.3f} %")
for row in comparison.rows:
    print(f"{row.metric:12} recorded {row.measured:12.6g}   simulated {row.simulated:12.6g}"
          f"   {row.difference_percent:+.3f} %")

out = Path("out")
out.mkdir(exist_ok=True)
print(wb.draw_spectra({"recorded": recording.spectrum, "simulated": run.spectrum}, out / "compare.png",
                      measured=["recorded"], title="reference chip, filled"))
