"""A chip: layers from bottom to top, a cavity, and states.

:func:`read_chip` reads a TOML file. Every length has a unit. Every mistake raises an `InputError` with the file, the
field, the value and the remedy. Materials are only names here.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from geometry import checks, plausible
from geometry.chip_tables import read_band, read_layers, read_ports, read_states, read_text, read_well
from geometry.dimension import Dimension, millimetres
from geometry.features import Feature, check_features, read_features
from geometry.measure import ABOUT_AXIS, Measure
from geometry.names import CAVITY, TRANSDUCER
from geometry.operating_point import check_operating_point, read_operating_point
from geometry.parts import (
    ElectrodeDisc,
    Electrodes,
    Layer,
    Ports,
    State,
    discs,
    further_cavities,
    hole_names,
    named_dimensions,
    port_axis,
    stacked,
)
from geometry.straight import check_straight, read_measure
from workbench.files.errors import InputError, choose, nearest_files
from workbench.files.tables import FileTable, read_toml


@dataclass(frozen=True)
class Chip:
    """A chip whose description has been checked.

    ``layers`` run from bottom to top, ``band`` is the intended frequency range (Hz), ``states`` are in the order of the
    file, ``source`` is the origin of the description and ``file`` the name in error messages. ``unusual`` lists names
    whose values are intended although they look like a slip (`geometry.plausible`). ``measure`` is that of the section:
    about an axis, or straight, where radii are half widths. A cavity that ``is_open`` is a well with a free surface.
    ``operating_point`` is the drive frequency (Hz) or a word for it (`geometry.operating_point`). ``features`` are
    parts beside the axis of a round chip. ``material_folders`` contain the user's own materials.

    Raises:
        InputError: the layers do not make a chip (`geometry.checks`), read from a file or made in code.
    """

    name: str
    layers: tuple[Layer, ...]
    band: tuple[float, float]
    states: tuple[State, ...] = (State("default"),)
    electrodes: Electrodes = field(default_factory=Electrodes)
    ports: Ports | None = None
    description: str = ""
    source: str = ""
    file: str = "chip"
    unusual: tuple[str, ...] = ()
    measure: Measure = ABOUT_AXIS
    is_open: bool = False
    operating_point: float | str | None = None
    features: tuple[Feature, ...] = ()
    material_folders: tuple[Path, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        with checks.naming_layers([layer.region for layer in self.layers]):
            self._check()

    def _check(self) -> None:
        checks.check_names(self.name, self.layers, self.states, self.file)
        check_straight(self.measure, self.layers, self.electrodes, self.ports, self.file)
        checks.check_dimensions(self.layers, self.band, self.dimensions(), self.file, self.measure)
        checks.check_cavity(self.layers, self.file, self.measure, is_open=self.is_open)
        checks.check_shapes(self.layers, self.file)
        checks.check_stack(self.layers, self.file, self.measure)
        checks.check_electrodes(self.electrodes, self.transducer.inner_radius, self.transducer.outer_radius, self.file,
                                self.measure)
        checks.check_shared_electrodes(self.layers, self.electrodes, self.file)
        checks.check_ports(self.ports, self.holes, self.file)
        checks.check_states(self.states, self.layers, self.file, self.measure)
        check_operating_point(self.operating_point, self.band, self.file)
        check_features(self.features, self.layers, self.electrodes, self.measure, self.file)
        checks.check_taper(self.layers, self.features, self.measure, self.file)
        plausible.check_plausible(self.layers, self.band, self.dimensions(), self.states, self.unusual, self.file,
                                  measure=self.measure, is_open=self.is_open, features=self.features)

    @cached_property
    def holes(self) -> tuple[Layer, ...]:
        """The layers with a hole, bottom to top; empty without a cavity."""
        return tuple(layer for layer in self.layers if layer.cavity_radius is not None)

    @property
    def not_round(self) -> tuple[str, ...]:
        """The features and the taper in words."""
        taper = self.transducer.taper
        return (*map(str, self.features), *([f"taper of {millimetres(taper)} of {TRANSDUCER}"] if taper else []))

    @property
    def regions(self) -> tuple[str, ...]:
        """Names of the layers from bottom to top, then of the cavities."""
        return (*(layer.region for layer in self.layers), *((CAVITY,) if self.holes else ()), *self.further_cavities)

    @cached_property
    def further_cavities(self) -> dict[str, tuple[Layer, ...]]:
        """The layers around each further cavity, bottom to top, by its region."""
        return further_cavities(self.layers)

    @property
    def transducer(self) -> Layer:
        """The piezoelectric layer, the lowest of several."""
        return self.layer(TRANSDUCER)

    @property
    def is_shaped(self) -> bool:
        """Whether a layer is not a plain disc or ring."""
        return self.is_profiled or any(layer.shapes for layer in self.layers)

    @property
    def is_profiled(self) -> bool:
        """Whether a layer has an outline that is not a rectangle (`geometry.profile`)."""
        return any(layer.profile is not None for layer in self.layers)

    def layer(self, region: str) -> Layer:
        """The layer of that region.

        Raises:
            InputError: no layer of that name (the cavity is a region but not a layer).
        """
        layers = {layer.region: layer for layer in self.layers}
        return layers[choose(region, layers, source=self.file, field="region")]

    def state(self, name: str | None = None) -> State:
        """The state of that name, by default the last one.

        Raises:
            InputError: the chip has no such state.
        """
        if name is None:
            return self.states[-1]
        states = {state.name: state for state in self.states}
        return states[choose(name, states, source=self.file, field="state")]

    def port_axis(self) -> tuple[Layer, float]:
        """The layer around the ports, and the height (m) of their axes.

        Raises:
            InputError: the chip has no ports, or their height is outside the cavity.
        """
        return port_axis(self.ports, self.holes, file=self.file)

    def materials(self, state: str) -> dict[str, str]:
        """Material name of every region in a state. An empty cavity has ``"vacuum"``.

        Raises:
            InputError: the chip has no such state.
        """
        chosen = self.state(state)
        names = {layer.region: layer.material for layer in self.layers}
        if chosen.cavity is not None:
            names[CAVITY] = chosen.cavity
        names |= {region: str(around[0].filling) for region, around in self.further_cavities.items()}
        return names | dict(chosen.materials)

    def dimensions(self) -> dict[str, Dimension]:
        """Every length that can be changed, by name, in layer order.

        The names are ``<region>.thickness``, ``<region>.radius`` and ``<region>.inner_radius`` of a ring;
        ``cavity.radius`` if all holes have one width, otherwise ``<region>.cavity_radius``; ``electrode_live.radius``
        and ``electrode_live.inner_radius``, and those of the ground electrode, unless they cover the face;
        ``ports.diameter`` and ``ports.height`` if given. A straight chip has ``half_width`` for ``radius``.
        """
        return dict(named_dimensions(self.layers, self.electrodes, self.ports, self.measure.across))

    def with_dimensions(self, values: Mapping[str, float], *, unusual: Collection[str] = ()) -> Chip:
        """A copy with other lengths (m), by the names of :meth:`dimensions`.

        Layers above move along. A changed length loses its tolerance. A length outside the usual range is rejected
        unless its name is in `unusual`; a small move out of the range makes it unusual.

        Raises:
            InputError: unknown name, a length outside the usual range, or the new lengths do not make a chip.
        """
        known = self.dimensions()
        beyond = [name for name, value in values.items()
                  if name in known and plausible.moved_beyond(name, known[name].value, value)]
        return self._changed({name: partial(_resized, value=float(value)) for name, value in values.items()},
                             unusual=(*unusual, *beyond))

    def with_tolerances(self, tolerances: Mapping[str, float | None]) -> Chip:
        """A copy with other tolerances (m or rad), by dimension name.

        None removes a tolerance.

        Raises:
            InputError: unknown name.
        """
        return self._changed({name: partial(replace, tolerance=each) for name, each in tolerances.items()})

    def _changed(
        self, changes: Mapping[str, Callable[[Dimension], Dimension]], *, unusual: Collection[str] = ()
    ) -> Chip:
        """A copy with `changes` of dimensions and further `unusual` names."""
        known = self.dimensions()
        for name in changes:
            choose(name, known, source=self.file, field="dimension")

        def changed(name: str, old: Dimension | None) -> Dimension | None:
            return None if old is None else always(name, old)

        def always(name: str, old: Dimension) -> Dimension:
            return changes[name](old) if name in changes else old

        def of_profile(region: str, name: str, old: Dimension) -> Dimension:
            return always(f"{region}.{name}", old)

        shared, across = hole_names(self.layers, self.measure.across), self.measure.across
        layers = tuple(
            replace(
                layer,
                thickness=always(f"{layer.region}.thickness", layer.thickness),
                radius=always(f"{layer.region}.{across}", layer.radius),
                cavity_radius=changed(shared.get(layer.region, ""), layer.cavity_radius),
                bore=changed(f"{layer.region}.inner_{across}", layer.bore),
                profile=layer.profile and layer.profile.changed(partial(of_profile, layer.region)),
            ).with_shapes({shape: changed(f"{layer.region}.{shape}", size) for shape, size in layer.shapes.items()})
            for layer in self.layers
        )
        live, ground = (
            ElectrodeDisc(changed(f"{name}.{across}", disc.radius),
                          changed(f"{name}.inner_{across}", disc.inner_radius))
            for name, disc in discs(self.electrodes)
        )
        ports = self.ports and replace(
            self.ports,
            diameter=always("ports.diameter", self.ports.diameter),
            height=changed("ports.height", self.ports.height),
        )
        return replace(
            self,
            layers=stacked(layers),
            electrodes=replace(self.electrodes, live_disc=live, ground_disc=ground),
            ports=ports,
            unusual=tuple(dict.fromkeys((*self.unusual, *unusual))),
        )


def _resized(old: Dimension, value: float) -> Dimension:
    """A dimension with another value, without tolerance. It is unchanged if the value is equal."""
    return old if value == old.value else replace(old, value=value, tolerance=None)


def read_chip(
    path: Path | str, *, scripts: bool = True, materials: Path | str | Sequence[Path | str] = ()
) -> Chip:
    """Read a chip from a TOML file.

    A layer may be drawn by a Python script beside the file, which runs when the chip is built. A warning names it;
    ``scripts=False`` or the environment variable ``WORKBENCH_NO_SCRIPTS=1`` refuses it. `materials` names one folder or
    several with the user's own materials.

    Raises:
        InputError: the file is missing, is not TOML, does not describe a chip, or names a refused script; a folder of
            materials does not exist.
    """
    folders = tuple(map(Path, (materials,) if isinstance(materials, str | Path) else materials))
    for folder in folders:
        if not folder.is_dir():
            raise InputError("read_chip", "materials", str(folder), "an existing folder of materials",
                             nearest_files(folder, Path.is_dir))
    return replace(parse_chip(read_toml(Path(path)), source=str(path), scripts=scripts), material_folders=folders)


def parse_chip(content: Mapping[str, Any], *, source: str, scripts: bool = True) -> Chip:
    """The chip described by the content of a chip file.

    `source` is the name in error messages; `scripts` is that of :func:`read_chip`.

    Raises:
        InputError: the content does not describe a chip.
    """
    root = FileTable(source, "", content).only(("chip", "layers", "cavity", "states", "features"))
    head = root.table("chip").only(
        ("name", "description", "source", "band", "unusual", "geometry", "length", "symmetry",
         "operating_point"))
    measure = read_measure(head)
    layers, electrodes = read_layers(root, measure, scripts=scripts)
    cavity = root.table("cavity").only(("ports", "open", "fill"))
    unusual = head.texts("unusual", (), expected="a list of the names of unusual but intended values")
    layers, is_open = read_well(cavity, layers, measure, unusual)
    chip = Chip(
        name=read_text(head, "name"),
        layers=layers,
        band=read_band(head),
        states=read_states(root.table("states")),
        electrodes=electrodes,
        ports=read_ports(cavity.table("ports")) if "ports" in cavity else None,
        description=head.text("description", ""),
        source=head.text("source", ""),
        file=source,
        measure=measure,
        is_open=is_open,
        unusual=unusual,
        operating_point=read_operating_point(head),
        features=read_features(root),
    )
    checks.warn_of_films(layers, unusual, source, measure)
    return chip
