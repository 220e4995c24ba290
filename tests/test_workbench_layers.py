"""House rules that hold for every module: imports go one way, nothing heavy at import, no traces of a machine."""

from __future__ import annotations

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Callable, Collection, Iterable, Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("geometry", "materials", "workbench")
#: What each package may import of our own.
ALLOWED = {"files": {"files"}, "materials": {"files", "materials"}, "geometry": {"files", "geometry"},
           "workbench": {"files", "materials", "geometry", "workbench"}}
#: Seconds to load, or a window or a port needed: only inside the function that uses them.
HEAVY = {"cadquery", "OCP", "gmsh", "pyvista", "vtk", "vtkmodules", "matplotlib", "serial", "rich", "trame",
         "wslink", "aiohttp", "playwright"}


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {name_of(path): path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))}
#: The only modules that draw, print or end the program.
SURFACE = {"workbench.cli", "workbench.__main__", "workbench.jobs.interruption",
           *(name for name in FILES if name.startswith("workbench.commands"))}
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in FILES.items()}


def statements(
    body: list[ast.stmt], *, inside_functions: bool, for_checkers: bool = False
) -> Iterator[ast.Import | ast.ImportFrom]:
    """Import statements that run, on loading the module or (`inside_functions`) ever; those for type checkers too only
    if `for_checkers`."""
    for node in body:
        match node:
            case ast.Import() | ast.ImportFrom():
                yield node
            case ast.If(test=ast.Name(id="TYPE_CHECKING")):
                seen = [*node.body, *node.orelse] if for_checkers else node.orelse
                yield from statements(seen, inside_functions=inside_functions, for_checkers=for_checkers)
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                if inside_functions:
                    yield from statements(node.body, inside_functions=True, for_checkers=for_checkers)
            case _:
                children = [child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt)]
                handlers = [s for h in getattr(node, "handlers", []) for s in h.body]
                cases = [s for c in getattr(node, "cases", []) for s in c.body]
                yield from statements([*children, *handlers, *cases], inside_functions=inside_functions,
                                      for_checkers=for_checkers)


def layer_of(module: str) -> str:
    """The package of a module; what all packages stand on is a layer of its own."""
    return "files" if module.startswith("workbench.files") else module.split(".")[0]


def imported(module: str, *, inside_functions: bool, for_checkers: bool = False) -> set[str]:
    """Full names of the modules that a module imports, ours as far as they are modules."""
    found: set[str] = set()
    for node in statements(TREES[module].body, inside_functions=inside_functions, for_checkers=for_checkers):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        else:
            assert node.level == 0, f"{module} uses a relative import"
            assert node.module is not None
            below = {f"{node.module}.{alias.name}" for alias in node.names} & set(FILES)
            found |= below or {node.module}
    return found


def test_the_walk_sees_what_there_is_to_see() -> None:
    # Or the rules below hold of nothing.
    assert {"workbench.files.errors", "geometry.mesh", "materials.registry", "workbench.physics.term"} <= set(FILES)
    expected = {"geometry.section", "workbench.physics.fluid", "workbench.files.errors"}
    assert expected <= imported("workbench.model.problem", inside_functions=False)
    assert "gmsh" in imported("geometry.free_faces", inside_functions=True)
    assert "gmsh" not in imported("geometry.free_faces", inside_functions=False)


def offenders(offence: Callable[[str], Collection[str]], modules: Iterable[str] = FILES) -> dict[str, list[str]]:
    """The offences of every module that has any."""
    return {module: sorted(found) for module in modules if (found := offence(module))}


def test_imports_go_one_way() -> None:
    def backwards(module: str) -> set[str]:
        ours = {layer_of(name) for name in imported(module, inside_functions=True)} & set(ALLOWED)
        return ours - ALLOWED[layer_of(module)]

    assert not offenders(backwards)


def test_nothing_heavy_is_imported_at_module_level() -> None:
    assert not offenders(lambda module: HEAVY & {
        name.split(".")[0] for name in imported(module, inside_functions=False)})


def test_importing_every_module_loads_nothing_heavy() -> None:
    # Also what third parties would drag in.
    code = (f"import sys; sys.path.insert(0, {str(ROOT)!r}); import importlib; "
            f"[importlib.import_module(name) for name in {list(FILES)!r}]; "
            f"print(sorted({HEAVY!r} & {{name.split('.')[0] for name in sys.modules}}))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_imports_have_no_cycle() -> None:
    # Those inside functions and for type checkers counted: a cycle hidden there is still one. prepare() raises
    # CycleError and names it.
    graph = {module: imported(module, inside_functions=True, for_checkers=True) & set(FILES) - {module}
             for module in FILES}
    TopologicalSorter(graph).prepare()


def test_a_fit_needs_no_simulation_of_fields_and_particles() -> None:
    needed: set[str] = set()
    waiting = [name for name in FILES if name.startswith("workbench.fitting")]
    while waiting:
        new = imported(waiting.pop(), inside_functions=True) & set(FILES) - needed
        needed |= new
        waiting += new
    assert not needed & {"workbench.simulation.run", "workbench.acoustics.forces", "workbench.acoustics.traps",
                         "workbench.report.simulation"}


def test_one_effect_does_not_see_another() -> None:
    shared = {"workbench.physics.term", "workbench.physics.annulus", "workbench.physics.shaped",
              "workbench.files.quantities"}
    assert not offenders(lambda module: imported(module, inside_functions=True) & set(FILES) - shared,
                         [name for name in FILES if name.startswith("workbench.physics.")])


def test_only_commands_and_reports_draw() -> None:
    # A notebook shows a drawing that is made for it alone.
    drawing = ("workbench.render", "workbench.report", "workbench.results.notebook")
    assert not offenders(
        lambda module: [name for name in imported(module, inside_functions=True) if name.startswith(drawing[0])],
        [name for name in FILES if name not in SURFACE and not name.startswith(drawing)])


def test_a_library_neither_prints_nor_exits() -> None:
    def called(module: str) -> set[str]:
        names = {ast.unparse(node.func) for node in ast.walk(TREES[module]) if isinstance(node, ast.Call)}
        return names & {"print", "exit", "quit", "sys.exit", "os._exit"}

    assert not offenders(called, sorted(set(FILES) - SURFACE))


def test_modules_are_called_by_nouns() -> None:
    empty = {"utils", "util", "base", "helpers", "helper", "misc", "common"}
    assert not offenders(lambda module: empty & set(module.split(".")))


def public_definitions() -> dict[str, list[str]]:
    """The modules that define each public class or function."""
    found: dict[str, list[str]] = {}
    for module, tree in TREES.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
                found.setdefault(node.name, []).append(module)
    return found


def test_a_public_name_means_one_thing() -> None:
    assert not {name: modules for name, modules in public_definitions().items() if len(modules) > 1}


def test_the_workbench_holds_rooms_only() -> None:
    # A module that lies beside the rooms belongs to one of them.
    assert {path.name for path in (ROOT / "workbench").glob("*.py")} == {"__init__.py", "__main__.py", "cli.py"}


def test_test_folders_are_not_packages() -> None:
    # tests/geometry/__init__.py would hide the real geometry.
    assert not list((ROOT / "tests").rglob("__init__.py"))


#: A sentence that begins so names its subject late or never.
RIDDLE = re.compile(r"(?:^|[.:;!?]\s+|\n\s*\n\s*)(What|How|By what|As of|The same)\b")


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """The line and the text of every docstring of a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text is not None:
                yield node.body[0].lineno, text


def comment_blocks(text: str) -> Iterator[tuple[int, str]]:
    """The line and the text of every comment, with the lines that continue it."""
    found: list[tuple[int, int, str]] = []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            line, words = token.start[0], token.string.lstrip("#: ")
            if found and found[-1][1] == line - 1:
                found[-1] = found[-1][0], line, f"{found[-1][2]} {words}"
            else:
                found.append((line, line, words))
    return ((begin, words) for begin, _, words in found)


def test_a_sentence_names_its_subject_first() -> None:
    def riddles(module: str) -> list[str]:
        text = FILES[module].read_text(encoding="utf-8")
        return [f"line {line}: {words[:60]}" for line, words in (*docstrings(TREES[module]), *comment_blocks(text))
                if RIDDLE.search(words)]

    assert not offenders(riddles)


@pytest.mark.parametrize(
    "text", ["What is left.", "A copy. The same of others.", "One.\n\nHow it is done.", "As of x."])
def test_a_riddle_would_be_found(text: str) -> None:
    assert RIDDLE.search(text)


#: A path of one machine, a folder beside the checkout, a note that is not part of the project, a package index.
TRACES = (
    r"(?<![\w.~/$])/(work|home|root|tmp|Users|mnt)/\w",
    r"[A-Z]:\\",
    r"\.\./\w",
    r"\b(?!README|CHANGELOG|CONTRIBUTING|LICENSE)[A-Z]{5,}\.md\b",
    r"py(pi|thonhosted)\.org|conda\.anaconda\.org|npmjs\.",
)


def test_no_file_of_the_packages_bears_the_traces_of_a_machine() -> None:
    suffixes = {".py", ".toml", ".bib", ".html", ".md", ".txt"}
    files = [f for p in PACKAGES for f in (ROOT / p).rglob("*") if f.suffix in suffixes]
    assert len(files) > 50
    found = [f"{file.relative_to(ROOT)}: {line.strip()}" for file in files
             for line in file.read_text(encoding="utf-8").splitlines() if re.search("|".join(TRACES), line)]
    assert not found


@pytest.mark.parametrize(
    ("pattern", "line"),
    list(zip(TRACES, ("see /" + "home/someone/x", "C:" + "\\x", "open('..' '/" + "../data')", "see " + "NOTES" + ".md",
                 "https://" + "pypi" + ".org/x"), strict=True)),
)
def test_the_traces_would_be_found(pattern: str, line: str) -> None:
    assert re.search(pattern, line)
