"""One trial: a folder with a campaign as somebody at a bench would have it, and the truth, which is only returned."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from concealed.design import ABSOLUTE, RELATIVE, Design, draw, random_design
from concealed.device import EPOXY, GEL, GLASS, PIEZO_CONSTANTS, PLA, PZT, STATES, State, Values, body, seen
from concealed.mechanisms import CATALOGUED, MECHANISMS, NONE, OUTSIDE, Effect
from concealed.solver import Block, Body, Grid, Model, Reduced, assemble, grid, impedance, project, reduce
from numpy.typing import NDArray
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from workbench.spectrum import Origin, Spectrum, write_csv

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Order of the elements, and how far the reduced model may be off, relative to Z (noise is ten times that or more).
ORDER, TOLERANCE = 5, 3e-4

#: An imitation takes at most so many steps, until one changes less than this share of the square of what is left; the
#: first of them goes no further than so many uncertainties.
IMITATED, SETTLED, REACH = 8, 1e-2, 10.0

#: Step of the differences for tangents, in prior uncertainties: small, lest lines of the grid pass one another.
STEP = 1e-3


@dataclass(frozen=True)
class Truth:
    """What is hidden in a trial. ``detectability`` is that of all effects together, in standard deviations: the change
    of ln Z over the fitted states that no parameter within its prior can imitate. ``values`` are the true numbers."""

    seed: int
    mechanism: tuple[str, ...]
    effects: tuple[Effect, ...]
    detectability: float
    noise: float
    values: Mapping[str, float]

    def to_dict(self) -> dict[str, Any]:
        """As JSON would have it."""
        found = dataclasses.asdict(self)
        for effect in found["effects"]:
            del effect["values"], effect["defects"]
        return found


@dataclass(frozen=True, eq=False)
class Solved:
    """A body with its reduced model."""

    body: Body
    cells: Grid
    model: Model
    reduced: Reduced


class Device:
    """The solved states of a device; a body that was solved before is not solved again."""

    def __init__(self, design: Design) -> None:
        self.design = design
        self._solved: dict[Body, Solved] = {}
        self._basis: dict[int, Real] = {}

    def solved(self, values: Values, defects: Values, state: State) -> Solved:
        """The model of a state."""
        wanted = body(values, defects, state)
        if wanted not in self._solved:
            cells = grid(wanted, float(self.design.frequency[-1]))
            model = assemble(wanted, cells, order=ORDER)
            # Whatever has as many unknowns is the same section with other numbers.
            reduced = reduce(model, self.design.frequency, tolerance=TOLERANCE, known=self._basis.get(model.size))
            self._basis.setdefault(model.size, reduced.basis)
            self._solved[wanted] = Solved(wanted, cells, model, reduced)
        return self._solved[wanted]

    def spectrum(self, values: Values, defects: Values, state: State) -> Complex:
        """Impedance (n,) as the bench sees it without noise, e^{+j w t}."""
        own = np.conj(self.solved(values, defects, state).reduced.impedance(self.design.frequency))
        return seen(values, defects, state, self.design.frequency, own)

    def tangents(self, values: Values, defects: Values, state: State) -> Real:
        """(2 n, parameters) change of the real and imaginary part of ln Z by one prior standard uncertainty each."""
        base = self.solved(values, defects, state)
        frequency = self.design.frequency
        unmoved = base.reduced.impedance(frequency)

        def beside(name: str, shift: float) -> Complex:
            moved = {**values, name: values[name] + shift}
            other = body(moved, defects, state)
            own = unmoved if other == base.body else _impedance_beside(base, other, frequency)
            return seen(moved, defects, state, frequency, np.conj(own))

        columns = []
        for name, prior in self.design.prior.items():
            # To one side alone they would be off by a standard deviation, where an imitation is of thousands.
            change = np.log(beside(name, STEP * prior) / beside(name, -STEP * prior)) / (2.0 * STEP)
            columns.append(np.concatenate([change.real, change.imag]))
        return np.array(columns).T


def _impedance_beside(base: Solved, other: Body, frequency: Real) -> Complex:
    """Impedance of a body changed a little, on the basis of the one solved: exact to the second order in the change."""
    cells = grid(other, float(frequency[-1]), counts=base.cells.counts)
    renamed = dict(zip(base.cells.media, cells.media, strict=True))
    blocks = [(renamed.get(medium, medium), projected) for medium, projected in base.reduced.blocks]  # type: ignore[arg-type]
    if not (np.array_equal(cells.r, base.cells.r) and np.array_equal(cells.z, base.cells.z)):
        moved = assemble(other, cells, order=ORDER)
        blocks = [(medium, _moved(old, new, projected, base.reduced.basis)) for (medium, projected), old, new in
                  zip(blocks, base.model.blocks, moved.blocks, strict=True)]
    return impedance(blocks, frequency)


def _moved(old: Block, new: Block, projected: Mapping[str, Real], basis: Real) -> Mapping[str, Real]:
    """Projected matrices of a block some of whose cells have changed."""
    differs = np.zeros(old.unknowns.shape[0], dtype=bool)
    for name, matrix in old.matrices.items():
        # Rounding of the lines of the grid is no change.
        size = np.abs(matrix).max(axis=(1, 2))
        differs |= np.abs(new.matrices[name] - matrix).max(axis=(1, 2)) > 1e-9 * size
    if not differs.any():
        return projected
    part = Block(new.medium, new.unknowns[differs],
                 {name: matrix[differs] - old.matrices[name][differs] for name, matrix in new.matrices.items()})
    change = project(part, basis)
    return {name: matrix + change[name] for name, matrix in projected.items()}


def detectability(
    change: Callable[[Real], Real], tangents: Callable[[Real], Real], parameters: int, noise: float
) -> float:
    """Length (standard deviations) of what is left of a change of ln Z when `parameters` p with unit priors imitate it
    as well as they can: `change` (m,) is what is left of it where these have moved by their argument (p,), and
    `tangents` (m, p) their effects there. Never more than what a linear device would leave."""
    def slopes(moves: Real) -> Real:
        return np.concatenate([-tangents(moves) / noise, np.eye(parameters)])

    def lengths(moves: Real) -> Real:
        return np.concatenate([change(moves) / noise, moves])

    rest = np.zeros(parameters)
    whole, steep = lengths(rest), slopes(rest)
    linear = whole - steep @ np.linalg.lstsq(steep, whole)[0]
    imitated = least_squares(lengths, rest, lambda moves: slopes(moves) if moves.any() else steep, x_scale=REACH,
                             ftol=SETTLED, max_nfev=IMITATED)
    return min(float(np.linalg.norm(linear)), float(np.linalg.norm(imitated.fun)))


def make_trial(seed: int, mechanism: str | tuple[str, ...], folder: Path, *, points: int = 161) -> Truth:
    """Write the campaign of a random device with `mechanism` (a name of `MECHANISMS`, or several) hidden in it.

    Raises:
        ValueError: no such mechanism.
    """
    chosen = (mechanism,) if isinstance(mechanism, str) else tuple(mechanism)
    for name in chosen:
        if name not in MECHANISMS:
            raise ValueError(f"mechanism {name!r} is not one of {', '.join(MECHANISMS)}")
    # A seed is one device with one noise, whatever is hidden in it.
    of_device, of_effects, of_noise = (np.random.default_rng([seed, k]) for k in range(3))
    design = random_design(of_device, points=points)
    plain = draw(of_device, design)
    effects = tuple({**CATALOGUED, **OUTSIDE}[name](of_effects, design, plain) for name in chosen if name != NONE)
    with threadpool_limits(limits=1):
        device = Device(design)
        values, defects = _hidden(plain, effects)
        spectra = {state.name: device.spectrum(values, defects, state) for state in STATES}
        effects, total = _measured(device, plain, effects, spectra)
    _write(folder, design, spectra, of_noise)
    return Truth(seed, chosen, effects, total, design.noise, values)


def _hidden(plain: Values, effects: tuple[Effect, ...]) -> tuple[dict[str, float], dict[str, float]]:
    values, defects = dict(plain), dict[str, float]()
    for effect in effects:
        values |= effect.values
        for name, size in effect.defects.items():
            # Two effects may each bring in the same kind of loss.
            defects[name] = defects.get(name, 0.0) + size if name.endswith(".loss") else size
    return values, defects


def _measured(
    device: Device, plain: Values, effects: tuple[Effect, ...], spectra: Mapping[str, Complex]
) -> tuple[tuple[Effect, ...], float]:
    """The effects with their detectability, each beside the others, and that of all together."""
    if not effects:
        return (), 0.0
    fitted = [state for state in STATES if not state.held_out]
    noise = device.design.noise

    def against(others: tuple[Effect, ...]) -> float:
        values, defects = _hidden(plain, others)
        priors = device.design.prior

        def moved(moves: Real) -> Values:
            return {**values, **{name: values[name] + float(move) * prior
                                 for move, (name, prior) in zip(moves, priors.items(), strict=True)}}

        def change(moves: Real) -> Real:
            logs = [np.log(spectra[s.name] / device.spectrum(moved(moves), defects, s)) for s in fitted]
            return np.concatenate([part for log in logs for part in (log.real, log.imag)])

        def tangents(moves: Real) -> Real:
            # States that differ in the drive alone are one body for the tangents.
            found = {filling: device.tangents(moved(moves), defects, next(s for s in fitted if s.filling == filling))
                     for filling in dict.fromkeys(s.filling for s in fitted)}
            return np.concatenate([found[state.filling] for state in fitted])

        return detectability(change, tangents, len(priors), noise)

    def imitated(effect: Effect) -> float:
        # Tangents do not reach far. What only moves a known parameter is that parameter, at the price of its prior.
        design, changed = device.design, [*effect.values, *(f"{PZT}.{name}" for name in effect.defects)]
        shifts = [abs(effect.parameters[name] - design.nominal[name]) / design.prior[name]
                  for name in changed if name in design.prior]
        return math.sqrt(sum(shift**2 for shift in shifts)) if len(shifts) == len(changed) else math.inf

    total = against(())
    if len(effects) == 1:
        total = min(total, imitated(effects[0]))
        return (replace(effects[0], detectability=total),), total
    each = [min(against(tuple(o for o in effects if o is not e)), imitated(e)) for e in effects]
    return tuple(replace(e, detectability=d) for e, d in zip(effects, each, strict=True)), total


# --------------------------------------------------------------------------------------------------------------------
# Files


def _write(folder: Path, design: Design, spectra: Mapping[str, Complex], rng: np.random.Generator) -> None:
    (folder / "materials").mkdir(parents=True)
    for state in STATES:
        clean = spectra[state.name]
        sigma = design.noise * np.abs(clean)
        noisy = clean + sigma * (rng.standard_normal(clean.size) + 1j * rng.standard_normal(clean.size))
        write_csv(Spectrum(design.frequency, noisy, design.noise * np.abs(noisy), Origin("measured")),
                  folder / f"{state.name}.csv")
    nominal = design.nominal
    (folder / "materials" / "references.bib").write_text(
        "@misc{trial,\n  title = {Data sheets and measurements of the parts},\n}\n", encoding="utf-8")
    for name, kind, properties in _MATERIALS:
        path = folder / "materials" / f"{name}.toml"
        path.parent.mkdir()
        lines = [f'kind = "{kind}"', f'title = "{name.split("/")[0]} of the device"', 'source = "trial"',
                 'conditions = "room temperature"', ""]
        for key, unit in properties.items():
            loss = nominal.get(f"{name}.{key}.loss")
            lossy = "" if loss is None else f", loss = {loss!r}"
            lines.append(f'{key} = {{ value = {nominal[f"{name}.{key}"]!r}{lossy}, unit = "{unit}" }}')
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    for chip in ("disc", "chip"):
        (folder / f"{chip}.toml").write_text(_chip(design, chip), encoding="utf-8")
    (folder / "campaign.toml").write_text(_campaign(design), encoding="utf-8")


_MODULI = {"density": "kg/m^3", "bulk_modulus": "Pa", "shear_modulus": "Pa"}
_MATERIALS: tuple[tuple[str, str, Mapping[str, str]], ...] = (
    (PZT, "piezoelectric", {name: "kg/m^3" if name == "density" else "Pa" if name[0] == "c" else
                            "1" if name.startswith("eps") else "C/m^2" for name in PIEZO_CONSTANTS}),
    (PLA, "isotropic solid", _MODULI), (EPOXY, "isotropic solid", _MODULI), (GLASS, "isotropic solid", _MODULI),
    (GEL, "fluid", {"density": "kg/m^3", "sound_speed": "m/s"}),
)

#: Role, material, region whose radius it has, and whether the cavity passes through it.
_LAYERS = (
    ("transducer", PZT, "transducer", False), ("couplant", GEL, "couplant", False),
    ("substrate", PLA, "substrate", False), ("sidewall", PLA, "substrate", True), ("bond", EPOXY, "substrate", True),
    ("superstrate", GLASS, "substrate", False),
)


def _chip(design: Design, name: str) -> str:
    nominal = design.nominal
    low, high = 1e-3 * design.frequency[0], 1e-3 * design.frequency[-1]
    lines = ["[chip]", f'name = "{name}"', f'band = ["{low:.9g} kHz", "{high:.9g} kHz"]']
    for role, material, radius, hole in _LAYERS[: 1 if name == "disc" else None]:
        lines += ["", "[[layers]]", f'role = "{role}"', f'material = "{material}"',
                  f'thickness = {{ value = "{1e3 * nominal[f"{role}.thickness"]:.9g} mm" }}',
                  f'radius = {{ value = "{1e3 * nominal[f"{radius}.radius"]:.9g} mm" }}']
        if hole:
            lines.append(f'cavity_radius = {{ value = "{1e3 * nominal["cavity.radius"]:.9g} mm" }}')
        if role == "transducer":
            lines.append('electrodes = { live = "top" }')
    if name == "chip":
        lines += ["", "[states.empty]", 'cavity = "vacuum"']
        for temperature, state in ((25, "filled"), (35, "filled_again")):
            lines += ["", f"[states.{state}]", 'cavity = "water"', f'temperature = "{temperature} degC"']
    return "\n".join(lines) + "\n"


def _campaign(design: Design) -> str:
    lines = ["[campaign]", 'name = "device"', 'materials = "materials"']
    for state in STATES:
        chip, chosen = ("disc", "default") if state.filling == "disc" else (
            "chip", "filled_again" if state.held_out else state.filling)
        lines += ["", f"[states.{state.name}]", f'chip = "{chip}.toml"', f'state = "{chosen}"',
                  f'recording = "{state.name}.csv"', f'drive = "{state.drive:g} Vpp"',
                  f'temperature = "{state.temperature - 273.15:g} degC"']
        if state.held_out:
            lines.append("held_out = true")
    lines += ["", "[known]"]
    lines += [f'"{name}" = "{100.0 * share:g} %"' for name, share in RELATIVE.items()]
    lines += [f'"{name}" = "{size:g} {unit}"' for name, (size, unit) in ABSOLUTE.items()]
    return "\n".join(lines) + "\n"
