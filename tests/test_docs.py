"""The documentation: commands, files and names in it exist, and all of it is built without a warning."""

from __future__ import annotations

import ast
import dataclasses
import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from printed import PAGES, blocks

import workbench as wb
from workbench.bench.setup import Acquisition, Standards
from workbench.campaign.state import STATE_KEYS
from workbench.commands.options import command_parser
from workbench.diagnosis.decision import VERDICTS

ROOT = Path(__file__).resolve().parent.parent
#: Words of a command that stand for something of the reader's.
STANDS_FOR = {"DIR", "FOLDER", "RECORDING"}


def commands() -> Iterator[tuple[str, str]]:
    """(page and number, one command) of the blocks of the shell."""
    for name, text in blocks("sh"):
        for line in text.splitlines():
            for command in line.split("&&"):
                yield name, command.partition("#")[0].strip()


def test_the_walk_sees_what_there_is_to_see() -> None:
    # Or the tests below hold of nothing.
    assert {"README-1", "README-2", "diagnosis-1", "add_material-1"} <= {name for name, _ in blocks("python")}
    assert len(list(commands())) > 50


@pytest.mark.parametrize(("name", "command"), [pytest.param(*both, id=f"{both[0]}: {both[1]}"[:80])
                                               for both in commands()])
def test_commands_that_are_printed_exist(name: str, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = [word for word in shlex.split(command) if not re.fullmatch(r"[A-Z]+=\S+", word)]
    match words:
        case ["workbench" | ".venv/bin/workbench", *rest]:
            try:
                command_parser().parse_args(rest)
            except SystemExit:
                pytest.fail(f"{name}: {command}\n{capsys.readouterr().err}")
            files = [word for word in rest if word.startswith(("geometry/", "tests/", "examples/"))]
        case ["./setup" | "./check" as script, *_]:
            files = [script]
        case [".venv/bin/python", "-m", "pytest", *rest]:
            files = [word for word in rest if not word.startswith("-") and word != "slow"]
            assert files
        case [".venv/bin/python", "-m", "sphinx", *rest]:
            files = ["docs"]
            assert "docs" in rest
        case [".venv/bin/python", script, *rest]:
            # A word such as pzt4/acevedo_2026_initial is a material.
            files = [script, *(word for word in rest if (ROOT / word.partition("/")[0]).is_dir() and "/" in word)]
            text = (ROOT / script).read_text(encoding="utf-8")
            for word in rest:
                # An option or a subcommand is one that the script has.
                if not (word in STANDS_FOR or "/" in word or re.fullmatch(r"[\d.]+", word)):
                    assert re.search(rf"(?<!\w){word}(?!\w)", text) or word in concealed(), word
        case _:
            pytest.fail(f"{name}: no test knows the command {command!r}")
    for file in files:
        assert list(ROOT.glob(file)), f"{name}: {file} does not exist"


def concealed() -> set[str]:
    """Names of the effects that a trial may conceal."""
    text = (ROOT / "tests/benchmarks/concealed").rglob("*.py")
    return {word for path in text for word in re.findall(r'"([a-z_]+)"', path.read_text(encoding="utf-8"))}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_files_that_are_named_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"`((?:tests|docs|geometry|materials|workbench|examples)/[\w./*]+)`", text)
    named += [link for link in re.findall(r"\]\(([\w./]+)\)", text) if "://" not in link]
    for name in named:
        assert list(ROOT.glob(name.rstrip("/"))), name


def test_every_benchmark_is_named() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in (ROOT / "docs").glob("*.md"))
    named = set(re.findall(r"benchmarks/(\w+\.py)", pages))
    assert {path.name for path in (ROOT / "tests" / "benchmarks").glob("*.py")} <= named


def test_every_page_of_validation_names_its_commands() -> None:
    text = (ROOT / "docs/validation.md").read_text(encoding="utf-8")
    for section in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        assert "```sh" in section, section.splitlines()[0]


def test_the_readme_is_short_and_begins_with_the_two_commands() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 150
    first = next(blocks("sh"))[1].splitlines()
    assert first == [
        "./setup && .venv/bin/workbench simulate geometry/chips/acevedo_2026_chip.toml -o out/paper_chip",
        "./setup && ./check"]
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", text):
        assert (ROOT / picture).stat().st_size < 150_000


def test_no_page_bears_the_traces_of_a_machine() -> None:
    named = ("CHANGELOG.md", "CITATION.cff", "CODE_OF_CONDUCT.md", "SECURITY.md", ".zenodo.json",
             ".pre-commit-config.yaml", "paper/paper.md", "paper/paper.bib")
    files = [*PAGES, *(ROOT / name for name in named), *(ROOT / "docs").glob("*.py"),
             *(ROOT / "examples").glob("*.*"), *(ROOT / ".github").rglob("*.*")]
    traces = re.compile(r"(?<![\w.~/$])/(work|home|root|tmp|Users|mnt)/\w|py(pi|thonhosted)\.org|conda\.anaconda\.org")
    for file in files:
        assert not traces.search(file.read_text(encoding="utf-8")), file


def test_the_files_of_a_release_name_one_version() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    (version,) = re.findall(r"^version: (.*)$", citation, re.MULTILINE)
    (date,) = re.findall(r"^date-released: (.*)$", citation, re.MULTILINE)
    newest = re.findall(r"^## (\d.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)[0]
    assert newest == f"{version} - {date}"
    assert version == wb.__version__
    title = re.findall(r"^title: (.*)$", citation, re.MULTILINE)
    assert title == [json.loads((ROOT / ".zenodo.json").read_text(encoding="utf-8"))["title"]]


def test_the_chip_file_that_is_printed_is_read(tmp_path: Path) -> None:
    path = tmp_path / "my_chip.toml"
    (text,) = (text for name, text in blocks("toml") if name.startswith("chip_file"))
    path.write_text(text, encoding="utf-8")
    assert [state.name for state in wb.read_chip(path).states] == ["empty", "filled"]


def test_hooks_are_local() -> None:
    text = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    assert re.findall(r"repo: (.*)", text) == ["local"]
    assert "://" not in text


def test_the_picture_of_packages_has_one_way(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, str(ROOT / "docs/architecture.py"), str(tmp_path / "architecture.png")],
                          capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "architecture.png").stat().st_size > 10_000


def docs_module(name: str) -> ModuleType:
    """A module of the documentation, which is no package."""
    specification = importlib.util.spec_from_file_location(f"docs_{name}", ROOT / f"docs/{name}.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[specification.name] = module
    specification.loader.exec_module(module)
    return module


def test_every_key_of_bench_and_campaign_is_explained() -> None:
    keys = docs_module("file_keys")
    for page, read in ((keys.bench_page(), keys.bench_keys()), (keys.campaign_page(), keys.campaign_keys())):
        for title, table in read.items():
            part = page.partition(f"### {title}\n")[2].partition("\n###")[0]
            for key in table:
                assert f"| `{key}` |" in part, (title, key)
    # What the page says comes from the reader: the fields of its classes, its units and its defaults.
    compensation = {field.name for field in dataclasses.fields(Standards)}
    assert keys.bench_keys()["`[compensation]`"].keys() == compensation >= {"open", "short", "load", "load_tolerance"}
    assert keys.bench_keys()["`[acquisition]`"].keys() == {field.name for field in dataclasses.fields(Acquisition)}
    assert keys.campaign_keys()["`[states.NAME]`"].keys() == set(STATE_KEYS)
    assert "| `step` | text with a unit: Hz, kHz, MHz, GHz | `500 Hz` |" in keys.bench_page()
    assert "| `known` | one of `stated`, `named` | `stated` |" in keys.campaign_page()


def test_a_key_that_nobody_explains_stops_the_page() -> None:
    keys = docs_module("file_keys")
    read = keys.bench_keys()
    read["`[limits]`"]["device_power"] = ("text", "")
    with pytest.raises(ValueError, match=r"disagree on the keys \['device_power'\] of `\[limits\]`"):
        keys.page(keys.BENCH, read)
    with pytest.raises(ValueError, match=r"disagree on the keys \['attempts'\] of `\[acquisition\]`"):
        keys.page(keys.BENCH, keys.bench_keys() | {"`[acquisition]`": {
            key: told for key, told in keys.bench_keys()["`[acquisition]`"].items() if key != "attempts"}})


def test_the_tables_of_the_pages_are_those_of_the_code() -> None:
    tables = docs_module("tables")
    found = []
    for path in sorted((ROOT / "docs").glob("*.md")):
        text = path.read_text(encoding="utf-8")
        assert tables.fresh(text) == text, f"{path.name} has an old table: run .venv/bin/python docs/tables.py"
        found += re.findall(r"<!-- (\w+): made by", text)
    assert sorted(found) == sorted(tables.TABLES)
    page = (ROOT / "docs/chip_file.md").read_text(encoding="utf-8")
    for key in ("cavity_radius", "live_inner_radius", "particle_radius", "z_min", "tolerance"):
        assert f"| `{key}` |" in page
    # An old table is found, and so is one without a name.
    assert tables.fresh(page.replace("| `z_min` |", "| `zmin` |")) == page
    with pytest.raises(ValueError, match=r"received a table .chip_key. that ends as .chip_keys.; expected one of "):
        tables.fresh(page.replace("<!-- chip_keys:", "<!-- chip_key:"))


def test_every_material_is_in_the_table() -> None:
    page = docs_module("material_table").page()
    for name in wb.Registry().names():
        assert f"| `{name}` |" in page
    assert "| 2329 | 8947 / 5342 | lossless | 150 / 695 / 2.59 |" in page


def test_what_a_rectangular_chip_costs_is_what_its_program_says(capsys: pytest.CaptureFixture[str]) -> None:
    text = (ROOT / "docs/rectangular_chip.md").read_text(encoding="utf-8")
    program = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)[0]
    exec(compile(program, "rectangular_chip", "exec"), {})
    assert f"```text\n{capsys.readouterr().out}```" in text


def test_the_header_shows_every_section_and_the_sections_every_page() -> None:
    # More than fit into the header, and the theme hides the rest under "More".
    def listed(page: Path) -> list[str]:
        found = re.findall(r"```{toctree}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
        return [line for block in found for line in block.splitlines() if line and not line.startswith(":")]

    sections = listed(ROOT / "docs/index.md")
    settings = (ROOT / "docs/conf.py").read_text(encoding="utf-8")
    (room,) = re.findall(r'"header_links_before_dropdown": (\d+)', settings)
    assert 0 < len(sections) <= int(room)
    pages = [page for section in sections for page in listed(ROOT / f"docs/{section}.md")]
    assert sorted([*pages, *sections, "index"]) == sorted(
        [*(page.stem for page in (ROOT / "docs").glob("*.md")), "gallery/index"])


def test_every_verdict_of_a_diagnosis_has_a_picture_on_its_page(tmp_path: Path) -> None:
    module = docs_module("verdict_pictures")
    page = (ROOT / "docs/diagnosis.md").read_text(encoding="utf-8")
    assert {case.verdict for case in module.CASES.values()} == set(VERDICTS)
    assert re.findall(r"_generated/verdict_(\w+)\.png", page) == list(module.CASES)
    # The cheapest of them; the build of the documentation draws all.
    (picture,) = module.pictures(tmp_path, ["parameters_explain"])
    assert picture.stat().st_size > 10_000
    with pytest.raises(ValueError, match=r"nothing: verdict 'no_mismatch'; expected 'ambiguous'"):
        module.diagnosed(dataclasses.replace(module.CASES["no_mismatch"], verdict="ambiguous"))


def test_the_algorithm_of_a_diagnosis_names_functions_of_the_code() -> None:
    text = (ROOT / "docs/diagnosis.md").read_text(encoding="utf-8").partition("### Algorithm")[2]
    code = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "workbench/diagnosis").glob("*.py")}
    called = set(re.findall(r"(\w+)\(", text.split("```")[1])) - {"map"}
    assert len(called) > 12
    for name in called:
        assert any(re.search(rf"def {name}\(", text) for text in code.values()), name
    rows = re.findall(r"^\| [^|`]+ \| (`[^|]+`) \| (`[^|]+`) \|$", text, re.MULTILINE)
    assert len(rows) > 7
    for names, modules in rows:
        whole = "".join(code[module] for module in re.findall(r"`([\w.]+)`", modules))
        for name in re.findall(r"`(?:\w+\.)?(\w+)`", names):
            assert re.search(rf"(?:def|class) {name}\b", whole), name


def test_the_figures_of_the_paper_are_those_of_the_validation() -> None:
    text = (ROOT / "paper/paper.md").read_text(encoding="utf-8")
    figures = re.findall(r"\d+\.\d+|\d+e-\d+|\d+ of \d+", text.partition("# Verification")[2].partition("# Limits")[0])
    assert len(figures) > 15
    validation = (ROOT / "docs/validation.md").read_text(encoding="utf-8")
    for figure in figures:
        assert re.search(rf"(?<![\d.]){re.escape(figure)}(?!\d)", validation), figure
    entries = (ROOT / "paper/paper.bib").read_text(encoding="utf-8")
    assert set(re.findall(r"@(\w+)", text)) == set(re.findall(r"^@\w+\{(\w+),", entries, re.MULTILINE))


def test_messages_on_the_page_of_problems_are_those_of_the_program() -> None:
    page = (ROOT / "docs/problems.md").read_text(encoding="utf-8")
    cells = re.findall(r"^\| (`[^|]+) \|", page, re.MULTILINE)
    assert len(cells) > 20
    texts = [(ROOT / "setup").read_text(encoding="utf-8")]
    for path in (each for package in ("workbench", "geometry", "materials") for each in (ROOT / package).rglob("*.py")):
        texts += ["".join(str(part.value) for part in (node.values if isinstance(node, ast.JoinedStr) else [node])
                          if isinstance(part, ast.Constant))
                  for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
                  if isinstance(node, ast.Constant | ast.JoinedStr)]
    whole = "\n".join(texts)
    for cell in cells:
        for words in re.findall(r"`([^`]+)`", cell):
            assert words in whole, words


@pytest.mark.slow
def test_the_documentation_is_built_without_a_warning_and_opens_offline(tmp_path: Path) -> None:
    # Examples are run by their own tests, and verdict pictures are drawn by one of this file.
    text_only = ["-D", "plot_gallery=0", "-D", "suppress_warnings=ref.python,image.not_readable"]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", *text_only, "docs",
         str(tmp_path / "html")],
        capture_output=True, text=True, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=900)
    assert done.returncode == 0, done.stderr[-4000:]
    for page in (tmp_path / "html").rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"<(?:script|link|img)[^>]*(?:src|href)=\"(?:https?:)?//", text), page.name
    api = (tmp_path / "html" / "api.html").read_text(encoding="utf-8")
    assert all(f'id="workbench.{name}"' in api for name in wb.PUBLIC)
    # The build writes a notebook of every example. Those of the pages A and B have the code that the tests run.
    for name in ("01_first_spectrum", "21_my_chip_my_recording"):
        cells = json.loads((ROOT / f"docs/gallery/{name}.ipynb").read_text(encoding="utf-8"))["cells"]
        code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
        example = ast.parse((ROOT / f"examples/{name}.py").read_text(encoding="utf-8"))
        assert ast.dump(ast.parse(code)) == ast.dump(ast.Module(example.body[1:], []))
        assert not any(cell.get("outputs") for cell in cells)
