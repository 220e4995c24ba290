"""One mass beside the axis of the recorded disc: how much of the residual it explains.

The null hypothesis of a diagnosis is fitted first. A mass on the disc then changes ln Z by the coupled orders of the
fitted disc, and known parameters move along to first order, within their priors. It takes minutes.

    .venv/bin/python tests/benchmarks/disc_feature.py RECORDING
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.chip import read_chip
from workbench.campaign.campaign import read_campaign
from workbench.diagnosis.device import device_model
from workbench.diagnosis.inference import DiagnosisSearch
from workbench.fem.operators import assemble
from workbench.fem.patch import Patch, patch_forms
from workbench.model.problem import build, fill
from workbench.reduced.at_point import reduced
from workbench.simulation.features import RigidPart, charge_change, compliance_of

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROOT = Path(__file__).resolve().parents[2]
#: Radius of the mass's patch (m), places of its centre as shares of the largest one, and masses (kg).
RADIUS, PLACES, MASSES = 0.6e-3, (0.25, 0.5, 0.65, 0.8, 1.0), np.geomspace(0.02e-6, 20e-6, 41)
#: Share of the frequencies, and dimensions of the disc.
EVERY, LENGTHS = 4, ("transducer.radius", "transducer.thickness")


def fitted(recording: Path) -> DiagnosisSearch:
    """The search of a diagnosis of the recording."""
    text = (ROOT / "examples" / "real_disc" / "campaign.toml").read_text(encoding="utf-8")
    text = text.replace('"RECORDING"', f'"{recording.resolve().as_posix()}"')
    with tempfile.TemporaryDirectory() as folder:
        campaign = Path(folder) / "campaign.toml"
        campaign.write_text(text.replace('"../../geometry/chips', f'"{(ROOT / "geometry" / "chips").as_posix()}'),
                            encoding="utf-8")
        return DiagnosisSearch(device_model(read_campaign(campaign)))


def main(recording: Path) -> None:
    search = fitted(recording)
    _, null = search.initial_optima()
    x, model = search.refit(null).explanation.x, search.model
    known, objective = model.known, model.fitted.enriched(x, 1e-5)
    found = objective(x, deviation=[1.0] * len(objective.recordings))
    grids = [each.measured.frequency[::EVERY] for each in objective.recordings]
    residual = [log[::EVERY] for log in found.log_ratio]
    slopes, start = list[Complex](), 0
    for log in found.log_ratio:
        both = found.jacobian[start:start + 2 * log.size, :known]
        slopes.append((both[:log.size] + 1j * both[log.size:])[::EVERY])
        start += 2 * log.size
    values = objective.settings(x, 0)[0]
    chip = read_chip(ROOT / "geometry" / "chips" / "disc_20x2.toml").with_dimensions(
        {name: float(values[name].real) for name in LENGTHS}, unusual=LENGTHS)
    farthest = chip.transducer.radius.value - 1.0001 * RADIUS
    patches = [Patch("transducer", True, share * farthest, RADIUS) for share in PLACES]
    frequencies = np.sort(np.concatenate(grids))
    radii = sorted({each for patch in patches for each in patch.radii if each < 0.9999 * chip.transducer.radius.value})
    posed = build(fill(chip), band=(frequencies[0], frequencies[-1]), accuracy=1e-2, radii=radii)
    posed = posed.with_values({name: value for name, value in values.items() if name in posed.values})
    base, solution = reduced(assemble(posed.mesh, posed.terms), frequencies, posed.values, tolerance=1e-4)

    # The residuals of both bands have their own scale; parameters their priors.
    scale = np.concatenate([np.full(log.size, np.sqrt(np.mean(np.abs(log) ** 2))) for log in residual])
    prior = np.array([p.prior or np.inf for p in model.parameters[:known]])
    size = np.where(np.isfinite(prior), prior, np.abs(x[:known]) + 1e-12)
    offset = np.where(np.isfinite(prior), (x[:known] - model.stated[:known]) / size, 0.0)
    columns = np.concatenate(slopes) / scale[:, None] * size
    matrix = np.vstack([columns.real, columns.imag, np.diag(np.isfinite(prior).astype(float))])

    def left(change: Complex) -> tuple[float, list[float]]:
        """Sum of squares, and the rms of each band (%), with a change of ln Z."""
        off = (np.concatenate(residual) + change) / scale
        vector = np.concatenate([off.real, off.imag, offset])
        vector += matrix @ np.linalg.lstsq(matrix, -vector, rcond=None)[0]
        rest, start, parts = (vector[:off.size] + 1j * vector[off.size:2 * off.size]) * scale, 0, list[float]()
        for log in residual:
            parts.append(100.0 * float(np.sqrt(np.mean(np.abs(rest[start:start + log.size]) ** 2))))
            start += log.size
        return float(vector @ vector), parts

    at = np.searchsorted(frequencies, np.concatenate(grids))
    print("place (mm)  mass (mg)  sum of squares  residual of both bands (%)")
    squares, parts = left(np.zeros(scale.size, dtype=complex))
    print(f"{'none':>10}  {0.0:9.3f}  {squares:14.1f}  {parts[0]:.2f}  {parts[1]:.2f}")
    for patch in patches:
        driven = patch_forms(base.full, patch, 0).T @ (base.basis @ solution.states)
        between = compliance_of(posed, [patch], np.zeros(1), frequencies)
        charges = [charge_change([RigidPart(patch, mass=mass)], frequencies, [driven], between.total)
                   for mass in MASSES]
        changes = [np.conj(-np.log1p(each / solution.charge))[at] for each in charges]
        best = min(range(len(MASSES)), key=lambda k: left(changes[k])[0])
        squares, parts = left(changes[best])
        print(f"{1e3 * patch.distance:10.2f}  {1e6 * MASSES[best]:9.3f}  {squares:14.1f}  {parts[0]:.2f}  "
              f"{parts[1]:.2f}  ({between.orders} orders)", flush=True)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    main(parser.parse_args().recording)
