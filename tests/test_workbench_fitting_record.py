"""What is written of a fit: the record, the verdict, the entry for the registry; and how it is prepared."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import DISC, STACK, quadratic

from geometry.chip import Chip, read_chip
from materials import Registry, save_fit
from workbench.fem.operators import assemble
from workbench.files.errors import InputError
from workbench.fitting.joint import FitResult, fit_parameters
from workbench.fitting.multistart import TRIES
from workbench.fitting.objective import FitRecording
from workbench.fitting.parameter import POLYMER_FOUR
from workbench.fitting.prepare import Prepared, check_device, in_band, material_starts, prepare, prepare_together
from workbench.fitting.record import Source, paper_result, refusals, registry_entry, reservations, source
from workbench.model.problem import build, fill
from workbench.reduced.at_point import reduce
from workbench.report.fit import fit_record
from workbench.reproduction.fits import PaperFit
from workbench.results.merit import figures
from workbench.results.spectrum import Origin, Spectrum, write_spectrum

MATERIAL = "pzt4/acevedo_2026_initial"
DATE = datetime(2026, 11, 21, 14, 40, tzinfo=UTC)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("fit")
    (found / "disc.toml").write_text(DISC)
    (found / "stack.toml").write_text(STACK)
    return found


@pytest.fixture(scope="module")
def chip(folder: Path) -> Chip:
    return read_chip(folder / "disc.toml")


@pytest.fixture(scope="module")
def recorded(chip: Chip, folder: Path) -> Spectrum:
    """The disc with c33 5 % stiffer, c11 3 % softer and lossier, without noise."""
    problem = build(fill(chip, "default", Registry()), accuracy=quadratic(4.0))
    values = {**problem.values, f"{MATERIAL}.c33": problem.values[f"{MATERIAL}.c33"] + 0.05 * 115.41e9,
              f"{MATERIAL}.c11": 0.97 * problem.values[f"{MATERIAL}.c11"].real - 0.24e9j}
    frequency = np.linspace(300e3, 450e3, 61)
    solution = reduce(assemble(problem.mesh, problem.terms), frequency, values, tolerance=1e-6).solve(frequency, values)
    spectrum = Spectrum.from_solver(frequency, solution.impedance, origin=Origin("measured", "disc.csv"))
    write_spectrum(spectrum, folder / "disc.csv")
    return spectrum


@pytest.fixture(scope="module")
def prepared(chip: Chip, recorded: Spectrum) -> Prepared:
    return prepare(chip, Registry(), kind="pzt", name="disc", measured=recorded, free=("c11", "c33", "c11.loss"),
                   accuracy=quadratic(4.0))


@pytest.fixture(scope="module")
def result(prepared: Prepared) -> FitResult:
    return fit_parameters(prepared.recordings, prepared.parameters, coarse=prepared.coarse, tries=0, bands=2)


@pytest.fixture(scope="module")
def sources(recorded: Spectrum, folder: Path) -> tuple[Source, ...]:
    return (source(folder / "disc.csv", folder / "disc.toml", findings=["something"]),)


# --------------------------------------------------------------------------------------------------------------------
# Preparing.


def test_the_search_has_half_as_many_elements_and_frees_what_shows(chip: Chip, recorded: Spectrum) -> None:
    found = prepare(chip, Registry(), kind="pzt", name="disc", measured=recorded, accuracy=quadratic(16.0),
                    free=("default", "transducer.thickness", "bench.series_resistance"), band=(320e3, 440e3))
    cells = [r[0].problem.mesh.mesh.t.shape[1] for r in (found.recordings, found.coarse)]
    assert cells[0] > 2 * cells[1]
    own = [p.name.removeprefix(f"{MATERIAL}.") for p in found.parameters]
    assert own[-2:] == ["transducer.thickness", "bench.series_resistance"]
    assert {"c11", "c12", "e31", "eps33", "c11.loss", "c12.loss"} < set(own)
    assert found.recordings[0].measured.frequency[[0, -1]].tolist() == [320e3, 440e3]
    assert found.material.density == 7500.0


def test_a_polymer_is_that_of_the_sample_and_may_be_another(folder: Path, recorded: Spectrum) -> None:
    stack = read_chip(folder / "stack.toml")
    found = prepare(stack, Registry(), kind="polymer", name="stack", measured=recorded, accuracy=quadratic(2.0),
                    material="pmma", check=False)
    assert found.material.name == "pmma/acevedo_2026"
    assert [p.name for p in found.parameters] == [f"pmma/acevedo_2026.{name}" for name in POLYMER_FOUR]
    assert "pla/acevedo_2026.bulk_modulus" not in found.recordings[0].problem.values
    with pytest.raises(InputError, match="'sample'"):
        prepare(read_chip(folder / "disc.toml"), Registry(), kind="polymer", name="x", measured=recorded)
    with pytest.raises(InputError, match="an isotropic solid"):
        prepare(stack, Registry(), kind="polymer", name="x", measured=recorded, region="couplant")


def test_starts_of_other_materials_take_their_numbers(prepared: Prepared) -> None:
    found = material_starts(prepared, Registry(), ["pzt5a/erturk_2011"])
    other = Registry().load("pzt5a/erturk_2011").parameters()
    # It states no losses: a thousandth of the real part, as parameter.py has it.
    expected = [other["c11"].real, other["c33"].real, -1e-3 * other["c11"].real]
    assert found["pzt5a/erturk_2011"] == pytest.approx(expected, rel=1e-12)
    with pytest.raises(InputError, match="of the kind of"):
        material_starts(prepared, Registry(), ["pla"])


def test_a_group_shares_what_has_one_name_and_keeps_its_own(chip: Chip, recorded: Spectrum) -> None:
    def one(name: str) -> Prepared:
        return prepare(chip, Registry(), kind="pzt", name=name, measured=recorded, accuracy=quadratic(2.0),
                       free=("c33", "bench.gain"))

    found = prepare_together([one("a"), one("b")], own=["transducer.thickness"])
    assert [r.name for r in found.recordings] == [r.name for r in found.coarse] == ["a", "b"]
    assert [(p.name, p.recordings) for p in found.parameters] == [
        (f"{MATERIAL}.c33", ()), ("bench.gain", ("a",)), ("transducer.thickness", ("a",)),
        ("bench.gain", ("b",)), ("transducer.thickness", ("b",))]
    with pytest.raises(InputError, match="a name of its own"):
        prepare_together([one("a"), one("a")])


def test_fewer_points_than_parameters_are_refused(chip: Chip, recorded: Spectrum) -> None:
    few = Spectrum(recorded.frequency[::8], recorded.impedance[::8])
    with pytest.raises(InputError, match=r"at least as many as free parameters, \d\d"):
        prepare(chip, Registry(), kind="pzt", name="few", measured=few)
    with pytest.raises(InputError, match="2 points or more"):
        in_band(recorded, chip, (1e6, 2e6), name="disc")


@pytest.mark.parametrize(
    ("old", "new"),
    [("2 mm", "0.2 mm"), ("2 mm", "20 mm"), ('radius = "3 mm"', 'radius = "30 mm"'),
     ('radius = "3 mm"', 'radius = "0.3 mm"')],
)
def test_a_geometry_wrong_by_ten_is_refused_before_it_is_meshed(
    tmp_path: Path, recorded: Spectrum, monkeypatch: pytest.MonkeyPatch, old: str, new: str
) -> None:
    monkeypatch.setattr("workbench.fitting.prepare.build", None)
    path = tmp_path / "wrong.toml"
    path.write_text(DISC.replace(old, new))
    with pytest.raises(InputError, match="this recording is not of this device") as error:
        prepare(read_chip(path), Registry(), kind="pzt", name="disc.csv", measured=recorded)
    assert error.value.field == "capacitance"
    assert error.value.source == "disc.csv"
    assert "wrong.toml" in error.value.expected


def check(measured: Spectrum, chip: Chip) -> None:
    check_device(measured, chip, fill(chip, "default", Registry()).materials, name="recording")


def test_a_device_is_not_refused_for_its_ceramic(chip: Chip, recorded: Spectrum) -> None:
    check(recorded, chip)
    for material in ("pzt5h/erturk_2011", "pic255/plutho"):  # clamped permittivities 663 to 1470
        filling = {"transducer": replace(Registry().load(material), density=7500.0)}
        check_device(recorded, chip, filling, name="recording")


def test_a_mode_beside_the_antiresonance_is_no_other_capacitance(
    chip: Chip, recorded: Spectrum, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between two modes of a thick disc it may belong to a weak one, and show a third of what there is or less."""
    seen = figures(recorded)
    assert seen.antiresonance is not None
    weak = replace(seen.antiresonance, circuit_capacitance=0.1 * seen.antiresonance.circuit_capacitance)
    monkeypatch.setattr("workbench.fitting.prepare._resonance", lambda *_arguments: replace(seen, antiresonance=weak))
    check(recorded, chip)
    with pytest.raises(InputError, match="capacitance"):
        check(Spectrum(recorded.frequency, 10.0 * recorded.impedance), chip)


def test_a_resonance_where_the_device_has_none_is_refused(chip: Chip, recorded: Spectrum) -> None:
    # The same curve eight times as high in frequency, with the capacitance of this disc: 2.9 MHz, where the disc has
    # 1.1 MHz through its thickness and 0.36 MHz along its radius.
    with pytest.raises(InputError, match="through the thickness") as error:
        check(Spectrum(8.0 * recorded.frequency, recorded.impedance / 8.0), chip)
    assert error.value.field == "resonance"
    check(Spectrum(1.5 * recorded.frequency, recorded.impedance / 1.5), chip)


def test_a_window_without_a_resonance_is_refused(chip: Chip) -> None:
    frequency = np.linspace(300e3, 450e3, 50)
    plain = Spectrum(frequency, 3.0 + 1.0 / (2j * np.pi * frequency * 120e-12))
    with pytest.raises(InputError, match="a window with a resonance in it"):
        check(plain, chip)


def test_the_real_disc_passes_and_another_size_does_not(shared: Path) -> None:
    # 20 mm x 2 mm, measured; the same recording is not of a disc ten times as thick.
    from geometry.chip import read_chip as read_chip_file
    from workbench.readers import read_recording

    real = read_chip_file(Path(__file__).parent.parent / "geometry" / "chips" / "disc_20x2.toml")
    measured = read_recording(shared / "recordings" / "unibas-disc-20x2" / "MODULOFASEMODOTHICKNES.CSV").spectrum
    for low, high in ((0.95e6, 1.13e6), (0.97e6, 1.02e6)):
        check(measured.restricted(low, high), real)
    with pytest.raises(InputError, match="not of this device"):
        check(measured, real.with_dimensions({"transducer.thickness": 0.2e-3}))


# --------------------------------------------------------------------------------------------------------------------
# Records.


def test_the_record_says_everything_and_is_json(
    result: FitResult, prepared: Prepared, sources: tuple[Source, ...], folder: Path
) -> None:
    record = fit_record(result, prepared, sources, date=DATE)
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert record["accepted"]
    assert record["algorithm"] == "joint"
    assert record["date"] == "2026-11-21T14:40:00+00:00"
    rows = {p["name"].removeprefix(f"{MATERIAL}."): p for p in record["parameters"]}
    assert set(rows) == {"c11", "c33", "c11.loss"}
    for name, truth in (("c33", 1.05 * 115.41e9), ("c11", 0.97 * 138.99e9), ("c11.loss", -0.24e9)):
        # 0.5 %: the reduced model's 2e-5 and the loss, which Z_min alone carries.
        assert rows[name]["value"] == pytest.approx(truth, rel=5e-3)
        assert rows[name]["low"] < rows[name]["value"] < rows[name]["high"]
        assert rows[name]["unit"] == "Pa"
        assert rows[name]["prior"] > 0.0
        assert rows[name]["at_bound"] == ""
    assert rows["c33"]["start"] == 115.41e9
    assert record["mape_percent"] < 0.1 < record["recordings"][0]["start_mape_percent"]
    one = record["recordings"][0]
    assert one["sha256"] == hashlib.sha256((folder / "disc.csv").read_bytes()).hexdigest()
    assert one["chip_sha256"] == hashlib.sha256((folder / "disc.toml").read_bytes()).hexdigest()
    assert one["figures"]["measured"]["f0_hz"] == pytest.approx(one["figures"]["fitted"]["f0_hz"], rel=1e-4)
    assert abs(one["figures"]["start"]["f0_hz"] / one["figures"]["measured"]["f0_hz"] - 1.0) > 1e-3
    assert one["reader_findings"] == ["something"]
    assert len(record["correlation"]["rows"]) == 3
    assert [s["outcome"] for s in record["starts"]] == ["same optimum"]
    assert len(record["bands_left_out"]) == 2
    assert record["wall_seconds"] > 0.0
    assert record["full_solves"] > 0
    assert record["check_against_full_solves"]["relative_difference"] < 1e-3
    assert record["derived"] == []  # Table 4 is of solids


def worse(result: FitResult, **changes: Any) -> FitResult:
    return replace(result, **changes)


def test_a_fit_that_is_not_to_be_believed_says_why(result: FitResult) -> None:
    assert refusals(result) == ()
    assert "not better than its start" in refusals(worse(result, improved=False))[0]
    assert "did not converge" in refusals(worse(result, converged=False))[0]
    far = replace(result.estimates[0], value=4.3e17)
    assert "c11 ended at 4.3e+17 Pa, outside" in refusals(worse(result, estimates=(far, *result.estimates[1:])))[0]
    match = result.recordings[0]
    poor = replace(match, after=match.before)  # the start is 43 % off
    assert "42 % of Z remains" in refusals(worse(result, recordings=(poor,)))[0]
    assert "more than the 3 % that are accepted if a recording states no noise" in refusals(
        worse(result, recordings=(poor,)))[0]
    # Twice the noise that a recording states is too much, however little it is.
    noisy = replace(match, noise=replace(match.noise, stated=True, scale=2.1))
    assert "2.1 times the noise that it states" in refusals(worse(result, recordings=(noisy,)))[0]
    little = replace(match, noise=replace(match.noise, stated=True, scale=1.9))
    assert refusals(worse(result, recordings=(little,))) == ()


def test_a_residual_that_is_not_noise_is_accepted_after_the_whole_search_alone(result: FitResult) -> None:
    match = result.recordings[0]
    smooth = replace(match, after=replace(match.after, rms_log_residual=0.02),
                     noise=replace(match.noise, correlation=5.0, stated=False))
    found = worse(result, recordings=(smooth,))
    assert refusals(found) == ()
    assert refusals(worse(found, further=TRIES, untried=4)) == ()
    (few,) = refusals(worse(found, further=2, untried=4))
    assert "2 % of Z remains (rms), more than noise, and a better optimum was searched for by 2 further desc" in few
    assert f"try `--tries {TRIES}`" in few
    assert "let the search end" in refusals(worse(found, further=TRIES, untried=1, interrupted=True))[0]
    assert refusals(worse(found, interrupted=True)) == ()
    # An explained recording needs no further descents.
    assert refusals(worse(result, untried=4)) == ()
    assert reservations(result) == ()
    (lacks,) = reservations(found)
    assert "2 % of Z remains (rms), which is more than noise: the model lacks something" in lacks
    assert "Remedies: fixed parameters: " in lacks


def test_an_entry_is_saved_and_read_back(
    result: FitResult, prepared: Prepared, sources: tuple[Source, ...], tmp_path: Path
) -> None:
    held = replace(result.estimates[1], at_bound="upper bound 1.7e+11", determined=True)
    changed = worse(result, estimates=(replace(result.estimates[0], determined=True), held,
                                       replace(result.estimates[2], determined=False)))
    entry = registry_entry(changed, prepared, sources, date=DATE, forced=False, temperature=296.0)
    name = save_fit(entry, "pzt4/small", folder=tmp_path)
    assert name == "pzt4/small@1"
    read = Registry((tmp_path,)).load(name)
    c11, c33, loss = result.estimates
    assert read.c33 == complex(c33.value, -0.12e9)
    assert read.c11 == complex(c11.value, loss.value)
    assert read.c13 == prepared.material.c13
    assert read.density == 7500.0
    values = read.values
    assert (values["c33"].low, values["c33"].high) == (c33.low, c33.high)
    assert (values["c11"].loss_low, values["c11"].loss_high) == (loss.low, loss.high)
    assert values["c11"].uncertainty == c11.standard_error
    assert (values["c11"].status, values["c11"].loss_status) == ("fitted", "not determined")
    assert values["c33"].status == "at bound"
    assert "upper bound" in values["c33"].note
    assert values["c13"].status == "fixed"
    assert read.fit is not None
    assert read.fit.band == (300e3, 450e3)
    assert read.fit.recordings[0].sha256 == sources[0].sha256
    assert read.fit.free == ("c11", "c33", "c11 loss")
    assert read.fit.start == MATERIAL
    assert read.fit.temperature == 296.0
    assert read.fit.sample["transducer.thickness"] == "2 mm"
    assert read.fit.correlation is not None
    assert read.fit.correlation.names == ("c11", "c33")  # of what is determined
    assert read.fit.correlation.rows[0][1] == pytest.approx(result.correlation[0, 1])
    assert not read.fit.forced


def test_dimensions_and_bench_elements_go_with_the_sample(
    chip: Chip, recorded: Spectrum, sources: tuple[Source, ...], result: FitResult
) -> None:
    found = prepare(chip, Registry(), kind="pzt", name="disc", measured=recorded, accuracy=quadratic(2.0),
                    free=("c33", "transducer.thickness"))
    length = replace(result.estimates[0], parameter=found.parameters[1], value=2.001e-3, low=2.0e-3, high=2.002e-3)
    changed = worse(result, estimates=(replace(result.estimates[1], parameter=found.parameters[0]), length),
                    covariance=np.diag([1e16, 1e-12]))
    entry = registry_entry(changed, found, sources, date=DATE, forced=True)
    assert entry.fit is not None
    assert entry.fit.sample["transducer.thickness"] == "0.002001 m, fitted, 0.002 to 0.002002"
    assert entry.fit.free == ("c33",)
    assert entry.fit.correlation is None
    assert entry.fit.forced


def test_what_the_papers_algorithm_found_has_no_intervals(
    prepared: Prepared, sources: tuple[Source, ...], recorded: Spectrum, result: FitResult, tmp_path: Path
) -> None:
    names = [p.name for p in prepared.parameters]
    inside = (recorded.frequency > 330e3) & (recorded.frequency < 400e3)
    values = {name: e.value for name, e in zip(names, result.estimates, strict=True)}
    paper = PaperFit(values, {p.name: p.start for p in prepared.parameters}, 365e3, recorded.frequency[inside],
                     result.recordings[0].fitted.impedance[inside], 0.3, (), (1.0, 0.1), (0.9,), 200, 12, 0, 0, 3.0,
                     False, "the limit of 20 iterations was reached")
    found = paper_result(paper, prepared)
    assert found.improved
    # The start is that of the joint fit, on another mesh, for the material states no losses but those of the ten.
    assert found.recordings[0].before.mape_percent == pytest.approx(
        100 * np.mean(np.abs(np.abs(result.recordings[0].start.impedance / recorded.impedance)[inside] - 1.0)), rel=0.1)
    assert "did not converge" in refusals(found)[0]
    record = fit_record(found, prepared, sources, date=DATE)
    assert json.loads(json.dumps(record, allow_nan=False))["parameters"][0]["low"] is None
    assert record["correlation"]["rows"][0] == [None] * 3
    entry = registry_entry(found, prepared, sources, date=DATE, forced=True)
    read = Registry((tmp_path,)).load(save_fit(entry, "pzt4/paper", folder=tmp_path))
    assert read.values["c33"].low is None
    assert read.fit is not None
    assert read.fit.forced
    assert read.fit.algorithm == "paper"


def test_a_recording_is_the_one_prepared(prepared: Prepared) -> None:
    assert isinstance(prepared.recordings[0], FitRecording)
    assert prepared.recordings[0].measured is prepared.coarse[0].measured
