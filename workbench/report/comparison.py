"""A recording beside the simulation of its chip: tables, record and page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from workbench.render.plots import draw_residuals, draw_spectra
from workbench.report.figures import origin_table
from workbench.report.page import Picture, TextTable, table, write_report
from workbench.report.record import record
from workbench.report.resonances import resonance_notes, resonances_table
from workbench.report.simulation import model_table
from workbench.results.circuit import CircuitFit
from workbench.results.comparison import Comparison
from workbench.results.spectrum import Spectrum, scatter
from workbench.simulation.run import Simulation

#: Reduced chi-square below which a simulation agrees with a recording whose uncertainty is known. Doubled, a systematic
#: difference as large as the noise is called agreement.
AGREES = 1.5

#: Units of impedance by powers of 1000 ohm, with those of admittance that make the same factor.
UNITS_APART = {-2: ("uohm", "MS"), -1: ("mohm", "kS"), 1: ("kohm", "mS"), 2: ("Mohm", "uS"), 3: ("Gohm", "nS")}

#: Relative difference of Q above which an unstated loss is named. Doubled, a loss that is a fifth off is not named.
Q_DIFFERS = 0.1


def compared_figures_table(comparison: Comparison) -> TextTable:
    """Every figure that both spectra have, measured and simulated."""
    return table(" | measured:.6g | simulated:.6g | difference (%):+.2f", (
        (row.metric.removesuffix(" factor"), row.measured, row.simulated, row.difference_percent / 100.0)
        for row in comparison.rows))


def distance_table(comparison: Comparison) -> TextTable:
    """Distances of the two spectra over their common band."""
    return table("over the common band | value", (
        ("MAPE of |Z| (%)", comparison.mape_percent), ("rms of ln(Z_sim / Z_meas)", comparison.rms_log_residual),
        ("mean, largest error of phase (degrees)",
         f"{comparison.phase_mean_deg:.2f}, {comparison.phase_max_deg:.2f}"),
        ("largest error of |Z| (%) and where",
         f"{comparison.worst_percent:.1f} at {comparison.worst_frequency / 1e6:.4f} MHz"),
        ("measured points used", f"{100.0 * comparison.fraction_used:.1f} %")))


def likely_causes(
    comparison: Comparison, run: Simulation, measured: CircuitFit | None, *, lossless: Sequence[str], assumed: bool,
    doubtful: bool = False,
) -> list[str]:
    """Likely causes of a large difference, a sentence each.

    Args:
        measured: resonances of the recording, if any.
        lossless: names of the ceramics whose sources state no loss.
        assumed: whether these have the assumed loss.
        doubtful: whether the phases of the recording are in doubt, and with them its Q.
    """
    ours, capacitor = comparison.scaled_percent
    others = ", ".join(state.name for state in run.chip.states if state.name != run.state)
    # A recording without a resonance is that of a capacitor, or of no device.
    plain, word = (capacitor, "a plain capacitor") if measured is not None else (
        _plain_percent(comparison), "a plain capacitor and a constant |Z|")
    if ours >= plain:
        return [f"the simulation is no nearer to the shape of the recording than {word}: MAPE of |Z| "
                f"{ours:.3g} and {plain:.3g} %, each scaled by its best factor. Likely causes: a recording of "
                f"another state than {run.state!r} or of another device (wrong file), a wrong length or unit in the "
                "chip file" + (others and f". --state names another state: {others}")]
    found = _level(comparison)
    differences = [row.difference_percent for row in comparison.rows if row.metric.startswith("Q")]
    if doubtful or not lossless or not differences or abs(differences[0]) < 100.0 * Q_DIFFERS:
        return found
    cause = (f"the assumed loss of {', '.join(lossless)}, whose source states none" if assumed else
             f"{', '.join(lossless)} without loss, as its source states none")
    return [*found, f"Q differs by {differences[0]:+.3g} %. Likely cause: {cause}. `workbench fit pzt` finds the loss "
            "from a recording of the bare transducer" + ("; --no-assumed-losses leaves it out" if assumed else "")]


def _plain_percent(comparison: Comparison) -> float:
    """Noise and MAPE (%) of the worse of capacitor and constant."""
    return max(comparison.scaled_percent[1], comparison.constant_percent) + 100.0 * scatter(comparison.measured)


def _level(comparison: Comparison) -> list[str]:
    """The finding, if any, on |Z| off by a factor.

    The factor is larger than the distance of the recording from a plain capacitor and from a constant, and the scaled
    recording is nearer to the simulation than to these.
    """
    factor, ours = comparison.best_factor, comparison.scaled_percent[0]
    if not ours < _plain_percent(comparison) <= 100.0 * (max(factor, 1.0 / factor) - 1.0):
        return []
    apart = UNITS_APART.get(round(np.log10(factor) / 3.0))
    text = (f"|Z| of the simulation is {factor:.4g} times that of the recording, with a MAPE of {ours:.3g} % once the "
            "recording is scaled by it")
    if apart is None:
        return [f"{text}. Likely causes: another permittivity of the ceramic or area of the electrode than in the chip "
                "file, a probe or divider of another ratio, a wrong reference resistance, another device"]
    return [f"{text}: did you mean {apart[0]}? Values in {apart[0]} were probably read as ohm (or an admittance in "
            f"{apart[1]} as S). Mend the unit in the heading, or read with --columns MAP.toml"]


def what_next(comparison: Comparison, chip: Path, recording: Path, state: str) -> str:
    """The commands that find the cause of a difference, if any."""
    if comparison.reduced_chi_square is not None and comparison.reduced_chi_square < AGREES:
        return ("The simulation agrees with the recording within their uncertainties: there is nothing here to fit or "
                "to diagnose.")
    of_chip, of_recording, of_state = (quote(str(each)) for each in (chip, recording, state))
    return (f"Next: `workbench sensitivity {of_chip} -o out/sensitivity` ranks the parameters that move this spectrum. "
            f"`workbench diagnose {of_recording} --chip {of_chip} --state {of_state} -o out/diagnosis` finds the "
            "parameters, or the physics missing in the model, that explain the difference. Several states of one "
            "device give more evidence, in a campaign file (docs/diagnosis.md has one). `workbench fit` finds the "
            "material of a bare transducer, or of a polymer on one.")


def comparison_record(comparison: Comparison) -> dict[str, Any]:
    """A comparison for a JSON file."""
    return record(comparison, "mape_percent rms_log_residual phase_mean_deg phase_max_deg worst_percent "
                              "worst_frequency_hz fraction_used reduced_chi_square figures_missing=rows_missing") | {
        "figures": {row.metric: record(row, "measured simulated difference_percent") for row in comparison.rows}}


def write_comparison_report(
    measured: Spectrum, run: Simulation, comparison: Comparison, folder: Path, *, findings: Sequence[str],
    next_step: str, resonances: Mapping[str, CircuitFit | None],
) -> Path:
    """Write ``report.html``: the differences, as numbers and over frequency.

    `findings` are those of the recording's reader, `resonances` those of both spectra.
    """
    title, residual = run.chip.name, comparison.log_residual
    spectra = draw_spectra({"measured": measured, "simulated": run.spectrum}, folder / "impedance.png",
                           measured=["measured"], title=title)
    residuals = draw_residuals(
        comparison.measured.frequency,
        {"magnitude (%)": 100.0 * np.expm1(residual.real), "phase (degrees)": np.degrees(residual.imag)},
        folder / "residual.png", label="simulated against measured", title=title)
    return write_report(folder / "report.html", f"{title}: measured and simulated", module=__name__, values={
        "comparison": comparison, "run": run, "findings": findings, "next_step": next_step,
        "resonances": [resonances_table(resonances), *resonance_notes(resonances)],
        "origin": origin_table(measured.origin), "model": model_table([run]), "pictures": [
            Picture(spectra, "impedance, measured and simulated"),
            Picture(residuals, "residual: relative error of |Z| in per cent and error of phase in degrees")]})
