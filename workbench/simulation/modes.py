"""The modes of a chip in one of its states.

Electrodes are short-circuited, so the frequencies are those of the poles of the admittance: the dips of |Z|. A whole
electrode drives the modes of order 0 alone; those of higher orders are seen where something is not round.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip
from geometry.measure import Straight
from geometry.names import CAVITY
from materials.registry import Registry
from workbench.acoustics.fields import nodal_components, section_nodes
from workbench.acoustics.nodal import NodalMesh
from workbench.fem.capacitance import clamped_capacitance
from workbench.fem.energy import by_place, energy_shares
from workbench.fem.modes import LEAST_Q, Eigenmodes, eigenmodes
from workbench.fem.operators import FullOperators, assemble
from workbench.fem.solve import System, one_thread
from workbench.files.errors import InputError
from workbench.jobs.progress import Progress, no_progress
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.model.numbers import plain_words
from workbench.model.problem import build, fill, registry_of
from workbench.physics.orders import ORDER, terms_of_order
from workbench.results.brief import Brief
from workbench.results.notebook import Shown, Summary
from workbench.simulation.solved_spectrum import band_of

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Least amplitude beside a zero, as a share of the largest: less is the shape of another mode.
SEEN = 0.05

#: Least coupling factor of a mode that the electrodes drive: of less, a peak of Q 1000 is 0.1 % of the admittance.
LEAST_COUPLING = 1e-3

#: Distance from the highest point of a region, as a share of its height, within which a node is on its upper face.
AT_FACE = 1e-6

#: Orders or wavelengths that are solved at the same time.
TOGETHER = 2

#: Regions that the words of a mode name, and the least share of its energy that they hold.
NAMED, LEAST_SHARE = 2, 0.1


@dataclass(frozen=True, eq=False, repr=False)
class ChipMode(Brief):
    """A mode with short-circuited electrodes, at ``frequency`` Hz with quality factor ``q``.

    ``order`` is the number of its waves around the axis; in a straight chip ``wavelength`` (m) is that along the
    channel, infinite for none. ``capacitance`` (F) is that of its branch in the equivalent circuit, and ``k_eff`` its
    effective coupling factor beside the clamped capacitance C_0, k^2 = C / (C_0 + C); both are 0 for a mode of another
    order or wavelength. ``energy`` and ``loss`` are shares by region, the largest first; losses at a contact count for
    its boundary. ``crossings`` counts zeros of the leading component along the upper face of the region of most energy:
    along the radius, or across the whole width of a section that ``is_straight``.
    ``shape`` (3, N) are u_r, u_z and u_s at the nodes of :attr:`ChipModes.nodes`, real, at the phase of the largest
    one, in units of it; NaN in fluids. ``pressure`` (N,) is that at the same phase, over its maximum; NaN in solids.
    """

    order: int
    wavelength: float
    frequency: float
    q: float
    capacitance: float
    k_eff: float
    energy: Mapping[str, float]
    loss: Mapping[str, float]
    crossings: int
    is_straight: bool
    shape: Real
    pressure: Real

    @property
    def liquid(self) -> float:
        """The share of the energy in the cavity."""
        return self.energy.get(CAVITY, 0.0)

    @property
    def words(self) -> str:
        """The mode in words, without its frequency."""
        leading = [f"{100.0 * share:.0f} % in the {plain_words(region)}" for region, share in self.energy.items()
                   if share >= LEAST_SHARE][:NAMED]
        way = "width" if self.is_straight else "radius"
        zeros = (f"{self.crossings} zero{'' if self.crossings == 1 else 's'} along the {way} of the "
                 f"{plain_words(next(iter(self.energy)))}")
        along = f"order {self.order}" if not self.is_straight else "uniform along the channel" if math.isinf(
            self.wavelength) else f"wavelength {1e3 * self.wavelength:.3g} mm"
        coupling = f"k_eff {self.k_eff:.3f}" if self.is_driven else "not driven by the electrodes"
        return ", ".join((along, zeros, *leading, coupling))

    @property
    def is_driven(self) -> bool:
        """Whether the electrodes drive the mode: its coupling is above :data:`LEAST_COUPLING`."""
        return self.k_eff > LEAST_COUPLING

    def __str__(self) -> str:
        return f"{self.frequency / 1e6:.6f} MHz, Q {self.q:.4g}: {self.words}"


@dataclass(frozen=True, eq=False, repr=False)
class ChipModes(Shown):
    """The modes of a chip's ``state`` in a ``band`` (Hz), by frequency.

    All have at least the quality factor ``least_q``. Their shapes are on ``nodes``.
    """

    chip: Chip
    state: str
    band: tuple[float, float]
    least_q: float
    modes: tuple[ChipMode, ...]
    nodes: NodalMesh

    def near(self, frequency: float) -> ChipMode | None:
        """The mode of a peak at a `frequency` (Hz).

        It is the driven mode of largest coupling whose width f / Q reaches to the frequency, or None.
        """
        close = [mode for mode in self.modes if mode.is_driven
                 and abs(mode.frequency - frequency) <= mode.frequency / mode.q]
        return max(close, key=lambda mode: mode.k_eff, default=None)

    def summary(self) -> Summary:
        """The modes, one a row."""
        return Summary(f"{self.chip.name}, {self.state}: modes", tuple(
            (f"{mode.frequency / 1e6:.6f} MHz", f"Q {mode.q:.4g}", mode.words) for mode in self.modes))


def modes(
    chip: Chip,
    state: str | None = None,
    *,
    orders: Sequence[int] = (0,),
    wavelengths: Sequence[float] = (),
    band: tuple[float, float] | None = None,
    least_q: float = LEAST_Q,
    accuracy: float | Discretisation = ACCURACY,
    registry: Registry | None = None,
    progress: Progress = no_progress,
) -> ChipModes:
    """The modes of a chip in one of its states.

    Parameters
    ----------
    state : name of the state; the last one of the file if not given.
    orders : numbers of waves around the axis of a round chip; 0 is the mode of a section.
    wavelengths : along a straight chip (m), beside the uniform modes.
    band : two frequencies (Hz); the chip's own if not given.
    least_q : smallest quality factor.
    accuracy : relative error of Z that the mesh is made for, or a discretisation.

    Raises
    ------
    InputError : a mistake in the chip, its materials or the arguments.
    ModelError : a term of the model has no other orders.
    NotConverged, ModesNotConverged : the model is singular in the band, or a mode still moves after the last round.
    """
    is_straight = isinstance(chip.measure, Straight)
    values = _checked(orders, wavelengths, is_straight)
    span = sought_band(chip, band, least_q, source="modes")
    device = fill(chip, state, registry_of(chip, registry))
    posed = build(device, band=span, accuracy=accuracy)
    nodal, dofs = section_nodes(posed.mesh)
    assembled: list[FullOperators] = []
    for number in values:
        terms = terms_of_order(posed.terms, is_first=not is_straight and number == 1.0) if number else posed.terms
        # All orders above the first have one model.
        assembled.append(next((each for each in assembled if each.terms == terms), None) or assemble(posed.mesh, terms))

    def solved(number: float, operators: FullOperators) -> list[ChipMode]:
        system = System(operators, {**posed.values, ORDER: number})
        found = eigenmodes(system, span, least_q=least_q)
        capacitances, clamped = np.zeros(found.omega.size), 1.0
        if number == 0.0:  # Modes of other orders are not driven.
            capacitances = _capacitances(system, found)
            clamped = clamped_capacitance(operators, system.values, 0.5 * sum(span))
        return described_modes(system, found, capacitances, clamped, nodal=nodal, dofs=dofs, number=number)

    found: list[ChipMode] = []
    progress("modes", 0.0)
    with one_thread(), ThreadPoolExecutor(TOGETHER) as pool:
        for k, some in enumerate(pool.map(solved, values, assembled)):
            progress("modes", (k + 1.0) / len(values))
            found += some
    return ChipModes(chip, device.state.name, span, least_q, tuple(sorted(found, key=lambda mode: mode.frequency)),
                 nodal)


def sought_band(
    chip: Chip, band: tuple[float, float] | None, least_q: float, *, source: str
) -> tuple[float, float]:
    """The band (Hz) in which modes are sought, by default the chip's.

    Raises
    ------
    InputError : from the `source`, a band that does not rise, or no quality factor.
    """
    if not isinstance(least_q, numbers.Real) or not 0.5 <= least_q < math.inf:
        raise InputError(source, "least_q", least_q, "a quality factor of a half or more")
    span = band_of(chip, band)
    if not 0.0 < span[0] < span[1] < math.inf:
        raise InputError(source, "band", span, "two rising frequencies (Hz)")
    return span


def _checked(orders: Sequence[int], wavelengths: Sequence[float], is_straight: bool) -> tuple[float, ...]:
    """The orders, or wave numbers (1/m), to solve."""
    for name, given in (("orders", orders), ("wavelengths", wavelengths)):
        if isinstance(given, str) or not isinstance(given, Sequence):
            raise InputError("modes", name, given, "a sequence of numbers, such as (0, 1, 2)")
    for order in orders:
        if isinstance(order, bool) or not isinstance(order, numbers.Real) or order != int(order) or order < 0:
            raise InputError("modes", "orders", order, "whole numbers of waves around the axis, 0 or more")
    if not orders and not wavelengths:
        raise InputError("modes", "orders", orders, "an order, or a wavelength along a straight chip")
    if is_straight and any(orders):
        raise InputError("modes", "orders", max(orders), "wavelengths along a straight chip, which has no axis")
    if wavelengths and not is_straight:
        raise InputError("modes", "wavelengths", wavelengths[0], "orders around the axis of a round chip")
    for length in wavelengths:
        if not isinstance(length, numbers.Real) or not 0.0 < length < math.inf:
            raise InputError("modes", "wavelengths", length, "lengths above zero (m)")
    return tuple(dict.fromkeys((*map(float, orders), *(2.0 * math.pi / length for length in wavelengths))))


def described_modes(
    system: System, found: Eigenmodes, capacitances: Real, clamped: float, *, nodal: NodalMesh,
    dofs: NDArray[np.int64], number: float = 0.0,
) -> list[ChipMode]:
    """The modes of one order with their energies and losses.

    The order is the `number`, a wave number (1/m) in a straight chip. `capacitances` (n,) in F are those of their
    branches, `clamped` (F) that of the electrodes. `nodal` and `dofs` are of
    `workbench.acoustics.fields.section_nodes`.
    """
    if not found.omega.size:
        return []
    operators, real = found.operators, found.omega.real
    coefficients = operators.coefficients(real, system.values)
    energy = energy_shares(operators, found.states, coefficients)
    loss = _loss_shares(operators, found.states, coefficients)
    couplings = np.sqrt(capacitances / (clamped + capacitances))
    is_straight = isinstance(nodal.measure, Straight)
    wavelength = 2.0 * math.pi / number if is_straight and number else math.inf
    components = nodal_components(operators, found.states, nodal, dofs)
    result = []
    for k, (frequency, q) in enumerate(zip(found.frequency, found.q, strict=True)):
        own = _ordered({region: float(each[k]) for region, each in energy.items()})
        fields = {name: values[:, k] for name, values in components.items()}
        lost = _ordered({place: float(each[k]) for place, each in loss.items()})
        result.append(ChipMode(0 if is_straight else round(number), wavelength, float(frequency), float(q),
                               float(capacitances[k]), float(couplings[k]), own, lost,
                               _crossings(fields, nodal, next(iter(own))), is_straight, *_shape(fields)))
    return result


def _ordered(shares: Mapping[str, float]) -> dict[str, float]:
    return dict(sorted(shares.items(), key=lambda both: -both[1]))


def _loss_shares(operators: FullOperators, states: Complex, coefficients: Complex) -> dict[str, Real]:
    """The share (n,) of each place in the loss of `states`."""
    forms = operators.quadratic(np.conj(states), states).real
    lost = by_place(operators.integrals, -coefficients.imag * forms)
    whole = sum(lost.values(), np.zeros(states.shape[1]))
    return {place: np.divide(each, whole, out=np.zeros(each.shape), where=whole > 0.0) for place, each in lost.items()}


def _capacitances(system: System, found: Eigenmodes) -> Real:
    """Capacitances C_n (n,) in F of the branches of modes.

    The charge at 1 V has the poles C_n w_n^2 / (w_n^2 - w^2) with C_n = (b^T x)^2 / w_n^2, b the electrode's column.
    """
    operators, omega = found.operators, found.omega
    electrode = np.zeros((operators.size, omega.size), dtype=complex)
    electrode[-1] = 1.0
    forms = operators.quadratic(electrode, found.states)
    return branch_capacitances((operators.coefficients(omega.real, system.values) * forms).sum(axis=1), omega)


def branch_capacitances(drives: Complex, omega: Complex) -> Real:
    """Capacitances (n,) in F of the branches of modes.

    `drives` (n,) are the charges of their states.
    """
    return np.maximum(((drives / omega) ** 2).real, 0.0)


def _shape(fields: Mapping[str, Complex]) -> tuple[Real, Real]:
    """Displacement (3, N) and pressure (N,), each over its maximum.

    Both are at the phase of the largest displacement.
    """
    moved = np.stack([fields[name] for name in ("u_r", "u_z", "u_s")])
    # Modes of order 0 do not move along the third direction.
    moved[2, np.isnan(moved[2]) & ~np.isnan(moved[0])] = 0.0
    largest = moved.ravel()[np.nanargmax(np.abs(moved))]
    pressure = (fields["p"] / largest).real
    highest = np.abs(pressure).max(where=np.isfinite(pressure), initial=0.0)
    return np.asarray((moved / largest).real), pressure / (highest or 1.0)


def _crossings(fields: Mapping[str, Complex], nodal: NodalMesh, region: str) -> int:
    """Number of zeros of the leading component on a region's upper face.

    They are along the radius, or across the whole width of a section that shows one half.
    """
    nodes = nodal.nodes_of([region])
    points = nodal.points[nodes]
    top = points[:, 1] >= points[:, 1].max() - AT_FACE * np.ptp(points[:, 1])
    nodes = nodes[top][np.argsort(points[top, 0])]
    lines = {name: values[nodes] for name, values in fields.items()
             if name != "phi" and np.isfinite(values[nodes]).all()}
    name, leading = max(lines.items(), key=lambda each: float(np.sum(np.abs(each[1]) ** 2)))
    # Losses leave a small part in quadrature.
    real = (leading * np.exp(-0.5j * np.angle(np.sum(leading**2)))).real
    seen = real[np.abs(real) > SEEN * np.abs(real).max()]
    count = int(np.sum(seen[1:] * seen[:-1] < 0.0))
    if not isinstance(nodal.measure, Straight) or not nodal.measure.mirror:
        return count
    # In the image, a displacement across has the other sign; an odd field is zero in the middle.
    is_odd = nodal.measure.mirror * (-1 if name == "u_r" else 1) < 0
    reaches = nodal.points[nodes[0], 0] <= nodal.points[:, 0].min() + AT_FACE * np.ptp(nodal.points[:, 0])
    return 2 * count + int(is_odd and reaches)
