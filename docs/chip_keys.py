"""Every key of a chip file, from the code that reads it: `geometry/chip.py` names the keys that each table may have.

The code says which keys there are, in which unit each is given and whether it may be left out; the sentences are here.
A key without a sentence, or a sentence without a key, is an error: the page cannot go stale.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Mapping

import geometry.chip
from geometry.names import ROLES
from workbench.files.quantities import UNITS

#: The functions that read a table, and what the table is called in a file.
TABLES: Mapping[str, str] = {
    "parse_chip": "", "_read_layers": "[[layers]]", "_read_electrodes": "electrodes, of the transducer's layer",
    "_read_ports": "[cavity] ports", "_read_states": "[states.NAME]", "_read_reported": "[[states.NAME.reported]]",
    "dimension": "a length",
}

#: What every key says, by table.
ABOUT: Mapping[str, Mapping[str, str]] = {
    "": {
        "chip": "the table `[chip]`: name, description, source and band",
        "layers": "the layers from bottom to top, each under `[[layers]]`",
        "cavity": "the table `[cavity]`: its ports",
        "states": "the states a chip is used in, each under `[states.NAME]`; without any there is one, `default`",
        "name": "what the chip is called in reports",
        "description": "what it is, in words",
        "source": "where the description comes from",
        "band": 'the frequencies it is meant for, such as `["0.91 MHz", "1.155 MHz"]`',
        "ports": "inlet and outlet of the cavity, see below",
    },
    "[[layers]]": {
        "role": "what the layer is for, one of " + ", ".join(f"`{role}`" for role in ROLES)
                + "; roles may be left out and repeated, but there is exactly one transducer",
        "material": "the name of a material, such as `pla/acevedo_2026`, or `pla` where that is clear",
        "density": "of a part that was weighed, in place of its material's",
        "thickness": "of the layer",
        "radius": "of the layer; it may differ from layer to layer",
        "cavity_radius": "a hole that belongs to the cavity; holes are in neighbouring layers",
        "bottom": "height of the lower face, for a check: layers are stacked without it",
        "electrodes": "of the transducer alone, see below",
    },
    "electrodes, of the transducer's layer": {
        "live": "the face at the drive voltage, `top` (if not given) or `bottom`; the other one is ground",
        "live_radius": "where that electrode ends, if before the rim",
        "live_inner_radius": "where it begins, if it is a ring",
        "ground_radius": "the same of the ground electrode",
        "ground_inner_radius": "the same of the ground electrode",
    },
    "[cavity] ports": {
        "diameter": "of the channels from the cavity to the outside; only the solid model has them",
        "height": "of their axes above the floor of the cavity; half-way up its tallest layer if not given",
        "count": "how many, from 1 to 8; 2 if not given",
    },
    "[states.NAME]": {
        "cavity": 'what fills the cavity: a material, or `"vacuum"` for nothing; needed where there is one',
        "temperature": "of what fills the cavity",
        "materials": "materials of single regions in this state, by the region's name",
        "particle": "the material of a particle, for potential and traps",
        "particle_radius": "its radius; both or neither",
        "reported": "figures that somebody reported, for comparison: `[[states.NAME.reported]]`",
    },
    "[[states.NAME.reported]]": {
        "label": "who reported them", "f0": "resonance frequency", "z_min": "smallest impedance",
        "q": "quality factor",
    },
    "a length": {
        "value": "the length", "tolerance": "how exact it is; `0 mm` means that it is exact",
        "assumed": "`true` where it was chosen, not measured or published", "note": "where it comes from",
    },
}

#: The methods that read a key, and what they take.
READ_BY: Mapping[str, str] = {
    "text": "text", "optional_text": "text", "dimension": "a length", "optional_dimension": "a length",
    "table": "a table",
}

#: What is read in a way of its own.
TAKES: Mapping[str, str] = {
    "layers": "a list of tables", "band": "a list of two frequencies", "role": "text", "count": "a whole number",
    "reported": "a list of tables", "assumed": "`true` or `false`",
    **{f"{face}_{name}radius": "a length" for face in ("live", "ground") for name in ("", "inner_")},
}


def tables() -> dict[str, dict[str, str]]:
    """The keys of every table and what each takes, as the code reads them."""
    tree = ast.parse(inspect.getsource(geometry.chip))
    found: dict[str, dict[str, str]] = {}
    for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name in TABLES):
        keys: dict[str, str] = {}
        strings: list[str] = []
        for node in ast.walk(function):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "only":
                strings += [part.value for part in ast.walk(node)
                            if isinstance(part, ast.Constant) and isinstance(part.value, str)]
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "keys":
                strings += ast.literal_eval(node.value)
        for key in strings:
            keys[key] = ""
        for node in ast.walk(function):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.args):
                continue
            arguments = [argument.value for argument in node.args if isinstance(argument, ast.Constant)]
            if arguments and arguments[0] in keys:
                if node.func.attr in READ_BY:
                    keys[str(arguments[0])] = READ_BY[node.func.attr]
                elif node.func.attr in ("quantity", "optional_quantity") and len(arguments) > 1:
                    units = ", ".join(dict.fromkeys(UNITS.get(str(arguments[1]), ())))
                    keys[str(arguments[0])] = f"text with a unit: {units}"
        found[TABLES[function.name]] = {key: takes or TAKES[key] for key, takes in keys.items()}
    return found


def page() -> str:
    """A table of keys for every table of a chip file, in Markdown.

    Raises:
        ValueError: a key that nobody explained, or an explanation of a key that there is not.
    """
    parts = []
    for table, keys in tables().items():
        told = ABOUT[table]
        if set(told) != set(keys):
            raise ValueError(f"docs/chip_keys.py, table {table!r}: not explained {sorted(set(keys) - set(told))}, "
                             f"explained and not read {sorted(set(told) - set(keys))}")
        title = {"": "The file, `[chip]` and `[cavity]`", "a length": "A length"}.get(table, f"`{table}`")
        lines = [f"### {title}\n", "| key | takes | says |", "| --- | --- | --- |"]
        lines += [f"| `{key}` | {keys[key]} | {told[key]} |" for key in keys]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"
