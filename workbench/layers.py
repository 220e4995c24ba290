"""A problem whose layer thicknesses are parameters like its moduli (see `workbench.physics.layered`)."""

from __future__ import annotations

from dataclasses import replace

from geometry.chip import Chip
from geometry.names import LEVEL, PART
from geometry.stretch import split_by_layers
from workbench.physics.layered import Layered
from workbench.problem import Problem


def thickness(layer: str) -> str:
    """Name of the parameter that is the thickness of a layer of the stack."""
    return f"{layer}.thickness"


def layered(problem: Problem, chip: Chip) -> Problem:
    """`problem` with ``<layer>.thickness`` (m) of every layer of `chip` among its parameters.

    Spectra are those of a mesh stretched to the new thicknesses, to rounding; the mesh itself stays. Terms added
    afterwards do not follow a thickness: add them first. They may name parts of places (`geometry.names.part`).

    Raises:
        MeshError: the mesh is not of this chip.
    """
    mesh = split_by_layers(problem.mesh, chip)
    nominal = {layer.region: layer.thickness.value for layer in chip.layers}
    found: dict[str, list[tuple[str, str]]] = {}
    for places in (mesh.mesh.subdomains, mesh.mesh.boundaries):
        for name in places:
            place, part, layer = name.partition(PART)
            if part:
                found.setdefault(place, []).append((name, "" if layer == LEVEL else layer))
    # A place in one layer only is its own part, and so is a part.
    parts = {place: [(place, pieces[0][1])] if len(pieces) == 1 else pieces for place, pieces in found.items()}
    parts |= {piece[0]: [piece] for pieces in found.values() for piece in pieces}
    terms = []
    for term in problem.terms:
        places = tuple(dict.fromkeys(integral.place for integral in term.integrals()))
        layers = {layer for place in places for _, layer in parts[place]} - {""}
        terms.append(Layered(term, tuple((place, tuple(parts[place])) for place in places),
                             tuple((layer, nominal[layer]) for layer in sorted(layers))))
    values = {**problem.values, **{thickness(layer): complex(value) for layer, value in nominal.items()}}
    return replace(problem, mesh=mesh, terms=tuple(terms), values=values)
