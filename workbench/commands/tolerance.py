"""``workbench tolerance``."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from geometry.chip import Chip, read_chip
from workbench.commands.parsed_options import executor_option, model_options, output_folder
from workbench.commands.terminal import print_line, print_table, progress_bars, say_finding
from workbench.design.figures import check_figures
from workbench.design.input_uncertainty import Statement, parse_statement, read_statements, stated_uncertainty
from workbench.design.requirement import parse_requirements
from workbench.design.tolerance import Tolerance, check_tolerance_request, tolerance
from workbench.files.errors import InputError, choose
from workbench.files.ownership import Outputs
from workbench.files.quantities import parse_quantity
from workbench.files.writing import write_json
from workbench.model.problem import fill
from workbench.report.tolerance import (
    drive_in_words,
    sensitivities_table,
    sobol_table,
    tightening_table,
    tolerance_record,
    uncertain_figures_table,
    unclear_tightenings,
    write_samples,
    write_tolerance_report,
    yields_table,
)

if TYPE_CHECKING:
    from rich.console import Console

#: Files of `tolerance`.
OUTPUTS = Outputs("tolerance", names=("report.html", "tolerance.json", "tolerance.parquet", "tornado.png", "yield.png",
                                      "samples.png"))


def run_tolerance(options: argparse.Namespace, console: Console) -> int:
    """``workbench tolerance``: sensitivities, yield, and the uncertainty to halve first."""
    chip = read_chip(options.chip)
    model = model_options(options, chip)
    registry = replace(model.registry, assumed_losses=True)
    for text in fill(chip, options.state, registry).findings:
        say_finding(text, console)
    required = parse_requirements(options.require, chip.regions)
    figures = check_figures([name.casefold() for name in options.figure], chip.regions, source="command line",
                            field="--figure")
    uncertainty = stated_uncertainty(
        chip, options.state, registry=registry, law=options.distribution, statements=_statements(options),
        posteriors=options.posterior)
    resistance = _thermal_resistance(options.thermal_resistance, chip)
    check_tolerance_request(uncertainty, required, options.samples, options.sobol, chip, names=("--samples", "--sobol"))
    folder = output_folder(options, OUTPUTS)
    with executor_option(options) as (executor, jobs), progress_bars(console) as show:
        found = tolerance(
            chip, options.state, required, uncertainty=uncertainty, figures=figures, drive=model.drive,
            thermal_resistance=resistance, at=model.at, tracking=options.tracking, samples=options.samples,
            sobol_points=options.sobol, every=options.every, seed=options.seed, registry=registry,
            band=model.band, accuracy=model.accuracy, jobs=jobs, executor=executor,
            progress=lambda text, share: show(chip.state(options.state).name, text, share))
        show(found.state, "done", 1.0)
    if found.outcomes is not None:
        write_samples(found, folder / "tolerance.parquet")
    write_json(folder / "tolerance.json", {**tolerance_record(found), "chip_file": str(options.chip)})
    write_tolerance_report(found, folder)
    _print_results(found, console)
    return 0


def _statements(options: argparse.Namespace) -> list[Statement]:
    of_file = [] if options.uncertainties is None else list(read_statements(options.uncertainties))
    return of_file + [parse_statement(text) for text in options.uncertainty]


def _thermal_resistance(texts: Sequence[str], chip: Chip) -> Mapping[str, float]:
    """Thermal resistances (K/W) by region; "" for all others."""
    found: dict[str, float] = {}
    for text in texts:
        region, equals, written = text.rpartition("=")
        field = "--thermal-resistance"
        name = choose(region.strip(), chip.regions, source="command line", field=field) if equals else ""
        value = parse_quantity(written.strip(), "thermal resistance", source="command line", field=field)
        if value <= 0.0:
            raise InputError("command line", field, text, "a resistance above zero")
        if name in found:
            raise InputError("command line", field, text, "every region once")
        found[name] = value
    return found


def _print_results(found: Tolerance, console: Console) -> None:
    title = f"{found.chip.name}, {found.state}, {drive_in_words(found)}"
    print_table(title, uncertain_figures_table(found))
    print_table("sensitivities", sensitivities_table(found))
    if found.sobol is not None:
        print_table("shares of the variance", sobol_table(found))
    if found.yields is not None:
        print_table("yield", yields_table(found))
        if any(each.is_clear for each in found.yields.tightenings):
            print_table("uncertainties to halve", tightening_table(found))
        if words := unclear_tightenings(found):
            print_line(words)
    for text in found.findings:
        print_line(text)
    if found.model is not None and found.outcomes is not None:
        console.print(f"{len(found.outcomes.points)} samples on a model of {found.model.rank} unknowns, relative error "
                      f"{100.0 * found.model.error:.2g} %; it took {found.model.seconds:.0f} of {found.seconds:.0f} s",
                      markup=False)


