"""A study of a chip from a file: variables, sample and figures.

    [study]
    chip = "chip.toml"              # path relative to the study's file
    states = ["empty", "filled"]    # or state = "filled"; the last one of the chip file if neither is given
    figures = ["f0", "e_ac", "trap_offset", "loss.couplant"]
    drive = "10 Vpp"                # as of the option --drive; 10 Vpp unless stated
    frequency = "energy"            # the drive follows the largest peak of the energy in the cavity; or "f0", or a
                                    # frequency; unless stated as in the chip file, or else "energy"
    band = ["0.95 MHz", "1.1 MHz"]  # where the resonance is looked for; that of the chip file unless stated
    relative_error = "0.1 %"        # of the reduced model's impedance
    accuracy = "0.05 %"             # of the mesh, as of the option --accuracy
    confirm = 5                     # points that are solved in full at the end

    [thermal]                       # K/W, for the figure "heating"; "all" stands for regions not named
    transducer = "4 K/W"            # or computed, see `workbench.design.thermal`
    all = "10 K/W"

    [sample]
    method = "sobol"                # or grid (unless stated otherwise), list, latin hypercube
    points = 10000
    seed = 1

    [vary]                          # see `workbench.design.axes`
    "substrate.thickness" = { from = "0.7 mm", to = "1.0 mm" }
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.chip import Chip, read_chip
from geometry.operating_point import parse_operating_point
from geometry.plausible import check_band
from materials.registry import Registry, user_registry
from workbench.design.axes import read_axes
from workbench.design.evaluation import Operation
from workbench.design.figures import check_figures
from workbench.design.thermal import read_thermal
from workbench.design.variables import MaterialChoice, Variable, VariedNumber
from workbench.files.errors import InputError, choose, expect
from workbench.files.names import check_title
from workbench.files.quantities import ProgramSource, frequency_text, in_another_unit
from workbench.files.tables import FileTable
from workbench.model.discretisation import ACCURACY, discretisation
from workbench.model.drive import Drive, read_drive
from workbench.reduced.ranges import LIMIT

Real = NDArray[np.float64]

#: Relative error of the reduced model's impedance unless stated otherwise, and points solved in full at the end.
RELATIVE_ERROR, CONFIRMED = 1e-3, 5

GRID, LIST, SOBOL, LATIN_HYPERCUBE = "grid", "list", "sobol", "latin hypercube"
METHODS = (GRID, LIST, SOBOL, LATIN_HYPERCUBE)

#: Most points of a study: a million take a day on two cores.
MOST = 1_000_000

_KEYS = ("name", "chip", "state", "states", "figures", "drive", "frequency", "band", "relative_error", "accuracy",
         "limit", "confirm")


@dataclass(frozen=True)
class Sampling:
    """The sampling ``method`` of a study, one of :data:`METHODS`.

    ``points`` and ``seed`` are those of a Sobol sequence or a Latin hypercube.
    """

    method: str = GRID
    points: int = 0
    seed: int = 0


@dataclass(frozen=True, init=False)
class Study:
    """A study of a chip with a checked description.

    ``axes`` are the variables, sampled by ``sampling`` in every one of ``states``. ``figures`` are by name. The
    resonance is searched within ``band`` (Hz). ``relative_error`` is that of the reduced model's impedance, made with
    at most ``limit`` full solves; ``accuracy`` is that of the mesh. ``confirmed`` points are solved in full at the end.
    Errors are reported under ``file``: the name of the file, or "Study".
    """

    name: str
    chip: Chip
    states: tuple[str, ...]
    figures: tuple[str, ...]
    axes: tuple[Variable, ...]
    sampling: Sampling
    operation: Operation
    band: tuple[float, float]
    relative_error: float
    accuracy: float
    limit: int
    confirmed: int
    registry: Registry
    file: str

    def __init__(
        self,
        chip: Chip,
        vary: Mapping[str, Any],
        *,
        figures: Sequence[str],
        name: str | None = None,
        state: str | None = None,
        states: Sequence[str] | None = None,
        sample: Mapping[str, Any] | None = None,
        drive: Drive | str = "10 Vpp",
        frequency: float | str | None = None,
        band: Sequence[float | str] | None = None,
        thermal: Mapping[str, Any] | None = None,
        relative_error: float | str | None = None,
        accuracy: float | str | None = None,
        limit: int = LIMIT,
        confirm: int = CONFIRMED,
        registry: Registry | None = None,
        source: str = ProgramSource("Study"),
    ) -> None:
        """Make a study of a chip from values of a study file.

        Numbers without units are SI. `vary`, `sample` and `thermal` are the tables of the file
        (:mod:`workbench.design.plan`). Materials come from the user's registry unless another is given.
        `relative_error` is 0.1 % and `accuracy` 0.05 % unless stated.

        Raises:
            InputError: the values do not describe a study.
        """
        expect(chip, Chip, reader="read_chip", source=source, field="chip")
        check_title(chip.name if name is None else name, source=source, field="study.name")
        table = FileTable.made(source, {
            "study": {"state": state, "states": states, "figures": figures, "drive": drive, "frequency": frequency,
                      "band": band, "relative_error": relative_error, "accuracy": accuracy, "limit": limit,
                      "confirm": confirm},
            "thermal": thermal, "sample": sample, "vary": vary})
        head = table.table("study")
        registry = replace(user_registry(), assumed_losses=True) if registry is None else registry
        chosen = _states(head, chip)
        wanted = check_figures(head.texts("figures", expected='names of figures, such as ["f0", "e_ac"]'),
                               chip.regions, source=source, field=head.at("figures"))
        if not wanted:
            raise head.error("figures", "one figure at least")
        within = band_key(head, chip) or chip.band
        thermal_resistance = read_thermal(table, chip, wanted, states=chosen, band=within, registry=registry)
        operation = Operation(read_drive(head), frequency_key(head, within), thermal_resistance)
        sampling = read_sampling(table.table("sample", expected="a table [sample]"))
        axes = read_axes(table.table("vary", expected="a table [vary]"), chip, chosen, registry, method=sampling.method)
        self.__dict__.update(
            name=chip.name if name is None else name, chip=chip, states=chosen, figures=wanted, axes=axes,
            sampling=sampling, operation=operation, band=within, accuracy=head.quantity("accuracy", "share", ACCURACY),
            relative_error=head.quantity("relative_error", "share", RELATIVE_ERROR), registry=registry, file=source,
            limit=head.whole("limit", low=1, high=100_000), confirmed=head.whole("confirm", low=0, high=1000))
        if not 0.0 < self.relative_error < 1.0:
            raise head.error("relative_error", 'a relative error between 0 and 1, such as "0.1 %"')
        try:
            discretisation(self.accuracy)
        except InputError as error:
            raise head.error("accuracy", error.expected) from None
        # Sample now, so that a mistake raises here and not at the first use of the points.
        _ = self.sample

    @cached_property
    def sample(self) -> Real:
        """The points (n, len(axes)) of one state, see :func:`sample_points`."""
        return sample_points(self.axes, self.sampling, source=self.file)

    @property
    def size(self) -> int:
        """The number of points in all states.

        Row ``s * n + i`` of the study's table is point i in state s.
        """
        return len(self.states) * len(self.sample)

    @property
    def numbers(self) -> tuple[VariedNumber, ...]:
        """The axes that are numbers."""
        return tuple(axis for axis in self.axes if isinstance(axis, VariedNumber))

    @property
    def choices(self) -> tuple[MaterialChoice, ...]:
        """The axes that are materials."""
        return tuple(axis for axis in self.axes if isinstance(axis, MaterialChoice))

    def columns(self, axes: Sequence[Variable]) -> Real:
        """The columns (n, len(axes)) of the sample for some axes."""
        return self.sample[:, [self.axes.index(axis) for axis in axes]]


def read_study(path: Path | str, *, materials: Sequence[Path | str] = (), inviscid: bool = False) -> Study:
    """Read and check a study's file and its chip.

    `materials` are further folders of materials. `inviscid` leaves out the boundary layers in cavities.

    Raises:
        InputError: a mistake in one of the files.
    """
    path = Path(path)
    table = FileTable.read(path).only(("study", "thermal", "sample", "vary"))
    table.required("study", "a table [study] with the chip and the figures")
    head = table.table("study", expected="a table [study]").only(_KEYS, renamed={"tolerance": "relative_error"})
    chip = read_chip(head.path("chip", path.parent, expected="the path of a chip file"))
    head.texts("figures", expected='names of figures, such as ["f0", "e_ac"]')
    table.required("vary", "a table [vary] of the variables")
    said = {key: value for key, value in head.content.items() if key not in ("chip", "name")}
    tables: dict[str, Any] = {key: table.content.get(key) for key in ("thermal", "sample")}
    registry = replace(user_registry(materials, inviscid=inviscid), assumed_losses=True)
    return Study(chip, table.content["vary"], name=head.content.get("name", path.stem), **said, **tables,
                 registry=registry, source=table.source)


def _states(head: FileTable, chip: Chip) -> tuple[str, ...]:
    known = [state.name for state in chip.states]
    if "state" in head and "states" in head:
        raise head.error("state", "state or states, not both")
    if "states" not in head:
        return (head.choice("state", known, known[-1]),)
    found = head.texts("states", expected=f"a list of states of the chip: {', '.join(known)}")
    if not found or len(set(found)) < len(found):
        raise head.error("states", "one state at least, every one once")
    for name in found:
        choose(name, known, source=head.source, field=head.at("states"))
    return found


def band_key(head: FileTable, chip: Chip) -> tuple[float, float] | None:
    """Read the key ``band`` (Hz) of a table, None if absent.

    Raises:
        InputError: not two frequencies, or a band in which no chip of this size resonates.
    """
    if "band" not in head:
        return None
    band = head.quantities("band", "frequency", numbered=True,
                           expected='two frequencies with their units, such as ["0.9 MHz", "1.1 MHz"]')
    if not 0.0 < band[0] < band[1]:
        raise head.error("band", "a lower and a higher frequency, both above zero")
    if "band" not in chip.unusual:
        check_band(chip.layers, band, head.source, head.at("band"))
    return band


def frequency_key(head: FileTable, band: tuple[float, float]) -> float | str | None:
    """Read the key ``frequency`` of a table.

    It is a frequency (Hz) within the `band`, a word of `geometry.operating_point.OPERATING_POINTS`, or None if absent.

    Raises:
        InputError: none of these.
    """
    stated = head.content.get("frequency")
    if stated is None:
        return None
    found = parse_operating_point(stated, source=head.source, field=head.at("frequency")) if isinstance(
        stated, str) else head.quantity("frequency", "frequency")
    if isinstance(found, float) and not band[0] <= found <= band[1]:
        raise head.error("frequency", f'"energy", "f0", or a frequency within the band, {frequency_text(*band)}',
                         in_another_unit(band, found))
    return found


def read_sampling(table: FileTable) -> Sampling:
    """Read the table [sample]; without a method it is a grid.

    Raises:
        InputError: an unknown method, or points of a grid or a list.
    """
    table.only(("method", "points", "seed"))
    method = table.choice("method", METHODS, GRID)
    seed = table.whole("seed", 0, low=0, high=2**32 - 1)
    if method in (GRID, LIST):
        if "points" in table:
            raise table.error("points", f"none: [vary] says how many points a {method} has")
        return Sampling(method, 0, seed)
    table.required("points", f"how many points a sample by {method!r} has")
    return Sampling(method, table.whole("points", low=1, high=MOST), seed)


def sample_points(axes: Sequence[Variable], sampling: Sampling, *, source: str) -> Real:
    """The points (n, len(axes)) of one state.

    Numbers are in SI, materials are indices in their list of alternatives. On a grid the last axis changes fastest. The
    first points of a Sobol sequence do not depend on its length.

    Raises:
        InputError: columns of a list with different lengths, or more than :data:`MOST` points.
    """
    if sampling.method == GRID:
        levels = [axis.levels() for axis in axes]
        count = math.prod(map(len, levels))
        if count > MOST:
            raise InputError(source, "vary", f"{count} points", f"a grid of at most {MOST} points, or a sample: "
                             '[sample] with method = "sobol" and points')
        return np.stack([each.ravel() for each in np.meshgrid(*levels, indexing="ij")], axis=1)
    if sampling.method == LIST:
        levels = [axis.levels() for axis in axes]
        for axis, each in zip(axes, levels, strict=True):
            if len(each) != len(levels[0]):
                what = "values" if isinstance(axis, VariedNumber) else "materials"
                raise InputError(source, f"vary.{axis.name}.{what}", f"{len(each)} of them",
                                 f"{len(levels[0])}, as many as {axes[0].name} has: a list is taken row by row")
        return np.stack(levels, axis=1)
    shares = _shares(len(axes), sampling)
    return np.stack([axis.at(column) for axis, column in zip(axes, shares.T, strict=True)], axis=1)


def _shares(count: int, sampling: Sampling) -> Real:
    """Points (n, count) spread over the unit cube."""
    from scipy.stats import qmc

    if sampling.method == LATIN_HYPERCUBE:
        return np.asarray(qmc.LatinHypercube(count, seed=sampling.seed).random(sampling.points))
    # A sequence is balanced if its length is a power of two. A part of it is its beginning.
    power = math.ceil(math.log2(sampling.points))
    return np.asarray(qmc.Sobol(count, seed=sampling.seed).random_base2(power)[: sampling.points])
