"""What several test files need that is not a fixture: chip files, checks of what is written, terms of a test alone."""

from __future__ import annotations

import copy
import io
import json
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from rich.console import Console
from scipy.special import j0, j1

from geometry.chip import Chip, parse_chip
from geometry.dimension import Dimension
from geometry.mesh import SectionMesh
from geometry.profile import Corner, Outline, Profile
from geometry.section import cut_section
from materials.kinds import IsotropicSolid, Piezoelectric
from workbench.acoustics.nodal import NodalMesh, mesh_of
from workbench.commands.terminal import table_parts
from workbench.design.uncertainty import Uncertainty
from workbench.fem.operators import FullOperators, pair_of
from workbench.fem.solve import Solution
from workbench.fitting.parameter import Parameter
from workbench.model.discretisation import Discretisation
from workbench.model.numbers import Number
from workbench.model.particles import FluidProperties, Particle, compressibility, viscosity
from workbench.physics.term import Condition, Term
from workbench.report.page import TextTable


def layer_text(role: str, material: str, **lines: str) -> str:
    """A layer of a chip file. A value in brackets is written as it is, another one as text."""
    keys = {"role": role, "material": material, **lines}
    return "[[layers]]\n" + "".join(
        f"{key} = {value if value[0] in '{[' else json.dumps(value)}\n" for key, value in keys.items())


#: A transducer the size of a pea, as a chip file.
DISC = """
[chip]
name = "small disc"
band = ["300 kHz", "450 kHz"]
""" + layer_text("transducer", "pzt4/acevedo_2026_initial", density="7500 kg/m^3",
               thickness='{ value = "2 mm", tolerance = "10 um" }', radius="3 mm")
#: The same with a printed sample on it.
STACK = DISC.replace("small disc", "small stack") + "".join((
    layer_text("couplant", "coupling_gel", thickness="50 um", radius="3 mm"),
    layer_text("sample", "pla", thickness="1 mm", radius="3 mm"),
))
#: What turns a transducer into a chip with a cavity.
CAVITY_LAYERS = "".join((
    layer_text("substrate", "pla", thickness="0.85 mm", radius="3 mm"),
    layer_text("sidewall", "pla", thickness="0.72 mm", radius="3 mm", cavity_radius="1.5 mm"),
    layer_text("superstrate", "pmma", thickness="1 mm", radius="3 mm"),
))
#: Such a chip about the half wave of its cavity, with a particle in water.
CELL = DISC.replace("small disc", "small cell").replace('"300 kHz", "450 kHz"', '"0.9 MHz", "1.1 MHz"') + (
    CAVITY_LAYERS) + """
[states.filled]
cavity = "water"
temperature = "20 degC"
particle = "polystyrene"
particle_radius = "5 um"
"""


def chip_from(text: str, source: str = "chip.toml") -> Chip:
    """The chip of the text of a chip file."""
    return parse_chip(tomllib.loads(text), source=source)


def standard_json(path: Path) -> Any:
    """What a file holds, which may be no NaN or Infinity."""
    def refuse(text: str) -> None:
        raise AssertionError(f"{text} is not JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def visible(folder: Path) -> list[str]:
    """Names of the entries of a folder, hidden ones apart."""
    return sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))


def check_report(path: Path) -> str:
    """The text of a report that needs nothing but itself."""
    text = path.read_text()
    assert not re.search(r"(?:https?:)?//", re.sub(r"base64,[^\"]*", "", text))
    assert all(source.startswith("data:image/png;base64,") for source in re.findall(r'src="?([^" >]+)', text))
    assert "<script" not in text
    assert "<link" not in text
    return text


def quadratic(elements_per_wavelength: float) -> Discretisation:
    """Quadratic elements hardly graded: few unknowns, for statements that hold on any mesh."""
    return Discretisation(2, elements_per_wavelength, through_thickness=2, corner_refinement=0.5, growth=1.5,
                          transducer_finer=1.5, gas_finer=0.5)


@dataclass(frozen=True)
class Held(Term):
    """A component is zero on a boundary."""

    component: str
    boundary: str

    def conditions(self) -> tuple[Condition, ...]:
        return (Condition(self.component, self.boundary),)


def plate_below_a_layer(
    plate: Piezoelectric, thickness: float, layer: IsotropicSolid, depth: float, radius: float,
    frequency: NDArray[np.float64], stiffness: complex | NDArray[np.complex128],
) -> NDArray[np.complex128]:
    """Z (e^{-i w t}), (n,), of a plate that vibrates along z alone, below a layer of its own longitudinal modulus.

    `stiffness` is that modulus, one or at every frequency (n,) in Hz. u = A sin k z + B cos k z from the plate's
    middle; the layer, free above, pulls with c k_s tan(k_s d) u.
    """
    permittivity = plate.absolute_eps33
    h = plate.e33 / permittivity
    stiffened = plate.c33 + plate.e33**2 / permittivity
    found = []
    for omega, own in np.broadcast(2.0 * np.pi * frequency, stiffness):
        k, beyond = omega * np.sqrt(plate.density / stiffened), omega * np.sqrt(layer.density / own)
        pull = own * beyond * np.tan(beyond * depth)
        s, c = np.sin(0.5 * k * thickness), np.cos(0.5 * k * thickness)
        matrix = np.array([[stiffened * k * c - pull * s, -stiffened * k * s - pull * c],
                           [stiffened * k * c, stiffened * k * s]])
        a, _ = np.linalg.solve(matrix, [h, h])
        found.append((thickness / permittivity - 2.0 * h * a * s) / (-1j * omega * np.pi * radius**2))
    return np.array(found)


def forms_by_cell(operators: FullOperators, states: NDArray[np.complex128]) -> list[NDArray[np.complex128]]:
    """The forms states^T A_q states of every integral, cell by cell of its place: (cells, n) each."""
    pairs = dict(operators.pair_forms(states, states))
    return [np.asarray(sum(p.weight * pairs[i.domain][*pair_of(p), i.radial] for p in i.products))
            for i in operators.integrals]


def fluid_modes(
    operators: FullOperators, values: Mapping[str, complex], pressure: NDArray[np.int64], omega: float
) -> NDArray[np.complex128]:
    """w^2 of the modes of the water alone, on the rows `pressure`, with its walls as they are at `omega`."""
    g = operators.coefficients(np.array([omega]), values)[0]
    compressed = np.array([[name.rpartition(".")[2] for name in i.coefficient.parameters] == ["density", "sound_speed"]
                           for i in operators.integrals])
    blocks = []
    for constants in (np.where(compressed, 0.0, g), np.where(compressed, g, 0.0)):
        whole = operators.matrix(constants)
        blocks.append(np.asarray(whole[pressure][:, pressure].toarray()))
    return np.asarray(scipy.linalg.eigvals(blocks[0] * omega**2, -blocks[1]), dtype=np.complex128)


class Wire:
    """A simulated instrument without a terminal between, and the lines that were written to it."""

    name = "wire"

    def __init__(self, respond: Callable[[bytes], bytes]) -> None:
        self.respond = respond
        self.written: list[bytes] = []
        self.waiting = b""

    def write(self, data: bytes) -> None:
        self.written.append(data)
        self.waiting += self.respond(data.removesuffix(b"\n"))

    def read(self, timeout: float) -> bytes:
        data, self.waiting = self.waiting, b""
        return data

    def discard(self) -> None:
        self.waiting = b""

    def close(self) -> None:
        pass


#: What tables are drawn with.
_DRAWN = re.compile("[┏┳┓┡╇┩└┴┘━─┃│]")


def impedance_gradient(solution: Solution) -> NDArray[np.complex128]:
    """Derivatives dZ/dg_q (n, integrals) by every complex coefficient g_q, e^{-i w t}."""
    # Z = i / (w Q), dQ = -x^T A_q x dg.
    return np.asarray((1j / (solution.omega * solution.charge**2))[:, None] * solution.forms)


def independent(inputs: Sequence[Number]) -> Uncertainty:
    """Uncertain numbers that have nothing to do with each other."""
    return Uncertainty(tuple(inputs), np.eye(len(inputs)))


def table_lines(title: str, table: TextTable, *, width: int = 80) -> list[str]:
    """The lines of a table as it is printed on a terminal of that width."""
    console = Console(width=width, file=io.StringIO(), color_system=None)
    with console.capture() as shown:
        console.print(*table_parts(title, table, width=width), sep="\n")
    return shown.get().rstrip("\n").split("\n")


def check_table(lines: list[str], title: str, columns: tuple[str, ...], rows: tuple[tuple[str, ...], ...]) -> None:
    """No line of a printed table has more than 80 characters, no word of it is lost, and none is cut but at a joint."""
    shown = "\n".join(lines)
    assert max(map(len, lines)) <= 80, shown
    written = [title, *columns, *(cell for row in rows for cell in row)]
    words = {word for text in written for word in text.split()}
    allowed = set[str]()
    for word in words:
        pieces = re.split(r"(?<=[./])", word)
        allowed |= {"".join(pieces[i:j]) for i in range(len(pieces)) for j in range(i + 1, len(pieces) + 1)}
    # In a list of values a heading is followed by a colon.
    printed = [word for line in lines for word in _DRAWN.sub(" ", line).split()]
    for word in printed:
        assert word in allowed or word.removesuffix(":") in allowed, (word, shown)
    found, sought = ("".join("".join(texts).split()) for texts in (printed, written))
    for character in set(sought):
        assert found.count(character) >= sought.count(character), (character, shown)


@dataclass(frozen=True, kw_only=True)
class FluidState:
    """A fluid given by its numbers alone: density kg/m^3, sound speed m/s, shear viscosity Pa s."""

    density: float
    sound_speed: float
    shear_viscosity: float | None


def moved_onto(mesh: SectionMesh, chip: Chip) -> SectionMesh:
    """`mesh` moved onto a chip with the same regions between the same breaks: linear between two of them.

    The mesh checks names, areas and volumes itself.
    """
    section = cut_section(chip)
    r, z = mesh.mesh.p
    moved = np.stack([np.interp(r, mesh.section.r_breaks, section.r_breaks),
                      np.interp(z, mesh.section.z_breaks, section.z_breaks)])
    return replace(mesh, mesh=replace(mesh.mesh, doflocs=moved), section=section)


def started_at(parameter: Parameter, start: float) -> Parameter:
    """The same parameter with another start, moved into its bounds."""
    return replace(parameter, value=float(np.clip(start, parameter.low, parameter.high)))


def shape(chip: Chip, region: str, **sizes: float) -> Chip:
    """The chip with a layer that has a shape (`geometry.parts.SHAPES`)."""
    return replace(chip, layers=tuple(
        replace(layer, **{name: Dimension(size) for name, size in sizes.items()}) if layer.region == region else layer
        for layer in chip.layers))


def pot(chip: Chip, *, fillet: float) -> Chip:
    """The chip with substrate and sidewall in one piece, drawn as an outline, and a fillet (m) at the floor of its
    cavity."""
    floor, wall = chip.layer("substrate"), chip.layer("sidewall")
    ends = (("radius", 0.0), ("radius", "thickness"), ("cavity_radius", "thickness"))
    corners = (Corner((0.0, 0.0)), *map(Corner, ends), Corner(("cavity_radius", "floor"), "fillet"),
               Corner((0.0, "floor")))
    profile = Profile(Outline(corners), (("floor", floor.thickness), ("fillet", Dimension(fillet))))
    printed = replace(floor, thickness=Dimension(floor.thickness.value + wall.thickness.value),
                      cavity_radius=wall.cavity_radius, profile=profile)
    layers = [printed if layer is floor else layer for layer in chip.layers if layer is not wall]
    return replace(chip, layers=tuple(layers), ports=None)


def with_fields(value: Any, **changes: Any) -> Any:
    """A copy of a frozen value with other fields, none of them checked."""
    found = copy.copy(value)
    found.__dict__.update(changes)
    return found


def standing_wave(mesh: NodalMesh, fluid: FluidState, *, k_z: float, radial: float, p0: float) -> Any:
    """What particle_forces reads of a Fields: p = p0 J0(k_r r) cos(k_z z), with k_r = `radial`, on a mesh of fluid."""
    omega = math.hypot(k_z, radial) * fluid.sound_speed
    r, z = mesh.points.T
    slope = np.stack([-radial * j1(radial * r) * np.cos(k_z * z), -k_z * j0(radial * r) * np.sin(k_z * z)], axis=1)
    pressure = p0 * (j0(radial * r) * np.cos(k_z * z)).astype(complex)
    velocity = p0 * slope / (1j * omega * fluid.density)
    kinetic = fluid.density * (np.abs(velocity) ** 2).sum(axis=1) / 4
    return SimpleNamespace(
        mesh=mesh, frequency=omega / (2 * math.pi), voltage=2.5 + 0j, drive="test drive", pressure=pressure,
        velocity=velocity, energy_density=np.abs(pressure) ** 2 * compressibility(fluid) / 4 + kinetic)


def block_mesh(r_lines: Any, z_lines: Any, order: int) -> NodalMesh:
    """The nodes of a cavity of rectangular cells between lines (m) along r and z."""
    low, high = (np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1).reshape(-1, 2)
                 for r, z in ((r_lines[:-1], z_lines[:-1]), (r_lines[1:], z_lines[1:])))
    return mesh_of(low, high, np.zeros(len(low), int), ("cavity",), order=order)


def half_wave_focus_time(
    particle: Particle, fluid: FluidProperties, contrast_factor: float, *, energy_density: float, wavenumber: float,
    start: float, stop: float,
) -> float:
    """Time (s) in which an ideal half wave brings a particle from `start` to `stop`, m from the node of the pressure.

        t = 3 eta / (4 a^2 Phi k^2 E) ln[tan(k start) / tan(k stop)]

    (Bruus, Lab Chip 12, 1014, 2012.) `energy_density` J/m^3 is p0^2 / (4 rho c^2).
    """
    rate = 4.0 * particle.radius**2 * contrast_factor * wavenumber**2 * energy_density / (3.0 * viscosity(fluid))
    return math.log(math.tan(wavenumber * start) / math.tan(wavenumber * stop)) / rate
