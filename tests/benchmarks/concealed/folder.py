"""The folder of a trial: a campaign as somebody at a bench would have it, which tells nothing of what is concealed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from concealed.design import ABSOLUTE, REMOUNTED_BY, Design
from concealed.device import EPOXY, GEL, GLASS, PIEZO_CONSTANTS, PLA, PZT, State
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Whether campaigns say how much states differ, [between]: set False for a reader that does not know that table.
BETWEEN_IS_READ = True


def write(folder: Path, design: Design, states: Sequence[State], spectra: Mapping[str, Complex],
          rng: np.random.Generator) -> None:
    """Write the campaign of a device in its states, with noise on its spectra."""
    (folder / "materials").mkdir(parents=True)
    for state in states:
        clean = spectra[state.name]
        sigma = design.noise * np.abs(clean)
        noisy = clean + sigma * (rng.standard_normal(clean.size) + 1j * rng.standard_normal(clean.size))
        (folder / f"{state.name}.csv").write_text(recording(design.frequency, noisy), encoding="utf-8")
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
    for chip in {"disc" if state.filling == "disc" else "chip" for state in states}:
        (folder / f"{chip}.toml").write_text(_chip(design, chip), encoding="utf-8")
    (folder / "campaign.toml").write_text(_campaign(design, states), encoding="utf-8")


def recording(frequency: Real, impedance: Complex) -> str:
    """The text of a recording: both parts of Z (ohm) to 1e-5 of its magnitude, a hundredth of the noise or less."""
    lines = ["# kind: measured", f"# rows: {frequency.size}", "frequency_hz,z_real_ohm,z_imag_ohm"]
    for f, z in zip(frequency.tolist(), impedance.tolist(), strict=True):
        places = max(0, 5 - math.floor(math.log10(abs(z))))
        lines.append(f"{f:.9g},{z.real:.{places}f},{z.imag:.{places}f}")
    return "\n".join(lines) + "\n"


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


def _campaign(design: Design, states: Sequence[State]) -> str:
    lines = ["[campaign]", 'name = "device"', 'materials = "materials"']
    for state in states:
        chip, chosen = ("disc", "default") if state.filling == "disc" else (
            "chip", "filled_again" if state.held_out else state.filling)
        lines += ["", f"[states.{state.name}]", f'chip = "{chip}.toml"', f'state = "{chosen}"',
                  f'recording = "{state.name}.csv"', f'drive = "{state.drive:g} Vpp"',
                  f'temperature = "{state.temperature - 273.15:g} degC"', f'noise = "{100.0 * design.noise:g} %"']
        if state.held_out:
            lines.append("held_out = true")
    lines += ["", "[known]"]
    for name, size in design.prior.items():
        share = 100.0 * size / abs(design.nominal[name] or math.nan)
        lines.append(f'"{name}" = "{f"{size:g} {ABSOLUTE[name][1]}" if name in ABSOLUTE else f"{share:g} %"}"')
    if design.remounted and BETWEEN_IS_READ:
        lines += ["", "[between]", f'"couplant.thickness" = "{100.0 * REMOUNTED_BY:g} %"']
    return "\n".join(lines) + "\n"
