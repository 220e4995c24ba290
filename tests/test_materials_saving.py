"""Saved fits: what is written is what is read, versions, withdrawal, use outside the fit, and spoiled files."""

from __future__ import annotations

import math
import pickle
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from materials import (
    Correlation,
    Fit,
    Fluid,
    Material,
    Piezoelectric,
    RecordingSource,
    Registry,
    UseWarning,
    Value,
    WithdrawnWarning,
    check_use,
    describe,
    differences,
    fitted,
    history,
    save_fit,
    user_folder,
    user_registry,
    withdraw,
)
from workbench.files.errors import InputError

FIT = Fit(
    recordings=(RecordingSource("a \"disc\".csv", "0" * 64, "disc.toml", "f" * 64),
                RecordingSource("b.csv", "1" * 64, "stack")),
    algorithm="joint", software="acoustofluidic-chip-workbench 0.1.0", date="2026-11-21T14:40:00+00:00",
    band=(910e3, 1.1550000000000002e6), mape_percent=0.41, rms_log_residual=1 / 300, confidence=0.95,
    free=("c33", "c33 loss"), fixed=("eps11",), start="pzt4/acevedo_2026_initial", temperature=296.15,
    sample={"thickness": "2.02 mm", "batch no.": "7\n\"µ\" \x7f\\"},
    correlation=Correlation(("c33", "c33 loss"), ((1.0, -1 / 3), (-1 / 3, 1.0))),
    notes=("eps11 not determined",),
)  # fmt: skip
ESTIMATES = {
    "c33": Value(
        121.67e9 / 3 * 3.0000001 - 0.9e9j / 7, "", "", uncertainty=1e8 / 3, loss_uncertainty=1e7, low=121e9,
        high=122e9, loss_high=0.0, status="fitted", loss_status="at bound", note="told apart from c13",
    ),
    "eps33": Value(700.1, "", "", status="not determined", loss_status="fixed"),
}  # fmt: skip


def _start() -> Piezoelectric:
    material = Registry().load("pzt4/acevedo_2026_initial")
    assert isinstance(material, Piezoelectric)
    return replace(material, density=7500.0)


def _found(start: Material | None = None, *, fit: Fit = FIT) -> Material:
    return fitted(_start() if start is None else start, ESTIMATES if start is None else {}, fit=fit)


def _same(mine: Material, theirs: Material) -> None:
    assert theirs == replace(mine, name=theirs.name)
    assert theirs.values == mine.values
    assert theirs.fit == mine.fit


# --- what is written is what is read ---------------------------------------------------------------------------------


def test_a_saved_fit_is_read_back_to_the_last_bit(tmp_path: Path) -> None:
    found = _found()
    assert save_fit(found, "pzt4/disc_7", folder=tmp_path) == "pzt4/disc_7@1"
    read = Registry((tmp_path,)).load("pzt4/disc_7")
    assert read.name == "pzt4/disc_7@1"
    _same(found, read)
    assert read.source == "recording"
    assert read.fit is not None
    assert read.fit.density == 7500.0
    assert replace(read.fit, density=None) == FIT
    c33 = read.values["c33"]
    assert (c33.uncertainty, c33.low, c33.high, c33.loss_low, c33.loss_high) == (1e8 / 3, 121e9, 122e9, None, 0.0)
    assert (c33.status, c33.loss_status, c33.source) == ("fitted", "at bound", "recording")
    assert read.parameters()["c33"] == ESTIMATES["c33"].value
    assert pickle.loads(pickle.dumps(read)).fit == read.fit


def test_a_saved_fit_keeps_the_thermal_constants(tmp_path: Path) -> None:
    # Young's modulus and Poisson's ratio are converted; the conductivity is what the source printed.
    found = fitted(Registry().load("borosilicate_glass"), {}, fit=FIT)
    save_fit(found, "borosilicate_glass/lid_3", folder=tmp_path)
    read = Registry((tmp_path,)).load("borosilicate_glass/lid_3")
    _same(found, read)
    assert read.values["thermal_conductivity"].source == "schott_borofloat33"
    assert read.values["thermal_conductivity"].status == ""
    assert read.values["thermal_expansion"].value == pytest.approx(3.3e-6)
    assert read.values["bulk_modulus"].conditions == "converted from the printed constants"


def test_what_was_held_fixed_keeps_its_source() -> None:
    start = replace(_start(), density=7600.0)
    found = fitted(start, ESTIMATES, fit=FIT)
    c12 = found.values["c12"]
    assert (c12.source, c12.status, c12.loss_status) == (start.values["c12"].source, "fixed", "fixed")
    assert c12.source != "recording"
    # The chip file's density is nobody's but the fit's own.
    assert (found.values["density"].source, found.values["density"].conditions) == ("recording", "stated with the chip")


def test_a_fit_that_sets_out_from_a_fit_says_where_the_rest_is_from(tmp_path: Path) -> None:
    save_fit(_found(), "pzt4/disc_7", folder=tmp_path)
    second = fitted(Registry((tmp_path,)).load("pzt4/disc_7"), {}, fit=FIT)
    assert second.values["c33"].conditions == "as in pzt4/disc_7@1"
    save_fit(second, "pzt4/disc_8", folder=tmp_path)
    _same(second, Registry((tmp_path,)).load("pzt4/disc_8"))


@pytest.mark.parametrize("name", Registry().names())
def test_every_material_can_be_saved_as_a_fit(name: str, tmp_path: Path) -> None:
    # Every kind and every form: wave speeds, compliances, temperature laws.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the passivity of the paper's own constants
        start = Registry().load(name)
        found = _found(start)
        _same(found, Registry((tmp_path,)).load(save_fit(found, f"{name.split('/')[0]}/again", folder=tmp_path)))
    assert found.parameters() == start.parameters()
    assert all(value.source == start.source or value.source in ("recording", start.values[key].source)
               for key, value in found.values.items())


def test_an_estimate_of_something_else_is_refused() -> None:
    with pytest.raises(KeyError, match="bulk_modulus"):
        fitted(_start(), {"bulk_modulus": Value(1e9, "", "")}, fit=FIT)


def test_what_is_no_fit_is_not_saved(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no fit"):
        save_fit(_start(), "pzt4/disc_7", folder=tmp_path)
    with pytest.raises(ValueError, match="density"):
        save_fit(replace(_found(), density=7000.0), "pzt4/disc_7", folder=tmp_path)


@pytest.mark.parametrize(("found", "message"), [
    (lambda: fitted(_start(), {"c33": Value(121e9 + 1e9j, "", "")}, fit=FIT), "not saved.*c33.*imaginary part <= 0"),
    (lambda: fitted(_start(), {"c33": Value(121e9, "", "", uncertainty=math.nan)}, fit=FIT), "c33.uncertainty.*nan"),
    (lambda: fitted(_start(), {"c33": Value(121e9, "", "", low=122e9)}, fit=FIT), "c33.low.*1.21e"),
    (lambda: fitted(_start(), {"c33": Value(121e9, "", "", loss_high=-1.0)}, fit=FIT), "c33.loss_high"),
    (lambda: fitted(_start(), {"c33": Value(121e9, "", "", status="good")}, fit=FIT), "c33.status.*'good'"),
    (lambda: _found(fit=replace(FIT, recordings=())), "fit.recordings.*at least one"),
    (lambda: _found(fit=replace(FIT, recordings=(RecordingSource("a", "12", "b"),))), "sha256.*64 hexadecimal digits"),
    (lambda: _found(fit=replace(FIT, date="yesterday")), "fit.date.*'yesterday'"),
    (lambda: _found(fit=replace(FIT, band=(2e6, 1e6))), "fit.band.*two rising"),
    (lambda: _found(fit=replace(FIT, confidence=95.0)), "fit.confidence.*95.0.*between 0 and 1"),
    (lambda: _found(fit=replace(FIT, mape_percent=math.inf)), "fit.mape_percent.*inf"),
    (lambda: _found(fit=replace(FIT, rms_log_residual=-1.0)), "fit.rms_log_residual.*not below zero"),
    (lambda: _found(fit=replace(FIT, correlation=Correlation(("a", "b"), ((1.0, 0.5), (0.4, 1.0))))), "symmetric"),
    (lambda: _found(fit=replace(FIT, correlation=Correlation(("a",), ((1.0, 0.5),)))), "1 rows of 1 numbers"),
    (lambda: _found(fit=replace(FIT, notes=("\ud800",))), "can be encoded"),
    (lambda: _found(fit=replace(FIT, free=["c33"])), "fit: received.*becomes"),  # type: ignore[arg-type]
])  # fmt: skip
def test_what_could_not_be_read_back_is_not_saved(found: Callable[[], Material], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        save_fit(found(), "pzt4/disc_7", folder=tmp_path)
    assert not list(tmp_path.rglob("*"))


def test_an_active_fit_is_not_saved(tmp_path: Path) -> None:
    # Signs all right, but c13'' too large for c11'' and c33'' together: an eigenvalue below zero.
    active = fitted(_start(), {"c13": Value(74.3e9 + 1e9j, "", "")}, fit=FIT)
    with pytest.raises(InputError, match="dissipation matrix"):
        save_fit(active, "pzt4/disc_7", folder=tmp_path)


@pytest.mark.parametrize("name", ["disc_7", "pzt4/disc_7@1", "pzt4/../disc", "/etc/disc", "pzt4/", "a/b/c", "pzt4/a.b"])
def test_a_name_that_cannot_be_used(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="material/name in letters") as caught:
        save_fit(_found(), name, folder=tmp_path)
    assert caught.value.value == name


def test_an_entry_without_versions_gets_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"acevedo_2026_fitted\.toml has no versions"):
        save_fit(_found(), "pzt4/acevedo_2026_fitted", folder=tmp_path)


# --- versions --------------------------------------------------------------------------------------------------------


def test_a_name_means_the_newest_version(tmp_path: Path) -> None:
    registry = Registry((tmp_path,))
    names = [save_fit(_found(fit=replace(FIT, mape_percent=float(k))), "pzt4/disc_7", folder=tmp_path)
             for k in range(11)]
    assert names == [f"pzt4/disc_7@{k + 1}" for k in range(11)]  # @10 comes after @9, not after @1
    assert registry.load("pzt4/disc_7").name == "pzt4/disc_7@11"
    assert registry.load("pzt4/disc_7@2").name == "pzt4/disc_7@2"
    assert [version.name for version in history(registry, "pzt4/disc_7")] == names
    assert [name for name in registry.names() if "disc_7" in name] == names


def test_saving_changes_nothing_that_is_there(tmp_path: Path) -> None:
    save_fit(_found(), "pzt4/disc_7", folder=tmp_path)
    before = (tmp_path / "pzt4" / "disc_7@1.toml").read_bytes()
    save_fit(_found(fit=replace(FIT, mape_percent=3.0)), "pzt4/disc_7", folder=tmp_path)
    assert (tmp_path / "pzt4" / "disc_7@1.toml").read_bytes() == before
    assert {path.name for path in (tmp_path / "pzt4").iterdir()} == {"disc_7@1.toml", "disc_7@2.toml"}


def test_the_same_content_is_not_saved_again(tmp_path: Path) -> None:
    def saved(k: int, day: str = "21") -> str:
        fit = replace(FIT, mape_percent=float(k), date=f"2026-11-{day}")
        return save_fit(_found(fit=fit), "pzt4/disc_7", folder=tmp_path)

    assert [saved(1), saved(1, "22"), saved(2), saved(2), saved(1)] == [
        f"pzt4/disc_7@{number}" for number in (1, 1, 2, 2, 3)]
    assert {path.name for path in (tmp_path / "pzt4").iterdir()} == {f"disc_7@{k}.toml" for k in (1, 2, 3)}
    # A version that was withdrawn is not there any more.
    withdraw(Registry((tmp_path,)), "pzt4/disc_7@3", reason="wet", date=DATE)
    assert saved(1) == "pzt4/disc_7@4"
    # Another run saves the same between the look and the save.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("materials.saving.saved_versions", lambda *_: ["pzt4/disc_7@3"])
        assert saved(1) == "pzt4/disc_7@4"
        assert saved(5) == "pzt4/disc_7@5"


def test_saving_does_not_change_what_a_chip_file_means(tmp_path: Path) -> None:
    # "pla" has one entry, so a second one that is no saved fit would make the name ambiguous.
    save_fit(_found(Registry().load("pla")), "pla/print_3", folder=tmp_path)
    assert Registry((tmp_path,)).load("pla").name == "pla/acevedo_2026"


def test_a_material_known_from_fits_alone(tmp_path: Path) -> None:
    pla = _found(Registry().load("pla"))
    save_fit(pla, "resin/print_3", folder=tmp_path)
    save_fit(_found(Registry().load("pla"), fit=replace(FIT, mape_percent=3.0)), "resin/print_3", folder=tmp_path)
    assert Registry((tmp_path,)).load("resin").name == "resin/print_3@2"
    save_fit(pla, "resin/print_4", folder=tmp_path)
    with pytest.raises(InputError, match=r"one of resin/print_3, resin/print_4 \(none is declared"):
        Registry((tmp_path,)).load("resin")


@pytest.mark.parametrize(("wrong", "near"), [
    ("pzt4/disk_7", "pzt4/disc_7"), ("pzt4/disc_7@9", "pzt4/disc_7@1"), ("pzt4/disc_7@01", "pzt4/disc_7@1"),
])
def test_a_wrong_name_is_answered_with_near_ones(wrong: str, near: str, tmp_path: Path) -> None:
    save_fit(_found(), "pzt4/disc_7", folder=tmp_path)
    with pytest.raises(InputError, match=f"received '{wrong}'") as caught:
        Registry((tmp_path,)).load(wrong)
    assert near in caught.value.nearest


def test_the_users_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert user_folder() == tmp_path / "acoustofluidic-chip-workbench" / "materials"
    assert user_registry() == Registry()  # it does not exist yet
    save_fit(_found(), "pzt4/disc_7", folder=user_folder())
    assert user_registry().load("pzt4/disc_7").name == "pzt4/disc_7@1"
    # Named once more, it is not there twice.
    assert user_registry([user_folder()]).load("pzt4/disc_7").name == "pzt4/disc_7@1"
    assert "pzt4/disc_7@1" not in Registry().names()
    monkeypatch.delenv("XDG_DATA_HOME")
    assert user_folder() == Path.home() / ".local" / "share" / "acoustofluidic-chip-workbench" / "materials"


# --- withdrawal ------------------------------------------------------------------------------------------------------

DATE = "2026-11-22T09:00:00+00:00"


def test_a_withdrawn_version_is_read_by_its_full_name_alone(tmp_path: Path) -> None:
    registry = Registry((tmp_path,))
    for k in range(2):
        save_fit(_found(fit=replace(FIT, mape_percent=float(k))), "pzt4/disc_7", folder=tmp_path)
    withdraw(registry, "pzt4/disc_7@2", reason='the "wrong" disc', date=DATE)
    assert registry.load("pzt4/disc_7").name == "pzt4/disc_7@1"
    with pytest.warns(WithdrawnWarning, match=f'disc_7@2 was withdrawn on {DATE[:10]}.*the "wrong" disc') as said:
        assert registry.load("pzt4/disc_7@2").name == "pzt4/disc_7@2"
    assert said[0].filename == __file__
    assert save_fit(_found(), "pzt4/disc_7", folder=tmp_path) == "pzt4/disc_7@3"
    records = history(registry, "pzt4/disc_7")
    assert [record.withdrawal is not None for record in records] == [False, True, False]
    withdraw(registry, "pzt4/disc_7@1", reason="old", date=DATE)
    withdraw(registry, "pzt4/disc_7@3", reason="old", date=DATE)
    with pytest.raises(InputError, match="all 3 are withdrawn") as caught:
        registry.load("pzt4/disc_7")
    assert caught.value.nearest == ("pzt4/disc_7@3",)


@pytest.mark.parametrize(("name", "reason", "date", "message"), [
    ("pzt4/disc_7@1", "again", DATE, "not withdrawn yet.*on 2026-11-22.*first"),
    ("pzt4/disc_7", "x", DATE, "full name of a version, such as pzt4/disc_7@2"),
    ("pla", "x", DATE, "a version of a saved fit"), ("pzt4/disc_7@2", " ", DATE, "the reason for the withdrawal"),
    ("pzt4/disc_7@2", "x", "now", "'now'; expected a date"), ("pzt4/disc_9@1", "x", DATE, "pzt4/disc_9@1"),
])  # fmt: skip
def test_mistakes_in_withdrawing(name: str, reason: str, date: str, message: str, tmp_path: Path) -> None:
    registry = Registry((tmp_path,))
    for k in range(2):
        save_fit(_found(fit=replace(FIT, mape_percent=float(k))), "pzt4/disc_7", folder=tmp_path)
    withdraw(registry, "pzt4/disc_7@1", reason="first", date=DATE)
    with pytest.raises(InputError, match=message):
        withdraw(registry, name, reason=reason, date=date)
    assert [record.withdrawal for record in history(registry, "pzt4/disc_7")][1] is None


def test_the_history_of_something_else(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="this entry has no versions"):
        history(Registry(), "pla/acevedo_2026")
    with pytest.raises(InputError, match="'pla/nothing'"):
        history(Registry(), "pla/nothing")


# --- comparison, use, text -------------------------------------------------------------------------------------------


def test_differences_in_per_cent_and_in_standard_uncertainties(tmp_path: Path) -> None:
    def estimate(value: complex, uncertainty: float | None) -> Material:
        known = Value(value, "", "", uncertainty=uncertainty, loss_uncertainty=4e7)
        return fitted(_start(), {"c33": known, "e31": Value(-5.0 * value.real / 120e9, "", "")}, fit=FIT)

    first, second = estimate(120e9 - 1e8j, 3e8), estimate(126e9 - 2e8j, 4e8)
    found = {row.parameter: row for row in differences(first, second)}
    # 6 GPa against hypot(0.3, 0.4) GPa; -0.1 GPa against sqrt(2) x 0.04 GPa.
    assert found["c33"].percent == pytest.approx(5.0)
    assert found["c33"].deviations == pytest.approx(12.0)
    assert found["c33 loss"].percent == pytest.approx(100.0)
    assert found["c33 loss"].deviations == pytest.approx(-0.1 / 0.04 / math.sqrt(2.0))
    assert (found["e31"].percent, found["e31"].deviations) == (pytest.approx(5.0), None)
    assert (found["density"].percent, found["density"].deviations) == (0.0, None)
    assert "c12 loss" not in found
    # One uncertainty of two is no combined uncertainty.
    assert {r.parameter: r for r in differences(first, estimate(126e9, None))}["c33"].deviations is None
    with pytest.raises(InputError, match=r"Piezoelectric pzt4.*IsotropicSolid pla.*two materials of one kind"):
        differences(first, Registry().load("pla"))


def test_of_two_fluids_what_both_have() -> None:
    water = Registry().load("water")
    assert isinstance(water, Fluid)
    assert "heat_capacity" in {row.parameter for row in differences(water, water)}
    assert "heat_capacity" not in {row.parameter for row in differences(water, replace(water, heat_capacity=None))}


def _said(materials: list[Material], band: tuple[float, float]) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_use(materials, band=band)
    assert all(warning.category is UseWarning for warning in caught)
    return [str(warning.message) for warning in caught]


def test_use_outside_the_fit_is_warned_of_once_with_both_numbers(tmp_path: Path) -> None:
    save_fit(_found(), "pzt4/disc_7", folder=tmp_path)
    disc, pla = Registry((tmp_path,)).load("pzt4/disc_7"), Registry().load("pla")
    assert _said([disc, pla, disc], FIT.band) == []
    assert _said([disc], (1e6, 1.1e6)) == []
    fit = "pzt4/disc_7@1 was fitted"
    assert _said([disc, pla, disc], (0.3e6, 1.1e6)) == [f"{fit} from 0.91 to 1.155 MHz and is used from 0.3 to 1.1 MHz"]
    assert _said([disc], (1e6, 2e6)) == [f"{fit} from 0.91 to 1.155 MHz and is used from 1 to 2 MHz"]
    heavier = [f"{fit} with a density of 7500 kg/m^3 and is used with 7862 kg/m^3"]
    assert _said([replace(disc, density=7862.0)], FIT.band) == heavier
    assert len(_said([replace(disc, density=7862.0)], (0.3e6, 2e6))) == 2


def test_a_fit_is_described_with_intervals_and_provenance(tmp_path: Path) -> None:
    text = describe(_found())
    for part in ("1.21e+11 to 1.22e+11", "loss below 0", "loss at bound", "not determined", "a \"disc\".csv", "0" * 64,
                 "joint, acoustofluidic", "0.91 to 1.155 MHz", "296.15 K", "thickness 2.02 mm", "0.41 %", "95 %",
                 "c33 loss, c33 -0.33", "eps11 not determined", FIT.date):  # fmt: skip
        assert part in text, part
    assert "NOT ACCEPTED" not in text
    assert "NOT ACCEPTED" in describe(_found(fit=replace(FIT, forced=True)))
    assert "recording" not in describe(_start())


# --- spoiled files ---------------------------------------------------------------------------------------------------


def _saved(tmp_path: Path) -> tuple[Registry, Path]:
    save_fit(_found(), "pzt4/disc_7", folder=tmp_path)
    return Registry((tmp_path,)), tmp_path / "pzt4" / "disc_7@1.toml"


#: What is replaced, by what, and the start of the line that has to be named.
SPOILED = {
    "syntax": ("uncertainty = ", "uncertainty ", "c33 ="),
    "value": ("value = 7500.0", "value = 'heavy'", "density ="),
    "unit": ('unit = "C/m^2"', 'unit = "C"', "e31 ="),
    "key": ("mape_percent", "mape", "mape ="),
    "status": ('"at bound"', '"bound"', "c33 ="),
    "band": ('"910000.0 Hz"', '"910000.0"', "band ="),
    "digest": ("0" * 64, "0" * 63, "recordings ="),
    "matrix": ("rows = [[1.0", "rows = [[1.5", "rows ="),
    "sample": ('"2.02 mm"', "2.02", "thickness ="),
    "sign": ("loss = -", "loss = ", "c11 ="),
    "kind": ('kind = "piezoelectric"', 'kind = "piezo"', "kind ="),
    "source": ('source = "recording"', 'source = "record"', "source ="),
}  # fmt: skip


@pytest.mark.parametrize("mistake", SPOILED)
def test_a_spoiled_entry_is_named_with_its_line(mistake: str, tmp_path: Path) -> None:
    registry, path = _saved(tmp_path)
    old, new, start = SPOILED[mistake]
    text = path.read_text(encoding="utf-8")
    assert old in text
    spoiled = text.replace(old, new, 1)
    path.write_text(spoiled, encoding="utf-8")
    (line,) = [k for k, row in enumerate(spoiled.splitlines(), start=1) if row.startswith(start)]
    with pytest.raises(InputError, match=rf"line {line}\b") as caught:
        registry.load("pzt4/disc_7")
    assert caught.value.source.startswith(str(path))
    # And it hides no other entry.
    assert save_fit(_found(), "pzt4/disc_7", folder=tmp_path) == "pzt4/disc_7@2"
    assert registry.load("pzt4/disc_7").name == "pzt4/disc_7@2"
    first, second = history(registry, "pzt4/disc_7")
    assert f"line {line}" in first.fault
    assert second.fault == ""


def test_a_fit_that_has_lost_its_table_is_no_fit(tmp_path: Path) -> None:
    registry, path = _saved(tmp_path)
    text = path.read_text(encoding="utf-8")
    path.write_text(text[: text.index("[fit.sample]")], encoding="utf-8")
    with pytest.raises(InputError, match=r"line 3: source.*'recording'.*needs a \[fit\] table"):
        registry.load("pzt4/disc_7")


def test_an_entry_truncated_anywhere_is_named_with_a_line(tmp_path: Path) -> None:
    registry, path = _saved(tmp_path)
    whole = path.read_bytes()
    # Every cut in the last part, where only the end is missing, and every 37th before; the last byte is a line end.
    for length in sorted({*range(0, len(whole) - 1, 37), *range(len(whole) - 200, len(whole) - 1)}):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"disc_7@1\.toml(, line \d+: | \(ends at line \d+\): |.*at line \d+)"):
            registry.load("pzt4/disc_7")
    path.write_bytes(whole)
    assert registry.load("pzt4/disc_7").name == "pzt4/disc_7@1"


def test_a_table_in_a_text_is_no_table(tmp_path: Path) -> None:
    path = tmp_path / "thing" / "mine.toml"
    path.parent.mkdir()
    path.write_text('kind = "fluid"\ntitle = "x"\nsource = "iapws_2011"\nconditions = "y"\nnote = """\n'
                    'density = 1\n[sound_speed]\n"""\n\n'
                    'density = { value = 1.0, unit = "kg" }\n[sound_speed]\nvalue = 1.0\nunit = "m/s"\n')
    with pytest.raises(InputError, match=r"mine\.toml, line 10: density\.unit"):
        Registry((tmp_path,)).load("thing")


def test_a_spoiled_withdrawal_is_named_and_still_one(tmp_path: Path) -> None:
    registry, path = _saved(tmp_path)
    withdraw(registry, "pzt4/disc_7@1", reason="x", date=DATE)
    record = path.with_suffix(".withdrawn")
    record.write_text(record.read_text().replace("date", "dat"))
    with pytest.raises(InputError, match=r"disc_7@1\.withdrawn, line 1: dat"):
        registry.load("pzt4/disc_7@1")
    with pytest.raises(InputError, match="all 1 are withdrawn"):
        registry.load("pzt4/disc_7")


def test_the_reserved_source_is_for_fits_alone(tmp_path: Path) -> None:
    path = tmp_path / "thing" / "mine.toml"
    path.parent.mkdir()
    path.write_text('kind = "fluid"\ntitle = "x"\nsource = "recording"\nconditions = "y"\n'
                    'density = { value = 1.0, unit = "g/cm^3" }\nsound_speed = { value = 1500.0, unit = "m/s" }\n')
    with pytest.raises(InputError, match=r"line 3: source: received 'recording'.*needs a \[fit\] table"):
        Registry((tmp_path,)).load("thing")
