"""Fixtures of all tests."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.console import RenderableType
    from scipy.sparse import csc_matrix

    from geometry.chip import Chip
    from geometry.mesh import SectionMesh
    from materials.kinds import Material, Piezoelectric
    from workbench.fem.operators import FullOperators
    from workbench.model.problem import Problem
    from workbench.results.spectrum import Spectrum

# One BLAS thread (see workbench.fem.solve.one_thread) and a window that needs no display, before numpy and vtk load.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

# Commands that tests interrupt inherit the signals that a shell in the background or nohup ignores.
for end, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(end) is signal.SIG_IGN:
        signal.signal(end, handler)

ROOT = Path(__file__).resolve().parent.parent
REFERENCE = Path(__file__).resolve().parent / "data" / "reference"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests first: with two processes, none of them is left over for one at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real recordings beside the checkout; tests that need one skip where it is absent."""
    folder = ROOT.parent / "shared"
    if not folder.is_dir():
        pytest.skip("the folder of real recordings is not beside this checkout")
    return folder


@pytest.fixture(autouse=True)
def files_are_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every run in a test writes only files that its command declares: a user's are refused before it begins."""
    from workbench.files.output import OutputFolder
    from workbench.files.ownership import matches

    real = OutputFolder.finish

    def finish(self: OutputFolder, *, complete: bool) -> None:
        undeclared = [name for name in self._written() if not matches(name, self.outputs.names)]
        real(self, complete=complete)
        assert not undeclared, f"workbench {self.outputs.command} wrote {undeclared}"

    monkeypatch.setattr(OutputFolder, "finish", finish)


@pytest.fixture
def kernel_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """STEP files are read by this process, which need not load the CAD kernel again for each."""
    from geometry import cad

    def answer_here(function: str, request: object, *, seconds: int) -> object:
        assert (function, seconds) == ("geometry.cad:step_answers", cad.STEP_SECONDS)
        return json.loads(json.dumps(cad.step_answers(json.loads(json.dumps(request)))))

    monkeypatch.setattr(cad, "answer_apart", answer_here)


@pytest.fixture
def tables_fit(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The titles of the tables printed, each of which is checked to fit 80 columns without the loss of a word."""
    from support import check_table, table_lines

    from workbench.commands import terminal
    from workbench.report.page import TextTable

    found: list[str] = []
    drawn = terminal.table_parts

    def checked(title: str, table: TextTable, *, width: int) -> list[RenderableType]:
        check_table(table_lines(title, table), title, table.columns, table.rows)
        found.append(title)
        return drawn(title, table, width=width)

    monkeypatch.setattr(terminal, "table_parts", checked)
    return found


# --------------------------------------------------------------------------------------------------------------------
# Models for the tests of the solver. Nothing of the packages is imported until a fixture asks for it.


def _stacked(layers: Sequence[tuple[str, float, float, float | None]], *, band: tuple[float, float]) -> Chip:
    """A chip from (role, thickness, radius, radius of the hole or None), bottom to top, in metres."""
    from geometry.chip import Chip, Dimension, Layer, State
    from geometry.names import region_names
    from geometry.parts import Electrodes, named_dimensions
    from geometry.plausible import range_of

    made: list[Layer] = []
    for region, (role, thickness, radius, hole) in zip(region_names(row[0] for row in layers), layers, strict=True):
        z = made[-1].z_top if made else 0.0
        cavity = None if hole is None else Dimension(hole)
        made.append(Layer(region, role, "of the test", Dimension(thickness), Dimension(radius), z, cavity))
    holes = any(layer.cavity_radius is not None for layer in made)
    # Closed forms are of plates and columns that no chip has.
    named = dict(named_dimensions(made, Electrodes(), None))
    unusual = [name for name, each in named.items() if (usual := range_of(name)) and each.value not in usual]
    return Chip("test", tuple(made), band, (State("default", cavity="of the test" if holes else None),),
                unusual=("band", *unusual))


def _reference_materials(name: str) -> dict[str, Material]:
    """What fills each region in a reference spectrum, from the numbers beside it (losses in e^{-i w t})."""
    from materials.kinds import Fluid, IsotropicSolid, Piezoelectric

    data = json.loads((REFERENCE / f"{name}.json").read_text(encoding="utf-8"))

    def number(value: float | list[float]) -> complex:
        return complex(*value) if isinstance(value, list) else complex(value)

    constants = ("C11", "C12", "C13", "C33", "C44", "e31", "e33", "e15", "eps11", "eps33")
    c11, c12, c13, c33, c44, e31, e33, e15, eps11, eps33 = (
        complex(data["pzt"][key], data["pzt"].get(f"{key}i", 0.0)) for key in constants)
    found: dict[str, Material] = {"transducer": Piezoelectric(
        name="pzt", density=data["pzt"]["rho"], c11=c11, c12=c12, c13=c13, c33=c33, c44=c44, e31=e31, e33=e33, e15=e15,
        eps11=eps11, eps33=eps33)}
    solids = {"base": ("substrate", "pla"), "wall": ("sidewall", "pla"), "epoxy": ("bond", "epoxy"),
              "glass": ("superstrate", "glass")}
    for key, numbers in data["solids"].items():
        region, material = solids[key]
        found[region] = IsotropicSolid(name=material, density=numbers["rho"], bulk_modulus=number(numbers["K"]),
                                       shear_modulus=number(numbers["G"]))
    fluids = {"gel": ("couplant", "gel"), "cav": ("cavity", "water")}
    for key, numbers in data["fluids"].items():
        region, material = fluids[key]
        found[region] = Fluid(name=material, density=numbers["rho"], sound_speed=numbers["c"])
    return found


def _reference_chip(name: str) -> Chip:
    """The geometry of a reference spectrum, which its file gives in words."""
    layers: list[tuple[str, float, float, float | None]] = [("transducer", 2.02e-3, 12.5e-3, None)]
    if not name.startswith("free_disc"):
        layers += [("couplant", 20e-6, 12.5e-3, None)]
    if name == "disc_gel_PLA":
        layers += [("substrate", 1e-3, 13e-3, None)]
    if name.startswith("chip"):
        layers += [("substrate", 0.85e-3, 13e-3, None), ("sidewall", 0.72e-3, 13e-3, 4e-3),
                   ("bond", 0.1e-3, 13e-3, 4e-3), ("superstrate", 1e-3, 13e-3, None)]
    return _stacked(layers, band=(910e3, 1155e3))


def _reference_spectrum(name: str) -> Spectrum:
    """The independent solver's spectrum; its sign is already the electrical engineer's."""
    import numpy as np

    from workbench.results.spectrum import Spectrum

    frequency, real, imaginary = np.loadtxt(REFERENCE / f"{name}.csv", delimiter=",", skiprows=1, unpack=True)
    return Spectrum(frequency, real + 1j * imaginary)


def _uniform_mesh(chip: Chip, edge: float, skins: Mapping[str, float] | None = None) -> SectionMesh:
    """The chip in elements of equal size, no longer than `edge` (metres), for orders of convergence."""
    from geometry.mesh import mesh_section
    from geometry.mesh_size import MeshSize
    from geometry.section import cut_section

    section = cut_section(chip)
    size = MeshSize(dict.fromkeys(section.regions, edge), 1.0, elements_per_wavelength=1.0, order=2, skins=skins or {})
    return mesh_section(section, size)


def _rows(operators: FullOperators, region: str, *components: str) -> NDArray[np.int64]:
    """The rows of the unknowns of a region in the system, the live electrode's not among them."""
    import numpy as np

    rows = np.concatenate([operators.numbering[c][operators.places[region].dofs].ravel() for c in components])
    return np.unique(rows[(rows >= 0) & (rows < operators.size - 1)])


def _pencil(operators: FullOperators, values: Mapping[str, complex]) -> dict[int, csc_matrix]:
    """The model as real matrices by their power of w: A(w) = sum of w**power times a matrix (losses left out)."""
    import numpy as np

    from workbench.physics.term import Monomial

    monomials = [integral.coefficient for integral in operators.integrals]
    powers = [int(c.omega_power) for c in monomials if isinstance(c, Monomial)]
    constants = [c.constant(values) for c in monomials if isinstance(c, Monomial)]
    assert len(powers) == len(monomials), "a coefficient that is no power of w"
    found = {}
    for power in sorted(set(powers)):
        found[power] = operators.matrix(np.where(np.array(powers) == power, constants, 0.0)).real.tocsc()
    return found


def _modes(operators: FullOperators, values: Mapping[str, complex], rows: NDArray[np.int64], *, near: float,
           count: int) -> NDArray[np.float64]:
    """The `count` eigenfrequencies (Hz) closest to `near` of the lossless model on `rows`, lowest first."""
    import numpy as np
    from scipy import sparse
    from scipy.sparse.linalg import eigsh

    blocks = [matrix[rows][:, rows] for matrix in _pencil(operators, values).values()]
    stiffness, mass = [block for block in blocks if abs(block).max() > 0.0]
    sigma = (2.0 * np.pi * near) ** 2
    # The matrices hold newtons and coulombs: brought to one size, as the solver does.
    scale = sparse.diags(1.0 / np.sqrt(np.abs((stiffness + sigma * mass).diagonal())))
    found = eigsh(scale @ stiffness @ scale, k=count, M=-(scale @ mass @ scale), sigma=sigma, return_eigenvectors=False)
    return np.sqrt(np.abs(np.sort(found))) / (2.0 * np.pi)


def _meshed(chip: Chip, materials: Mapping[str, Material], *, elements_per_wavelength: float, thickness: int = 2,
            corner_refinement: float = 1.0, skins: Mapping[str, float] | None = None) -> Problem:
    """The base model of a chip on quadratic elements, of a size that the top of its band rules."""
    from geometry.mesh import mesh_section
    from geometry.section import cut_section
    from workbench.model.discretisation import Discretisation
    from workbench.model.problem import problem

    section = cut_section(chip)
    made = Discretisation(2, elements_per_wavelength, thickness, corner_refinement=corner_refinement, growth=1.5,
                          transducer_finer=1.5, gas_finer=0.5, film_finer=0.65)
    size = made.mesh_size(section, materials, chip.band[1], skins=skins)
    return problem(mesh_section(section, size), materials, chip.band)


@pytest.fixture(scope="session")
def stacked() -> Callable[..., Chip]:
    """See :func:`_stacked`."""
    return _stacked


@pytest.fixture(scope="session")
def meshed() -> Callable[..., Problem]:
    """See :func:`_meshed`."""
    return _meshed


@pytest.fixture(scope="session")
def uniform_mesh() -> Callable[..., SectionMesh]:
    """See :func:`_uniform_mesh`."""
    return _uniform_mesh


@pytest.fixture(scope="session")
def rows() -> Callable[..., NDArray[np.int64]]:
    """See :func:`_rows`."""
    return _rows


@pytest.fixture(scope="session")
def pencil() -> Callable[..., dict[int, csc_matrix]]:
    """See :func:`_pencil`."""
    return _pencil


@pytest.fixture(scope="session")
def modes() -> Callable[..., NDArray[np.float64]]:
    """See :func:`_modes`."""
    return _modes


@pytest.fixture(scope="session")
def reference_materials() -> Callable[[str], dict[str, Material]]:
    """See :func:`_reference_materials`."""
    return _reference_materials


@pytest.fixture(scope="session")
def plain_ceramic() -> Piezoelectric:
    """The reference ceramic without c13, e31 and e15: u_z(z), phi(z) and u_r = 0 then solve a free disc exactly."""
    from dataclasses import replace

    from materials.kinds import Piezoelectric

    material = _reference_materials("free_disc_fitted_rho7500")["transducer"]
    assert isinstance(material, Piezoelectric)
    return replace(material, c13=0.0, e31=0.0, e15=0.0)


@pytest.fixture(scope="session")
def reference_chip() -> Callable[[str], Chip]:
    """See :func:`_reference_chip`."""
    return _reference_chip


@pytest.fixture(scope="session")
def reference_spectrum() -> Callable[[str], Spectrum]:
    """See :func:`_reference_spectrum`."""
    return _reference_spectrum


@pytest.fixture(scope="session")
def reference_figures() -> Callable[[str], dict[str, float]]:
    """f0, Z_min and Q as the independent solver printed them."""
    def read(name: str) -> dict[str, float]:
        return dict(json.loads((REFERENCE / f"{name}.json").read_text(encoding="utf-8"))["figures"])

    return read


@pytest.fixture(scope="session")
def small_disc() -> Problem:
    """A lossy transducer of 3 mm radius and 2 mm thickness, 500 unknowns, for statements that hold on any mesh."""
    chip = _stacked([("transducer", 2e-3, 3e-3, None)], band=(300e3, 700e3))
    return _meshed(chip, _reference_materials("free_disc_fitted_rho7500"), elements_per_wavelength=4.0)


@pytest.fixture(scope="session")
def small_chip() -> Chip:
    """All that the reference chip has (gel with a free rim, water between three solids) in the size of a pea."""
    return _stacked(
        [("transducer", 2e-3, 3e-3, None), ("couplant", 50e-6, 3e-3, None), ("substrate", 0.85e-3, 3.5e-3, None),
         ("sidewall", 0.72e-3, 3.5e-3, 1.5e-3), ("bond", 0.1e-3, 3.5e-3, 1.5e-3), ("superstrate", 1e-3, 3.5e-3, None)],
        band=(300e3, 400e3),
    )


@pytest.fixture(scope="session")
def filled_materials() -> dict[str, Material]:
    """The materials of the filled reference chip."""
    return _reference_materials("chip_filled")


@pytest.fixture(scope="session")
def filled(small_chip: Chip, filled_materials: dict[str, Material]) -> Problem:
    """The small chip with water in it: every term of the base model, losses in every solid but the glass."""
    return _meshed(small_chip, filled_materials, elements_per_wavelength=4.0)


@pytest.fixture(scope="session")
def filled_operators(filled: Problem) -> FullOperators:
    """The operators of `filled`."""
    from workbench.fem.operators import assemble

    return assemble(filled.mesh, filled.terms)
