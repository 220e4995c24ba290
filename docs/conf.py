"""Settings of the documentation. It opens offline: no fonts and no scripts from elsewhere.

    .venv/bin/python -m sphinx -W --keep-going -b html docs out/docs

`-D plot_gallery=0` runs no example and no diagnosis: the text is checked in a fraction of the time, without their
pictures.
"""

from __future__ import annotations

import os
import sys
import tomllib
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT), str(HERE)]
# Gallery pages are made by running the examples; no window is needed for that.
os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import api  # noqa: E402
import architecture  # noqa: E402
import verdict_pictures  # noqa: E402

_PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = "Acoustofluidic chip workbench"
author = copyright = "the authors of the workbench"
version = release = _PROJECT["version"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_gallery.gen_gallery"]
exclude_patterns = ["_generated", "**/sg_execution_times.rst"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
# A file's name such as setup.py is no link.
myst_linkify_fuzzy_links = False

html_theme = "pydata_sphinx_theme"
html_title = project
html_theme_options: dict[str, Any] = {
    "icon_links": [], "navbar_end": ["theme-switcher"], "navbar_align": "left", "show_prev_next": True,
    "footer_start": [], "footer_end": [], "header_links_before_dropdown": 6, "use_edit_page_button": False,
}
# The four sections are in the header, the pages of one beside its text; the first page, which has no
# section, has no empty column.
html_sidebars = {"index": []}
html_show_sourcelink = False
html_show_sphinx = False

autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring, napoleon_numpy_docstring = True, False
# A type is named as the code names it; not every one has a page here.
suppress_warnings = ["ref.python"]

#: Examples that are run for their page; the diagnosis and those from 10 to 13, 16 to 18 and 20 are only shown.
QUICK = r"(?:0[12345689]|14|19|21)_\w+\.py"


sphinx_gallery_conf = {
    "examples_dirs": str(ROOT / "examples"), "gallery_dirs": "gallery", "filename_pattern": QUICK,
    "ignore_pattern": r"(^|/)(paper_chip|simulated_bench)\.py$",
    "image_scrapers": ("gallery_pictures.written",), "reset_modules": (),
    "within_subsection_order": "FileNameSortKey", "capture_repr": (), "show_signature": False,
    "download_all_examples": False, "min_reported_time": 1e9, "backreferences_dir": None,
    "remove_config_comments": True, "nested_sections": False, "write_computation_times": False,
}


def _generate(app: Any) -> None:
    # Pages of examples that have another name by now belong to no table of contents.
    for page in (HERE / "gallery").glob("[0-9]*"):
        if not (HERE.parent / "examples" / f"{page.name.split('.')[0]}.py").exists():
            page.unlink()
    made = HERE / "_generated"
    made.mkdir(exist_ok=True)
    (made / "api.rst").write_text(api.page(), encoding="utf-8")
    architecture.draw(made / "architecture.png")
    # A text, when it is given on the command line.
    if str(app.config.plot_gallery) in {"0", "False"}:
        return
    # A minute of diagnoses, made again only after a change of the program.
    modules = [Path(verdict_pictures.__file__), *(ROOT / "workbench").rglob("*.py")]
    changed = max(path.stat().st_mtime for path in modules)
    old = {path.stem for path in made.glob("verdict_*.png") if path.stat().st_mtime > changed}
    if missing := [name for name in verdict_pictures.CASES if f"verdict_{name}" not in old]:
        list(verdict_pictures.pictures(made, missing))


def _plain_bars(_app: object, _what: str, _name: str, _found: object, _options: object, lines: list[str]) -> None:
    """|Z| is a magnitude and no substitution."""
    for number, line in enumerate(lines):
        parts = line.split("``")
        parts[::2] = [part.replace("|", "\\|") for part in parts[::2]]
        lines[number] = "``".join(parts)


def setup(app: Any) -> None:
    app.connect("autodoc-process-docstring", _plain_bars)
    app.connect("builder-inited", _generate, priority=100)
