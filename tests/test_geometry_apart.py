"""STEP files are read in a process of its own: its answer is the same as before, and its failure is one line."""

from __future__ import annotations

import os
import shutil
import signal
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from geometry import apart
from geometry.apart import NoAnswer, answer_apart
from geometry.chip import read_chip
from workbench.files.errors import InputError

cadquery = pytest.importorskip("cadquery")

CHIP = """
[chip]
name = "a cone"
band = ["0.8 MHz", "1.2 MHz"]
[[layers]]
role = "transducer"
material = "pzt4/acevedo_2026_fitted"
profile = { step = "chip.step", part = "disc" }
[[layers]]
role = "substrate"
material = "pla"
profile = { step = "chip.step", part = "cone" }
"""


@pytest.mark.parametrize(("function", "request_", "how"), [
    ("ctypes:string_at", 0, f"signal {int(signal.SIGSEGV)}"), ("time:sleep", 60, "no answer within 1 s"),
    ("sys:exit", 3, "status 3"), ("math:sqrt", -1, "ValueError: math domain error"),
    ("no_such_module:name", None, "ModuleNotFoundError: No module named 'no_such_module'"),
])
def test_a_process_that_gives_no_answer_says_how_it_ended(function: str, request_: Any, how: str) -> None:
    with pytest.raises(NoAnswer, match=how):
        answer_apart(function, request_, seconds=1 if "sleep" in function else 60)


def test_an_answer_is_json_and_prints_do_not_disturb_it() -> None:
    assert answer_apart("math:sqrt", 2, seconds=60) == 2**0.5
    assert answer_apart("os:system", "echo chatter", seconds=60) == 0
    # Ctrl-C in the terminal is for this process alone, which then ends the other.
    assert answer_apart("os:getsid", 0, seconds=60) != os.getsid(0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A chip of two parts of a STEP file, one of them with a fillet and a cone."""
    there = tmp_path_factory.mktemp("step")
    disc = cadquery.Workplane().circle(10).extrude(2)
    cone = cadquery.Workplane().workplane(offset=2).circle(10).extrude(1.5, taper=7).faces(">Z").edges().fillet(0.2)
    cadquery.Assembly(name="chip").add(disc, name="disc").add(cone, name="cone").export(str(there / "chip.step"))
    (there / "chip.toml").write_text(CHIP, encoding="utf-8")
    return there


def test_the_section_is_the_same_to_the_last_bit_and_read_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from geometry import cad
    from geometry.chip_section import chip_section
    from geometry.profile import step_profiles
    from geometry.step_file import step_part

    begun = []

    def counted(*args: Any, **asked: Any) -> Any:
        begun.append(args)
        return answer_apart(*args, **asked)

    monkeypatch.setattr(cad, "answer_apart", counted)
    chip = read_chip(folder / "chip.toml")
    assert chip_section(chip).regions == ("transducer", "substrate")
    read_chip(folder / "chip.toml")
    assert len(begun) == 1
    for profile, drawn in cad.step_sections(step_profiles(layer.profile for layer in chip.layers)).items():
        where = profile.source
        here = cad._section(step_part(where.path, where.scale, where.content, where.part), profile.asymmetry,
                            profile.placement, str(where.path), where.part)
        curves = [[cad.curve_of(edge) for edges in cad.directed_edges(each.face) for edge in edges]
                  for each in (drawn, here)]
        assert curves[0] == curves[1]
        assert drawn.left_out == here.left_out


@pytest.mark.parametrize(("instead", "how"), [
    (("ctypes:string_at", 0, 60), "signal 11"), (("time:sleep", 60, 1), "no answer within 1 s"),
    (("math:sqrt", -1, 60), "ValueError: math domain error")])
def test_a_file_that_the_kernel_fails_on_is_named(
    instead: tuple[str, Any, int], how: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from geometry import cad

    shutil.copytree(folder, tmp_path / "copy")
    failing = partial(answer_apart, *instead[:2], seconds=instead[2])
    monkeypatch.setattr(cad, "answer_apart", lambda *_args, **_asked: failing())
    with pytest.raises(InputError, match=rf"chip\.step: STEP file: received 'a file that the CAD kernel failed on "
                                         rf"\({how}\)'; expected .*export it anew"):
        read_chip(tmp_path / "copy" / "chip.toml")


def test_mistakes_in_a_file_are_told_as_before(folder: Path) -> None:
    path = folder / "wrong.toml"
    path.write_text(CHIP.replace('part = "cone"', 'part = "cona"'), encoding="utf-8")
    with pytest.raises(InputError, match=r"chip\.step: part: received 'cona'; .*mean 'cone'") as caught:
        read_chip(path)
    assert caught.value.nearest == ("cone",)


def test_a_damaged_file_that_crashed_the_kernel(shared: Path, tmp_path: Path) -> None:
    case = shared / "cases" / "turn4" / "step-damaged-crash"
    if not case.is_dir():
        pytest.skip("the damaged file is not in the folder of recordings")
    for name in ("chip.toml", "damaged.step"):
        (tmp_path / name).write_bytes((case / name).read_bytes())
    with pytest.raises(InputError, match=r"damaged\.step: STEP file: .*export it anew"):
        read_chip(tmp_path / "chip.toml")


def test_the_process_is_ended_when_this_one_is_interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    begun = []

    class Begun(apart.subprocess.Popen):  # type: ignore[type-arg,misc]
        def communicate(self, *args: Any, **asked: Any) -> Any:
            begun.append(self.pid)
            raise KeyboardInterrupt

    monkeypatch.setattr(apart.subprocess, "Popen", Begun)
    with pytest.raises(KeyboardInterrupt):
        answer_apart("time:sleep", 60, seconds=60)
    with pytest.raises(ProcessLookupError):
        os.kill(begun[0], 0)
