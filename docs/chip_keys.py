"""Every key of a chip file, from the code that reads it: the modules of `geometry` name the keys of each table.

The code says which keys there are, in which unit each is given and whether it is a length; the sentences are here. A
key without a sentence, or a sentence without a key, is an error: the page cannot go stale.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import geometry
from geometry import plausible
from geometry.names import ROLES
from workbench.files.quantities import UNITS

#: What every key says, by table.
ABOUT: Mapping[str, Mapping[str, str]] = {
    "The file": {
        "chip": "name, geometry, band and drive of the chip",
        "layers": "the layers from bottom to top, each under `[[layers]]`",
        "cavity": "the ports of the cavity, and whether it is an open well",
        "features": "parts beside the axis of a round chip, each under `[[features]]`",
        "states": "the states a chip is used in, each under `[states.NAME]`; without any there is one, `default`",
    },
    "`[chip]`": {
        "name": "name of the chip in reports",
        "description": "a sentence about the chip",
        "source": "where the description comes from",
        "band": 'the frequencies the chip is meant for, such as `["0.91 MHz", "1.155 MHz"]`',
        "operating_point": "the frequency that the chip is driven at: `energy` (if not given), `f0`, or a frequency "
                           "such as `1.94 MHz`",
        "unusual": "names of sizes that are meant although no such part has them, such as `[\"couplant.thickness\"]`; "
                   "see below",
        "geometry": "`axisymmetric` (if not given): discs and rings about one axis; or `straight`: plates with a "
                    "channel along them, by their cross-section",
        "length": "of a straight chip along its channel; without it Z, powers and heat are those of 1 m, a finding "
                  "says so, and a generator, a power or a recording is refused",
        "symmetry": "of a straight chip about its middle, x = 0: `even` (if not given), `odd` for electrodes at +V and "
                    "-V on both sides of a gap, or `none`: both halves are meshed; a finding says that it is not given",
    },
    "`[cavity]`": {
        "ports": "inlet and outlet of the cavity",
        "open": "whether the liquid's surface is free: no layer covers the cavity; `true` if not given beside `fill`, "
                "otherwise `false`",
        "fill": "the depth of the liquid in an open well; all of it if not given",
    },
    "`[[layers]]`": {
        "role": "purpose of the layer, one of " + ", ".join(f"`{role}`" for role in ROLES)
                + "; roles may be left out and repeated, but there is a transducer",
        "material": "the name of a material, such as `pla/acevedo_2026`, or `pla` where that is clear",
        "density": "density of a part that was weighed, in place of its material's",
        "thickness": "thickness of the layer",
        "radius": "radius of the layer; it may differ from layer to layer",
        "diameter": "twice the radius, in place of it",
        "cavity_radius": "a hole that belongs to the cavity; holes are in neighbouring layers",
        "cavity_diameter": "twice that radius, in place of it",
        "inner_radius": "inner radius of a ring around a bore that is empty, or is a part of a further cavity",
        "filling": "material of that further cavity, in all layers around it; a state may replace it, as `cavity_2`",
        "inner_diameter": "twice that radius, in place of it",
        "draft": "the angle by which the hole grows wider upwards, where its wall is not upright",
        "barrel": "how far the outer side bulges half-way up, in a parabola",
        "bow": "how much higher the layer is on its axis than at its edge, in a parabola; both faces",
        "dome": "how much thicker the layer is on its axis than at its edge, in a parabola of its upper face",
        "taper": "difference of thickness across the diameter, of a bare transducer alone, see {doc}`features`",
        "profile": "an outline of any shape in place of the disc, see below and {doc}`your_own_shape`",
        "bottom": "height of the lower face, for a check: layers are stacked without it",
        "electrodes": "of a transducer alone, see below",
        "poled": "of a transducer alone: `up` (if not given) or `down`",
    },
    "`[[layers]]`, of a straight chip": {
        "role": "as of a round chip",
        "material": "as of a round chip",
        "density": "as of a round chip",
        "thickness": "thickness of the layer",
        "half_width": "from the middle of the chip to the side of the layer; it may differ from layer to layer",
        "width": "twice that, in place of it",
        "cavity_half_width": "half width of a channel through the layer; channels are in neighbouring layers",
        "cavity_width": "twice that, in place of it",
        "inner_half_width": "half width of a bore along the chip that is empty, or is a part of a further cavity",
        "inner_width": "twice that, in place of it",
        "filling": "as of a round chip",
        "bottom": "as of a round chip",
        "offset": "how far its middle is to the right of that of a chip with `symmetry = \"none\"`; 0 if not given",
        "cavity_offset": "the same of the channel, or of a bore",
        "channels": "number of equal channels side by side; 1 if not given. Their common middle is that of the layer",
        "pitch": "distance between the middles of neighbouring channels",
        "draft": "the angle by which the channel grows wider upwards: 35.26 deg of silicon etched by KOH",
        "barrel": "as of a round chip, to both sides",
        "bow": "as of a round chip, with the middle of the layer in place of the axis",
        "dome": "as of a round chip, with the middle of the layer in place of the axis",
        "profile": "the outline of its right half, x from its middle, in place of a rectangle; `points`, or a `script` "
                   "that draws a face, see {doc}`straight_channel`",
        "electrodes": "of a transducer alone, see below",
        "poled": "as of a round chip",
    },
    "`electrodes`, of a further transducer": {
        "live": "its face at the drive voltage, `top` or `bottom`; its electrodes cover its faces",
    },
    "`electrodes`, of the transducer's layer in a straight chip": {
        "live": "the face at the drive voltage, `top` (if not given) or `bottom`; the other one is ground",
        "live_half_width": "where that electrode ends, if before the side of the plate",
        "live_inner_half_width": "where it begins, if there is a gap in the middle: half of the gap",
        "ground_half_width": "the same of the ground electrode",
        "ground_inner_half_width": "the same of the ground electrode",
        "live_width": "twice `live_half_width`, in place of it",
        "live_inner_width": "twice `live_inner_half_width`, in place of it: the gap",
        "ground_width": "twice `ground_half_width`, in place of it",
        "ground_inner_width": "twice `ground_inner_half_width`, in place of it",
        "halves": "signs of the left and the right half of a live electrode with a gap, each `\"+\"`, `\"-\"` or "
                  "`\"0\"` (at ground); both `\"+\"` if not given, and opposite with symmetry `odd`",
        "wiring": "of halves at opposite voltages: `transformer` (if not given), `two amplifiers` or `between the "
                  "halves` ({ref}`wiring`)",
    },
    "`electrodes`, of the transducer's layer": {
        "live": "the face at the drive voltage, `top` (if not given) or `bottom`; the other one is ground",
        "live_radius": "where that electrode ends, if before the edge of the disc",
        "live_inner_radius": "where it begins, if it is a ring",
        "ground_radius": "the same of the ground electrode",
        "ground_inner_radius": "the same of the ground electrode",
        "live_diameter": "twice `live_radius`, in place of it",
        "live_inner_diameter": "twice `live_inner_radius`, in place of it",
        "ground_diameter": "twice `ground_radius`, in place of it",
        "ground_inner_diameter": "twice `ground_inner_radius`, in place of it",
    },
    "`profile`, of a layer": {
        "points": "the outline: three or more points, each `[\"r\", \"z\"]` or a table, see below",
        "script": "a Python file beside the chip file that draws the layer with CadQuery",
        "function": "its function; arguments are sizes by name, in millimetres and degrees",
        "step": "a STEP file beside the chip file",
        "part": "the name of the solid in it",
        "scale": "length of one unit of the STEP file; `1 mm` if not given",
        "parameters": "sizes by name, lengths or angles, that points or the function use; dimensions of the chip",
        "axis": "the direction in a script or file that points up through the chip, about which the solid turns: `x`, "
                "`y`, `z` (if not given), `-x`, `-y`, `-z`, or three numbers",
        "origin": "the point x, y, z on that axis from which heights are counted; that of the file if not given",
        "sector": "angle of the solid, where it is a part of a body of revolution: `180 deg` for one half, as models "
                  "with a plane of symmetry have it",
        "asymmetry": "share of the solid's volume that may differ from its section turned about the axis; 1e-6 if not "
                     "given",
    },
    "A point of an outline": {
        "at": "where it is: r, and z above the bottom of the layer; lengths, or names of `thickness`, `radius`, "
              "`cavity_radius` and parameters",
        "fillet": "the radius that rounds this corner",
        "through": "points of a spline that leads here from the point before",
        "arc": "a point of a circular arc that leads here",
    },
    "`[[features]]`, of a round chip": {
        "kind": "`mass` (solder, glue), `spring` (a wire, a point support) or `gap` (a place without electrode)",
        "layer": "region of the layer; `transducer` if not given",
        "face": "its plane face, `top` (if not given) or `bottom`; nothing else touches it there, except at a gap",
        "distance": "distance of its centre from the axis",
        "angle": "its place around the axis; 0 if not given",
        "diameter": "diameter of the round patch that it covers and moves as a whole, or of the gap",
        "mass": "mass of a `mass`",
        "stiffness": "stiffness of a `spring` to a fixed point, equal in all directions",
        "loss": "loss of a `spring`: imaginary part over real part of its stiffness; 0 if not given",
    },
    "`ports`, of the cavity": {
        "diameter": "diameter of the channels from the cavity to the outside; only the solid model has them",
        "height": "height of their axes above the floor of the cavity; half-way up its tallest layer if not given",
        "count": "number of ports, from 1 to 8; 2 if not given",
    },
    "`[states.NAME]`": {
        "cavity": 'material in the cavity, or `"vacuum"` for nothing; needed where there is a cavity',
        "temperature": "temperature of the cavity's fluid",
        "materials": "materials of single regions in this state, by the region's name",
        "particle": "the material of a particle, for potential and traps",
        "particle_radius": "its radius; both or neither",
        "particle_diameter": "twice that radius, in place of it",
        "reported": "reported figures, for comparison: `[[states.NAME.reported]]`",
    },
    "`[[states.NAME.reported]]`": {
        "label": "source of the figures", "f0": "resonance frequency", "z_min": "smallest impedance",
        "q": "quality factor",
    },
    "A length": {
        "value": "the length",
        "tolerance": "half width of the interval that holds the length; `0 mm` means that it is exact",
        "assumed": "`true` where it was chosen, not measured or published", "note": "where it comes from",
    },
}

#: The functions and methods that read a key, and what they take.
READ_BY: Mapping[str, str] = {"text": "text", "dimension": "a length", "dimension_or": "a length",
                              "table": "a table", "tables": "a list of tables",
                              "whole": "a whole number", "flag": "`true` or `false`"}

#: What is read in a way of its own.
TAKES: Mapping[str, str] = {
    **dict.fromkeys(("geometry", "symmetry"), "text"),
    "length": f"text with a unit: {', '.join(dict.fromkeys(UNITS['length']))}",
    "kind": "text", "loss": "a number", "layer": "text", "face": "text", "features": "a list of tables",
    "chip": "a table", "layers": "a list of tables", "cavity": "a table", "states": "a table", "role": "text",
    "band": "a list of two frequencies", "operating_point": "text", "unusual": "a list of names",
    **dict.fromkeys(("value", "tolerance"), "text with a unit: " + ", ".join(
        f"{', '.join(dict.fromkeys(UNITS[kind]))} ({kind})" for kind in ("length", "angle"))),
    "profile": "a table", "points": "a list of points", "halves": "a list of two signs", "wiring": "text",
    **dict.fromkeys(("script", "function", "step", "part"), "text"), "through": "a list of points",
    **dict.fromkeys(("at", "arc"), "a point"), "fillet": "a length, or the name of one",
    "fill": "a length", "offset": "a length", "cavity_offset": "a length", "open": "`true` or `false`",
    **{f"inner_{size}": "a length" for size in ("radius", "diameter", "half_width", "width")},
    "filling": "text", "channels": "a whole number", "pitch": "a length", "poled": "text", "live": "text",
    "draft": "an angle", "barrel": "a length", "bow": "a length", "dome": "a length", "taper": "a length",
    **{f"{face}_{name}{size}": "a length" for face in ("live", "ground") for name in ("", "inner_")
       for size in ("radius", "diameter", "half_width", "width")},
    **{f"{name}{size}": "a length" for name in ("", "cavity_", "particle_")
       for size in ("radius", "diameter", "half_width", "width")},
    "axis": "text, or a list of numbers", "origin": "a list of three lengths", "sector": "an angle",
}


def _named(node: ast.AST, constants: Mapping[str, Any]) -> set[str]:
    """The texts that an expression holds, those of the module's constants included; not what a condition compares."""
    if isinstance(node, ast.IfExp):
        return _named(node.body, constants) | _named(node.orelse, constants)
    if isinstance(node, ast.Constant):
        return {node.value} if isinstance(node.value, str) else set()
    if isinstance(node, ast.Name):
        return set(constants.get(node.id, ()))
    return set().union(*(_named(child, constants) for child in ast.iter_child_nodes(node)))


def _name(function: ast.expr) -> str:
    """What a call calls, without what only tells that the key may be left out."""
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    return name.removeprefix("_").removeprefix("read_").removeprefix("optional_")


def _readings(function: ast.FunctionDef, keys: set[str]) -> Iterator[tuple[str, str]]:
    """(key, what it takes) for every call in a function that reads one of `keys`."""
    for node in ast.walk(function):
        if isinstance(node, ast.Call):
            texts = [argument.value for argument in node.args if isinstance(argument, ast.Constant)
                     and isinstance(argument.value, str)]
            if texts and texts[0] in keys:
                name = _name(node.func)
                if name in READ_BY:
                    yield texts[0], READ_BY[name]
                elif name == "quantity" and len(texts) > 1:
                    yield texts[0], "text with a unit: " + ", ".join(dict.fromkeys(UNITS[texts[1]]))


def tables() -> list[dict[str, str]]:
    """The keys of every table that the code reads, and what each takes."""
    found = []
    for path in sorted(Path(geometry.__file__).parent.glob("*.py")):
        module = importlib.import_module(f"geometry.{path.stem}" if path.stem != "__init__" else "geometry")
        for function in (node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
                         if isinstance(node, ast.FunctionDef)):
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "only":
                    keys = set().union(*(_named(argument, vars(module)) for argument in node.args))
                    takes = dict(_readings(function, keys))
                    found.append({key: takes.get(key) or TAKES[key] for key in keys})
    return found


def plausible_page() -> str:
    """The sizes that parts of a chip have, as a table, from `geometry.plausible`."""
    rows = [*((f"thickness of a layer with role `{role}`", each, "length")
              for role, each in plausible.THICKNESSES.items()),
            ("radius of a layer", plausible.RADIUS, "length"),
            ("radius of a cavity", plausible.CAVITY_RADIUS, "length"),
            ("radius of the hole of a ring", plausible.BORE, "length"),
            ("radius of an electrode", plausible.ELECTRODE_RADIUS, "length"),
            ("radius of the hole, or half the gap, in an electrode", plausible.ELECTRODE_GAP, "length"),
            ("length of a straight chip", plausible.LENGTH, "length"),
            ("depth of the liquid in a well", plausible.FILL, "length"),
            ("diameter and height of ports", plausible.PORT, "length"),
            ("radius of a particle", plausible.PARTICLE_RADIUS, "length"),
            ("density of a layer that was weighed", plausible.DENSITY, "density"),
            ("temperature of a state", plausible.TEMPERATURE, "temperature")]
    lines = ["| size | from | to |", "| --- | --- | --- |"]
    lines += [f"| {name} | {plausible.as_text(each.low, kind)} | {plausible.as_text(each.high, kind)} |"
              for name, each, kind in rows]
    return "\n".join(lines) + "\n"


def page() -> str:
    """A table of keys for every table of a chip file, in Markdown.

    Raises:
        ValueError: a key that nobody explained, or an explanation of a key that there is not.
    """
    known = {frozenset(told): title for title, told in ABOUT.items()}
    read = {frozenset(keys): keys for keys in tables()}
    for odd in known.keys() ^ read.keys():
        raise ValueError(f"docs/chip_keys.py and the reader of chip files disagree on the keys {sorted(odd)}")
    parts = []
    for keys, title in known.items():
        lines = [f"### {title}\n", "| key | takes | meaning |", "| --- | --- | --- |"]
        lines += [f"| `{key}` | {read[keys][key]} | {told} |" for key, told in ABOUT[title].items()]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"
