"""A strip of ceramic in three dimensions: simply supported ends against the sum over wave numbers, and free ends.

A quarter of the strip is meshed by hexahedra with quadratic fields. Its conductance with both kinds of ends stands
beside that of `wb.finite_length`, which has the first kind. It takes a minute or two. The lines of the page on modes:

    .venv/bin/python tests/benchmarks/free_ends.py --low 0.52 --high 0.55 --points 31 --elements 4 16 2
    .venv/bin/python tests/benchmarks/free_ends.py --low 0.52 --high 0.55 --points 31 --length 24 --elements 3 24 2
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from skfem.helpers import ddot, dot, grad, sym_grad

import workbench as wb
from workbench.files.quantities import VACUUM_PERMITTIVITY
from workbench.model.problem import build, fill
from workbench.results.peaks import find_peaks

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Width, height and length (m) of the strip.
WIDTH, HEIGHT = 3e-3, 1e-3
STRIP = """
[chip]
name = "strip"
band = ["{low} MHz", "{high} MHz"]
unusual = ["band"]
geometry = "straight"
length = "{length} mm"
symmetry = "even"
[[layers]]
role = "transducer"
material = "pz26/ferroperm"
thickness = "1 mm"
width = "3 mm"
electrodes = {{ live = "top" }}
"""


class Strip:
    """A quarter of a strip in hexahedra; unknowns are displacements (x, y, z) and then the potential."""

    def __init__(self, values: dict[str, complex], length: float, elements: tuple[int, int, int]) -> None:
        lines = [np.linspace(0.0, end, count + 1) for end, count in zip((WIDTH / 2, length / 2, HEIGHT), elements,
                                                                        strict=True)]
        mesh = skfem.MeshHex.init_tensor(*lines)
        self.moved = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex2()), intorder=4)
        self.potential = skfem.Basis(mesh, skfem.ElementHex2(), intorder=4)
        self.length = length
        c = np.zeros((3, 3, 3, 3), dtype=complex)
        e = np.zeros((3, 3, 3), dtype=complex)
        for i in range(3):
            c[i, i, i, i] = values["c33" if i == 2 else "c11"]
            for j in range(i):
                c[i, i, j, j] = c[j, j, i, i] = values["c13" if i == 2 else "c12"]
                shear = values["c44"] if i == 2 else 0.5 * (values["c11"] - values["c12"])
                c[i, j, i, j] = c[j, i, j, i] = c[i, j, j, i] = c[j, i, i, j] = shear
            e[2, i, i] = values["e33" if i == 2 else "e31"]
        for i in range(2):
            e[i, i, 2] = e[i, 2, i] = values["e15"]
        permittivity = VACUUM_PERMITTIVITY * np.diag([values["eps11"], values["eps11"], values["eps33"]])

        @skfem.BilinearForm(dtype=np.complex128)
        def stiffness(u: Any, v: Any, _w: Any) -> Any:
            return ddot(np.einsum("ijkl,kl...->ij...", c, sym_grad(u)), sym_grad(v))

        @skfem.BilinearForm(dtype=np.complex128)
        def coupling(u: Any, q: Any, _w: Any) -> Any:
            return dot(np.einsum("ijk,jk...->i...", e, sym_grad(u)), grad(q))

        @skfem.BilinearForm(dtype=np.complex128)
        def dielectric(p: Any, q: Any, _w: Any) -> Any:
            return dot(np.einsum("ij,j...->i...", permittivity, grad(p)), grad(q))

        mass = skfem.BilinearForm(lambda u, v, _: dot(u, v))
        across = coupling.assemble(self.moved, self.potential)
        self.stiffness = sparse.bmat([[stiffness.assemble(self.moved), across.T],
                                      [across, -dielectric.assemble(self.potential)]]).tocsr()
        self.mass = sparse.block_diag([values["density"] * mass.assemble(self.moved),
                                       sparse.csr_matrix((self.potential.N, self.potential.N))]).tocsr()

    def charge(self, frequencies: Real, *, is_supported: bool) -> Complex:
        """The charge (n,) in C at 1 V of the whole strip."""
        places, nodes = self.moved.doflocs, self.potential.doflocs
        component = np.zeros(self.moved.N, dtype=int)
        for name, index in (("u^1", 0), ("u^2", 1), ("u^3", 2)):
            component[self.moved.get_dofs(elements=True).all([name])] = index
        near = 1e-9
        fixed = ((component == 0) & (places[0] < near)) | ((component == 1) & (places[1] < near))
        stated = (nodes[2] < near) | (nodes[2] > HEIGHT - near)
        if is_supported:
            fixed |= (component != 1) & (places[1] > 0.5 * self.length - near)
            stated |= nodes[1] > 0.5 * self.length - near
        state = np.concatenate([np.zeros(self.moved.N), nodes[2] / HEIGHT]).astype(complex)
        free = np.flatnonzero(~np.concatenate([fixed, stated]))
        result = []
        for omega in 2.0 * np.pi * frequencies:
            whole = (self.stiffness - omega**2 * self.mass).tocsc()
            x = np.where(np.isin(np.arange(state.size), free), 0.0, state)
            x[free] = splu(whole[free][:, free]).solve(-(whole @ x)[free])
            result.append(-4.0 * (x @ (whole @ x)))
        return np.array(result)


def main(low: float, high: float, length: float, points: int, elements: tuple[int, int, int]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "strip.toml"
        path.write_text(STRIP.format(low=low, high=high, length=length), encoding="utf-8")
        chip = wb.read_chip(path)
    summed = wb.finite_length(chip, points=points, accuracy=5e-3)
    posed = build(fill(chip))
    name = posed.materials["transducer"].name
    values = {key.removeprefix(f"{name}."): value for key, value in posed.values.items()}
    strip, frequencies = Strip(values, 1e-3 * length, elements), summed.frequency
    impedances = {"sum over wave numbers": summed.impedance, "without ends": summed.without_ends}
    for label, is_supported in (("3-D, simply supported", True), ("3-D, free", False)):
        charge = strip.charge(frequencies, is_supported=is_supported)
        impedances[label] = np.conj(1.0 / (-2j * np.pi * frequencies * charge))
    print(f"{len(summed.parts)} wave numbers, {strip.mass.shape[0]} unknowns in 3-D")
    for label, impedance in impedances.items():
        conductance = (1.0 / impedance).real
        peaks = find_peaks(np.log(conductance), 0.1)[0]
        rms = [100.0 * np.sqrt(np.mean(np.abs(np.log(impedance / impedances[other])) ** 2))
               for other in ("3-D, simply supported", "3-D, free")]
        shown = ", ".join(f"{frequencies[k] / 1e3:.1f} kHz {1e3 * conductance[k]:.3g} mS" for k in peaks)
        print(f"{label}: rms of ln Z to 3-D supported {rms[0]:.2f} %, to free {rms[1]:.2f} %; peaks {shown}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--low", type=float, default=0.40, help="MHz")
    parser.add_argument("--high", type=float, default=0.60, help="MHz")
    parser.add_argument("--length", type=float, default=12.0, help="mm")
    parser.add_argument("--points", type=int, default=41)
    parser.add_argument("--elements", type=int, nargs=3, default=[3, 10, 2])
    given = parser.parse_args()
    main(given.low, given.high, given.length, given.points, tuple(given.elements))
