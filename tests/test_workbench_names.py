"""Names that files give, and text that is shown as it stands: in pictures, on the terminal, in HTML."""

from __future__ import annotations

import html
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from matplotlib.text import Text
from PIL import Image
from support import layer_text

from geometry.chip import parse_chip, read_chip
from geometry.chip_file import chip_text
from materials.exchange import import_entries
from materials.registry import PACKAGE_DATA, Registry
from materials.versions import check_saved_name, split_version
from workbench.campaign.campaign import read_campaign
from workbench.cli import main
from workbench.commands.console import error_console
from workbench.commands.terminal import print_line, print_table, progress_bars
from workbench.design.plan import read_study
from workbench.files.errors import InputError
from workbench.files.names import MOST_BYTES, NUMBER_MARKS, check_name, check_title, visible
from workbench.files.tables import DEEPEST, parse_json, parse_toml, read_toml
from workbench.fitting.batch import read_batch
from workbench.readers import read_recording
from workbench.render.canvas import new_figure, save_figure
from workbench.report.page import Note, TextTable, Verbatim, write_report
from workbench.results.spectrum import Origin, Spectrum, write_spectrum

CHIP = """
[chip]
name = "NAME"
band = ["0.95 MHz", "1.05 MHz"]
""" + "".join((
    layer_text("transducer", "MATERIAL", thickness="2 mm", radius="5 mm"),
    layer_text("substrate", "pmma", thickness="1 mm", radius="5 mm"),
    layer_text("sidewall", "pmma", thickness="0.72 mm", radius="5 mm", cavity_radius="2.5 mm"),
    layer_text("superstrate", "soda_lime_glass", thickness="1 mm", radius="5 mm"),
)) + """[states."STATE"]
cavity = "FILLING"
particle = "PARTICLE"
particle_radius = "5 um"
materials = { substrate = "OTHER" }
reported = [{ label = "LABEL", f0 = "1 MHz", z_min = "2 ohm", q = 100.0 }]
"""
PLAIN = {"NAME": "my chip", "MATERIAL": "pzt4/acevedo_2026_fitted", "STATE": "filled", "FILLING": "water",
         "PARTICLE": "polystyrene", "OTHER": "pla", "LABEL": "paper"}
DISC = Path(__file__).resolve().parent.parent / "geometry" / "chips" / "disc_20x2.toml"

BATCH = """
[batch]
name = "NAME"
[[recordings]]
name = "ROW"
file = "one.csv"
chip = "chip.toml"
kind = "pzt"
save = "SAVE"
[[recordings]]
name = "two"
file = "one.csv"
chip = "chip.toml"
kind = "pzt"
[[joint]]
name = "JOINT"
recordings = ["ROW", "two"]
save = "TOGETHER"
"""
CAMPAIGN = """
[campaign]
name = "NAME"
[states."STATE"]
chip = "chip.toml"
recording = "one.csv"
"""
STUDY = """
[study]
name = "NAME"
chip = "chip.toml"
figures = ["f0"]
[vary]
"substrate.thickness" = { from = "0.8 mm", to = "0.9 mm", points = 3 }
"""

#: What TOML may write in the place of a name of a file, and no file may be called.
NO_FILES = ("x/../../../escaped", "../up", "/etc/passwd", ".hidden", "..", "a\\u001b[2J", "a\\nb", "a\\u0000", "dot.",
            "blank ", "-o", "a\\\\b", "a:b", "a$b", "a\\u202Eb", "n" * 100)
#: And in the place of a title.
NO_TITLES = ("a\\u001b]0;own\\u0007", "a\\nb", "a\\rb", "a\\u0085b", "a\\u2028b", "a\\u202Eb", "a\\u009b2J", "a\\u007F")


def written(folder: Path, name: str, text: str, **names: str) -> Path:
    for key, value in names.items():
        text = text.replace(key, value)
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    written(tmp_path, "chip.toml", CHIP, **PLAIN)
    frequency = np.linspace(0.95e6, 1.05e6, 11)
    write_spectrum(Spectrum(frequency, 10.0 - 300.0j * (1e6 / frequency)), tmp_path / "one.csv")
    return tmp_path


# --------------------------------------------------------------------------------------------------------------------
# The rule.


def mistake(check: Callable[..., str], text: str) -> InputError | None:
    """The error that refuses a text, whose remedy must be one; None if the text is returned as it is."""
    try:
        assert check(text, source="chip", field="states") == text
    except InputError as error:
        for nearest in error.nearest:
            assert check(nearest, source="", field="") == nearest
        return error
    return None


@given(st.text())
@example("a/..")
@example("\u0345")
@example("a" * 81)
def test_a_name_is_refused_or_names_a_file_of_its_folder(name: str) -> None:
    error = mistake(check_name, name)
    if error is not None:
        assert (error.source, error.field, error.value) == ("chip", "states", name)
        return
    path = Path("/results") / f"{name}.csv"
    assert path.parent == Path("/results")
    assert path.stem == name == name.strip()
    assert len(path.name.encode()) <= MOST_BYTES + 4
    assert visible(name) == name
    assert not name.startswith(".")


@given(st.text())
@example("a\u2028b")
@example("\ud800")
def test_a_title_is_refused_or_printed_on_one_line(title: str) -> None:
    if mistake(check_title, title) is not None:
        return
    assert len(title.splitlines()) == 1
    assert visible(title) == title


@given(st.text())
def test_visible_text_has_no_control_characters(text: str) -> None:
    shown = visible(text)
    assert visible(shown) == shown
    assert len(shown.splitlines()) <= 1
    shown.encode("utf-8")  # half characters cannot be
    kept = visible(text, keep="\n\t")
    assert kept.count("\n") == text.count("\n")


@pytest.mark.parametrize("name", ["filled", "filled_2", "20 degC", "A.1+2-b", "Gefüllt", "水", "हिन्दी", "заполнено"])
def test_letters_of_every_script_make_names(name: str) -> None:
    assert check_name(name, source="", field="") == name


def test_the_remedy_is_the_name_without_what_is_wrong() -> None:
    for wrong, right in {"x/../../../escaped": "x_escaped", "disc/2": "disc_2", ".hidden": "hidden", "dot.": "dot",
                         "a\x1b[2J": "a_2J", "a$b": "a_b"}.items():
        with pytest.raises(InputError, match=f"did you mean '{right}'"):
            check_name(wrong, source="", field="")
    with pytest.raises(InputError, match=r"did you mean 'evil \[2J red'"):
        check_title("evil \x1b[2J\nred", source="", field="")


@pytest.mark.parametrize("name", ["disc", "pzt4/a/b", "pzt4/a.b", "pzt4/a b", "pzt4/a@1", "../a", "/a", "a/", "a/..",
                                  "a/\n", 3])
def test_a_fit_is_saved_under_two_names_that_numbers_can_have(name: str) -> None:
    with pytest.raises(InputError, match="a material/name in letters, digits"):
        check_saved_name(name)
    assert check_saved_name("pzt4/disc_7") == check_name("pzt4/disc_7", source="", field="", form="a/b",
                                                         marks=NUMBER_MARKS)


def test_a_version_of_thousands_of_digits_is_none() -> None:
    assert split_version("pzt4/disc_7@12") == ("pzt4/disc_7", 12)
    assert split_version("pzt4/disc_7@" + "1" * 5000) is None


# --------------------------------------------------------------------------------------------------------------------
# In the files of users.


def refused(read: Callable[[Path], object], path: Path, field: str, line: int | None) -> None:
    """The file is refused, the field is named, and the line unless a text of several lines or none states it."""
    with pytest.raises(InputError) as caught:
        read(path)
    assert caught.value.field == field
    assert caught.value.source == (str(path) if line is None else f"{path}, line {line}")
    assert visible(str(caught.value)) == str(caught.value)


@pytest.mark.parametrize("name", NO_FILES)
def test_no_state_row_or_joint_fit_names_a_file_elsewhere(name: str, folder: Path) -> None:
    refused(read_chip, written(folder, "own.toml", CHIP, **PLAIN | {"STATE": name}), "states", 26)
    refused(read_campaign, written(folder, "campaign.toml", CAMPAIGN, NAME="device", STATE=name), "states", 4)
    good = {"NAME": "discs", "ROW": "disc 1", "SAVE": "pzt4/one", "JOINT": "both", "TOGETHER": "pzt4/two"}
    refused(read_batch, written(folder, "batch.toml", BATCH, **good | {"ROW": name}), "recordings[0].name", 5)
    refused(read_batch, written(folder, "batch.toml", BATCH, **good | {"JOINT": name}), "joint[0].name", 16)
    refused(read_batch, written(folder, "batch.toml", BATCH, **good | {"SAVE": name}), "recordings[0].save", 9)
    refused(read_batch, written(folder, "batch.toml", BATCH, **good | {"TOGETHER": f"a/{name}"}), "joint[0].save", 18)


@pytest.mark.parametrize("title", NO_TITLES)
def test_no_title_has_control_characters(title: str, folder: Path) -> None:
    for key, field, line in (
            ("NAME", "chip.name", 3), ("MATERIAL", "layers[0].material", 7), ("FILLING", "states.filled.cavity", 27),
            ("PARTICLE", "states.filled.particle", 28), ("OTHER", "states.filled.materials.substrate", 30),
            ("LABEL", "states.filled.reported[0].label", 31)):
        refused(read_chip, written(folder, "own.toml", CHIP, **PLAIN | {key: title}), field, line)
    refused(read_campaign, written(folder, "campaign.toml", CAMPAIGN, NAME=title, STATE="a"), "campaign.name", 3)
    refused(read_batch, written(folder, "batch.toml", BATCH, NAME=title, ROW="a", SAVE="a/b", JOINT="c",
                                TOGETHER="a/c"), "batch.name", 3)
    refused(read_study, written(folder, "study.toml", STUDY, NAME=title), "study.name", 3)


def test_names_are_checked_in_python_too(folder: Path) -> None:
    chip = read_chip(folder / "chip.toml")
    with pytest.raises(InputError, match=r"states: received '\.\./up'"):
        replace(chip, states=(replace(chip.states[0], name="../up"),))
    with pytest.raises(InputError, match=r"chip.name: received 'a\\nb'"):
        replace(chip, name="a\nb")


def test_a_chip_of_any_title_is_read_back(folder: Path) -> None:
    chip = replace(read_chip(folder / "chip.toml"), name=r'50 $ "and" \frac{1}{2} [red] <b> 水')
    assert parse_chip(read_toml(written(folder, "own.toml", chip_text(chip))), source=chip.file) == chip


@pytest.mark.parametrize(("place", "refused_as"), [("pzt4/a\x1b[2J.toml", "pzt4/a\x1b[2J"), ("a$b/c.toml", "a$b/c")])
def test_files_of_materials_are_names(place: str, refused_as: str, tmp_path: Path) -> None:
    path = tmp_path / place
    path.parent.mkdir()
    shutil.copy(PACKAGE_DATA / "pmma" / "hartmann_1974.toml", path)
    with pytest.raises(InputError) as caught:
        Registry(tmp_path).names()
    assert (caught.value.source, caught.value.value) == (str(path), refused_as)


def test_hidden_files_are_no_materials(tmp_path: Path) -> None:
    for place in ("own/._sheet.toml", ".trash/sheet.toml", "own/vendor sheet.toml", "own/disc@2.toml"):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        (tmp_path / place).write_bytes(b"")
    assert {*Registry(tmp_path).names()} - {*Registry().names()} == {"own/vendor sheet", "own/disc@2"}


@pytest.mark.parametrize("command", [
    ["simulate", "chip.toml"], ["mesh", "chip.toml"], ["export", "chip.toml"], ["compare", "one.csv", "chip.toml"],
    ["render", "chip.toml", "--at", "1 MHz"], ["sensitivity", "chip.toml"],
    ["diagnose", "one.csv", "--chip", "chip.toml"], ["fit", "pzt", "one.csv", "--chip", "chip.toml"],
    ["particles", "chip.toml", "--drive", "10 Vpp", "--minutes", "1"], ["tolerance", "chip.toml"]],
    ids=lambda command: command[0])
def test_a_state_that_leaves_the_folder_writes_nothing(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path, "chip.toml", CHIP, **PLAIN | {"STATE": "x/../../../escaped"})
    written(tmp_path, "one.csv", "frequency_hz,z_real_ohm,z_imag_ohm\n1e6,1,1\n1.1e6,1,1\n")
    monkeypatch.chdir(tmp_path)
    assert main([*command, "-o", "a/b/out"]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "line 26: states: received 'x/../../../escaped'" in told
    assert "did you mean 'x_escaped'?" in told
    assert not list(tmp_path.rglob("*escaped*"))


# --------------------------------------------------------------------------------------------------------------------
# On the terminal.


def raw(text: str) -> bool:
    """Whether a terminal would act on the text."""
    return visible(text, keep="\n\t") != text


def test_a_stranger_s_title_does_not_reach_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, "disc.toml", DISC.read_text().replace(
        "free disc 20 x 2 mm", r"evil \u001b]0;owned\u0007\u001b[2J\u001b[31mred"))
    assert main(["simulate", str(path), "--no-cad", "--no-pictures", "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr()
    assert not raw(told.out + told.err)
    assert r"evil \x1b]0;owned" in told.err


def test_control_characters_of_paths_and_messages_are_escapes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    place = Path("a\x1b[2J\x07 [red] :bug:")
    place.mkdir()
    shutil.copy(DISC, place / "disc.toml")
    assert main(["export", str(place / "disc.toml"), "-o", str(place)]) == 0
    assert main(["export", str(place / "none.toml"), "-o", str(place)]) == 2
    told = capsys.readouterr()
    assert not raw(told.out + told.err)
    assert r"a\x1b[2J\x07 [red] :bug:" in told.out  # paths of the files
    assert r"a\x1b[2J\x07 [red] :bug:" in told.err  # and of the one that is not there


def test_every_way_to_the_terminal_is_visible(capsys: pytest.CaptureFixture[str]) -> None:
    text = "a\x1b[2J [/red] :bug: \x9b \u202e \udcff"
    console = error_console()
    console.print(text, style="yellow")
    print_line(text)
    print_table(text, TextTable((text, "x"), ((text, text),)))
    with progress_bars(console) as show:
        show(text, text, 0.5)
    told = capsys.readouterr()
    assert not raw(told.out + told.err)
    assert told.err.count("[/red] :bug:") >= 2
    assert told.out.count(r"\x1b[2J") == 5


def test_what_a_recording_states_is_one_line(folder: Path) -> None:
    text = (folder / "one.csv").read_text()
    path = written(folder, "own.csv", "# instrument: bad\u009b2J\u2028# kind: simulated\n# setting a\u0085b: c\td\n"
                   + "".join(line for line in text.splitlines(keepends=True) if not line.startswith("#")))
    origin = read_recording(path).spectrum.origin
    assert origin.instrument == r"bad\x9b2J\u2028# kind: simulated"
    assert origin.settings == {r"a\x85b": "c\td"}
    again = read_recording(write_spectrum(read_recording(path).spectrum, folder / "again.csv")).spectrum.origin
    assert again == origin
    assert Origin(source="a\nb\udcff.csv").source == r"a\nb\udcff.csv"


# --------------------------------------------------------------------------------------------------------------------
# In pictures and reports.

#: Names that matplotlib would set as formulas, or fail to.
FORMULAS = (r"disc for $20 and \frac$ x_{", "from $5 to $6", r"\undefined{$ $", "$x_1^2$", r"a\$b", "a_b^c")


@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_names_in_pictures_are_text(name: str, suffix: str, tmp_path: Path) -> None:
    figure = new_figure(6.0, 4.0)
    figure.suptitle(name)
    axes = figure.subplots()
    axes.plot([1.0, 10.0, 100.0], [1.0, 2.0, 3.0], label=name)
    axes.set_title(name)
    axes.set_ylabel(name)
    axes.set_xscale("log")
    axes.set_yticks([1.0, 2.0], labels=[name, name])
    axes.annotate(name, (1.0, 1.0))
    axes.legend(title=name)
    figure.tight_layout()
    save_figure(figure, tmp_path / f"a.{suffix}")
    shown = [text for text in figure.findobj(Text) if isinstance(text, Text) and text.get_text() == name]
    assert len(shown) == 10  # a label of a tick is two
    assert not any(text.get_parse_math() for text in shown)
    # The powers of ten of an axis are formulas all the same, and the user's own settings stay.
    powers = axes.xaxis.get_majorticklabels()
    assert any("10^{1}" in text.get_text() for text in powers)
    assert all(text.get_parse_math() for text in powers)
    assert mpl.rcParams["text.parse_math"]


def test_a_name_that_is_no_formula_looks_as_it_did(tmp_path: Path) -> None:
    """The title alone differs from that of a figure of matplotlib's, and only where there are formulas."""
    def drawn(name: str, path: Path) -> bytes:
        figure = new_figure(3.0, 2.0)
        figure.subplots().set_title(name)
        return Image.open(save_figure(figure, path)).tobytes()

    assert drawn("$a$", tmp_path / "a.png") != drawn("a", tmp_path / "b.png")


def test_a_file_of_another_encoding_is_drawn(tmp_path: Path) -> None:
    figure = new_figure(3.0, 2.0)
    figure.subplots().set_title("messung_\udcfc\x1b")
    figure.tight_layout()
    assert save_figure(figure, tmp_path / "a.png").is_file()


def test_a_chip_called_by_a_formula_is_simulated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = r"disc for $20 and \frac$ x_{ <b>"
    path = written(tmp_path, "disc.toml", DISC.read_text().replace("free disc 20 x 2 mm", name.replace("\\", "\\\\")))
    assert main(["simulate", str(path), "--accuracy", "5 %", "--points", "21", "--no-cad", "-o",
                 str(tmp_path / "out")]) == 0
    assert name in capsys.readouterr().out
    assert name in html.unescape((tmp_path / "out" / "report.html").read_text(encoding="utf-8"))


def test_text_in_a_report_is_text(tmp_path: Path) -> None:
    text = "<script>alert(1)</script> & \x1b \u202e \udcff"
    page = write_report(tmp_path / "a.html", text, [(text, [
        text, Note(text), Verbatim(text), TextTable((text, "x"), ((text, text),))])]).read_text(encoding="utf-8")
    assert "<script>" not in page
    assert not raw(page)
    assert page.count("&lt;script&gt;") == 9


# --------------------------------------------------------------------------------------------------------------------
# Files that are nested beyond sense, and numbers beyond measure.

WRONG = {
    "lists": "a = " + "[" * 2000 + "]" * 2000,
    "lists that a parser takes": "a = " + "[" * 200 + "]" * 200,
    "lists that do not end": "a = " + "[" * 5000,
    "tables": "a = " + "{ b = " * 2000,
    "headings": "[" + ".".join(["a"] * 3000) + "]\n",
    "keys": ".".join(["a"] * 3000) + " = 1\n",
    "digits": "a = " + "1" * 5000,
    "hexadecimal digits": "a = 0x" + "f" * 9000,
    "more than 64 bits": "a = -9223372036854775809",
}


@pytest.mark.parametrize("text", WRONG.values(), ids=WRONG)
def test_toml_beyond_sense_is_one_line(text: str, tmp_path: Path) -> None:
    path = written(tmp_path, "a.toml", text)
    with pytest.raises(InputError) as caught:
        read_toml(path)
    assert str(caught.value).startswith(f"{path}: TOML syntax: ")
    assert len(str(caught.value)) < len(str(path)) + 300


def test_toml_within_sense_is_read() -> None:
    assert parse_toml("a = " + "[" * DEEPEST + "]" * DEEPEST, source="a")
    assert parse_toml("a = [9223372036854775807, -9223372036854775808]", source="a")["a"][1] == -(2**63)


@pytest.mark.parametrize("text", ["[" * 5000, '{"a": ' * 300 + "1" + "}" * 300, "1" * 5000, '{"a": ' + "1" * 30 + "}"])
def test_json_beyond_sense_is_one_line(text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a: JSON syntax: .*; expected a file"):
        parse_json(text, source="a", expected="a file")
    path = written(tmp_path, "materials.json", text)
    with pytest.raises(InputError, match="JSON syntax: "):
        import_entries(path, folder=tmp_path)


def test_an_imported_name_of_thousands_of_digits_is_refused(tmp_path: Path) -> None:
    entry = {"name": "pzt4/disc@" + "1" * 5000, "content": "x", "sha256": "x"}
    path = written(tmp_path, "materials.json", json.dumps(
        {"format": "acoustofluidic-chip-workbench materials 1", "entries": [entry]}))
    with pytest.raises(InputError, match="name: received"):
        import_entries(path, folder=tmp_path)


@pytest.mark.parametrize("command", [
    ["mesh", "FILE", "-o", "OUT"], ["study", "FILE", "-o", "OUT"], ["design", "FILE", "-o", "OUT"],
    ["diagnose", "FILE", "-o", "OUT"], ["fit", "batch", "FILE", "-o", "OUT"], ["tolerance", "FILE", "-o", "OUT"],
    ["bench", "check", "FILE"]], ids=lambda command: command[0])
@pytest.mark.parametrize("kind", ["lists", "digits", "keys"])
def test_every_command_answers_it_with_the_file(
    command: list[str], kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, "own.toml", WRONG[kind])
    assert main([{"FILE": str(path), "OUT": str(tmp_path / "out")}.get(word, word) for word in command]) == 2
    told = capsys.readouterr()
    assert f"error: {path}: TOML syntax: received" in told.err
    assert told.err.count("\n") == 1
