"""Examples and the programs that pages print: they run on public names, and examples print their reference numbers.

They run in this process, and those that ask for the same simulation, fit, study or diagnosis share it.
"""

from __future__ import annotations

import ast
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from printed import ROOT, SHARED, blocks, programs, remembered

import workbench as wb

#: The examples of the gallery that are run; those from 10 to 13 take minutes to hours, those from 16 to 17
#: minutes (`tests/benchmarks/design.py` runs what they show).
SHORT = sorted([*(ROOT / "examples").glob("0*.py"), *(ROOT / "examples").glob("1[45]_*.py"),
                *(ROOT / "examples").glob("1[89]_*.py"), *(ROOT / "examples").glob("2*.py")])
#: Words of programs that take more than some ten seconds.
SLOW = ("wb.fit(", "wb.diagnose(", "wb.range_model(", "wb.design_model(", "wb.study(", "wb.tolerance(",
        "wb.trajectories(", "domed_lid.toml")
#: Programs of pages, and those of the gallery.
PROGRAMS = dict(programs())
GALLERY = {path.stem: path.read_text(encoding="utf-8") for path in SHORT}
#: What an example may import beside `workbench`: the standard library and numpy.
PLAIN = {"dataclasses", "numpy", "pathlib", "tempfile", "workbench"}
#: Lines of any example, those with stages of hours included.
MOST_LINES = 120
#: Pictures that an example leaves below ``out``.
DRAWN = {
    "01_first_spectrum": {"first_spectrum.png"}, "02_cavity_height": {"cavity_height.png"},
    "03_your_own_chip": {"mesh_filled.png", "pressure_filled.png"}, "04_fit_a_disc": {"fit_a_disc.png"},
    "05_fit_a_polymer": {"fit_a_polymer.png"}, "06_compare_with_a_recording": {"compare.png"},
    "07_diagnose_a_campaign": set(), "09_bench_sweep": {"bench_sweep.png"}, "14_study": set(),
    "08_fields_and_traps": {"pressure_filled.png", "gorkov_filled.png", "cutaway_filled.png", "losses_filled.png"},
    "15_tolerance": {"yield.png", "samples.png", "tornado.png"},
    "18_your_own_shape": {"mesh_filled.png", "pressure_filled.png"},
    "19_the_photograph": {f"above_{energy}_{seconds}s.png" for energy in (15, 45) for seconds in (5, 60, 300, 1800)},
    "20_solder": {"solder.png"}, "21_my_chip_my_recording": {"my_empty.png", "my_filled.png"},
}
#: Words of what an example prints: the number that its docstring states, as far as it is printed.
SAID = {
    "01_first_spectrum": "f0=10304", "02_cavity_height": "height 0.74 mm: f0 1.0225 MHz",
    "03_your_own_chip": "couplant, layers[1].thickness: received '20'",
    "04_fit_a_disc": "pzt4/comsol_nominal.c33       1.2167e+11",
    "05_fit_a_polymer": "kept as pla_mine/print_1@1", "06_compare_with_a_recording": "rms of ln(Z/Z_ref) 0.",
    "07_diagnose_a_campaign": "(or fluid sound speed: these recordings cannot tell)",
    "08_fields_and_traps": "trap at r = 0.000 mm, z = 3.26",
    "14_study": "soda_lime_glass/en572_2012: f0 1.0462 MHz, -1.4",
    "09_bench_sweep": "f0 1.0332 MHz, the disc's own 1.0339 MHz",
    "15_tolerance": "f0 within 8 kHz: 51.4 % (48.3 to 54.5 %), linear estimate 79 %",
    "18_your_own_shape": "cavity 43.73 mm^3, f0 1.0298 MHz",
    "21_my_chip_my_recording": "filled, 28 degC: |Z| differs by 0.39 % on average",
    "20_solder": "ln Z changes by 226 %",
    "19_the_photograph": "15 J/m^3, 1.45 Vpp: the liquid carries beads with 1.7 um/s rms; the chip warms by 4 K",
}
#: Pages with the output of a program: of an example that they include, or of their own blocks.
PRINTED = {"01_first_spectrum": "first_hour", "21_my_chip_my_recording": "my_recording", "lab_week-7": "lab_week"}


def pieces(program: str) -> list[str]:
    """The printed output of a program on its page, in the pieces between dots of omission."""
    return [piece.strip() for name, text in blocks("text") if name.rpartition("-")[0] == PRINTED.get(program)
            for piece in text.split("...")]


def test_there_is_an_example_for_every_number() -> None:
    assert [path.stem for path in SHORT] == sorted(DRAWN) == sorted(SAID)
    numbers = [path.name[:2] for path in sorted((ROOT / "examples").glob("[0-9]*.py"))]
    assert numbers == [f"{k:02d}" for k in range(1, 22)]


def imported(tree: ast.AST) -> set[str]:
    """The modules that a program imports anywhere."""
    modules: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            modules.add(str(node.module))
    return modules


def used_of_workbench(tree: ast.AST) -> set[str]:
    """The names that a program takes from `wb`."""
    return {node.attr for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "wb"}


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda path: path.stem)
def test_an_example_uses_public_names_alone(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inner = {name for name in imported(tree) if name.startswith(("workbench.", "geometry.", "materials."))}
    assert not inner
    assert used_of_workbench(tree) - {"__file__"} <= set(wb.PUBLIC)


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda path: path.stem)
def test_an_example_can_be_read_in_one_sitting(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MOST_LINES


@pytest.mark.parametrize("path", SHORT, ids=lambda path: path.stem)
def test_an_example_of_the_gallery_is_short_and_plain(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 60
    tree = ast.parse(text)
    assert imported(tree) <= PLAIN
    assert "import workbench as wb" in text
    docstring = ast.get_docstring(tree)
    assert docstring is not None
    assert "Reference number:" in docstring


@pytest.fixture(scope="module")
def answers() -> dict[Any, Any]:
    """Answers of slow functions, by their arguments."""
    return {}


@pytest.fixture
def run(answers: dict[Any, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Runs the text of a program in a folder of its own."""
    for folder in ("geometry", "examples", "tests"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for name, key in SHARED.items():
        monkeypatch.setattr(wb, name, remembered(getattr(wb, name), key, answers))

    def in_this_process(text: str) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            exec(compile(text, "program", "exec"), {"__name__": "__main__"})

    return in_this_process


def marked(programs: dict[str, str]) -> list[Any]:
    """Their names as parameters, those of slow ones marked."""
    return [pytest.param(name, marks=pytest.mark.slow if any(word in text for word in SLOW) else ())
            for name, text in programs.items()]


@pytest.mark.parametrize("name", marked(GALLERY))
def test_an_example_runs(
    name: str, run: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(GALLERY[name])
    printed = capsys.readouterr().out
    assert SAID[name] in printed
    for piece in pieces(name):
        assert piece in printed
    assert {picture.name for picture in (tmp_path / "out").rglob("*.png")} >= DRAWN[name]


@pytest.mark.parametrize("name", marked(PROGRAMS))
def test_python_that_is_printed_runs(
    name: str, run: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    run(PROGRAMS[name])
    printed = capsys.readouterr().out
    for piece in pieces(name):
        assert piece in printed


def test_pages_for_learning_show_output() -> None:
    assert set(PRINTED) <= {*GALLERY, *PROGRAMS}
    assert all(len(pieces(name)) > 1 for name in PRINTED)
    for example, page in PRINTED.items():
        text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
        assert example in PROGRAMS or f"<!-- {example}: made by docs/tables.py -->" in text


def test_the_small_campaign_is_read() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        campaign = wb.read_campaign(ROOT / "geometry" / "chips" / "small_campaign" / "campaign.toml")
    assert [state.name for state in campaign.states] == ["empty", "filled"]
    assert campaign.states[1].temperature is None
