"""What fools a diagnosis: imitations, what one state cannot show, a bench that looks like damping, noise with a colour,
recordings that do not belong together.

The recordings are the model's own with noise, so that nothing but the inference is on trial (other meshes, elements and
physics: `tests/benchmarks/trials.py`).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from own_recordings import MATERIALS, NOISE

from geometry.chip import read_chip
from materials.registry import user_registry
from workbench.campaign.campaign import read_campaign
from workbench.diagnosis.appraisal import diagnose_model
from workbench.diagnosis.device import Model, device_model
from workbench.diagnosis.estimates import FoundNumber
from workbench.diagnosis.outcome import Diagnosis
from workbench.fem.operators import assemble
from workbench.files.errors import InputError
from workbench.fitting.measurement_model import through_bench
from workbench.model.problem import build, fill
from workbench.reduced.at_point import reduce
from workbench.results.spectrum import Spectrum, write_spectrum

Real = NDArray[np.float64]

pytestmark = pytest.mark.slow

FREQUENCIES = np.linspace(0.9e6, 1.1e6, 121)
#: Meshes are made for what they are filled with: what they leave must be small beside the noise, whatever fills them.
ACCURACY = 1e-4
PZT, PLA = "pzt/trial", "pla/trial"

HEAD = '[chip]\nname = "small"\nband = ["0.88 MHz", "1.12 MHz"]\n'
LAYER = '[[layers]]\nrole = "{}"\nmaterial = "{}"\nthickness = "{}"\nradius = "4 mm"\n'
DISC = HEAD + LAYER.format("transducer", "pzt/trial", "2 mm") + 'electrodes = { live = "top" }\n'
SAMPLE = DISC + LAYER.format("couplant", "gel/trial", "20 um") + LAYER.format("substrate", "pla/trial", "1 mm")


class Bench:
    """A folder that recordings of one device are made in."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.rng = folder, np.random.default_rng(1)
        self.states: list[str] = []
        for name, text in (("disc", DISC), ("sample", SAMPLE)):
            (folder / f"{name}.toml").write_text(text)

    def record(
        self, name: str, chip: str, *, factors: Mapping[str, complex] | None = None,
        bench: Mapping[str, float] | None = None, colour: float = 0.0, drive: str = "2 Vpp",
    ) -> None:
        """A state whose parameters are the stated ones times `factors`; `colour` correlates neighbouring points."""
        there = read_chip(self.folder / f"{chip}.toml")
        registry = user_registry([MATERIALS])
        problem = build(fill(there, there.states[0].name, registry), accuracy=ACCURACY)
        values = {**problem.values, **{key: problem.values[key] * factor for key, factor in (factors or {}).items()}}
        solved = reduce(assemble(problem.mesh, problem.terms), FREQUENCIES, values).solve(FREQUENCIES, values)
        clean, _, _ = through_bench(np.conj(solved.impedance), 2.0 * np.pi * FREQUENCIES, dict(bench or {}))
        noise = self.rng.standard_normal((2, FREQUENCIES.size))
        for k in range(1, FREQUENCIES.size):
            noise[:, k] = colour * noise[:, k - 1] + np.sqrt(1.0 - colour**2) * noise[:, k]
        seen = clean * (1.0 + NOISE * (noise[0] + 1j * noise[1]))
        write_spectrum(Spectrum(FREQUENCIES, seen, NOISE * np.abs(seen)), self.folder / f"{name}.csv")
        self.states.append(f'[states.{name}]\nchip = "{chip}.toml"\nrecording = "{name}.csv"\ndrive = "{drive}"\n')

    def model(self, known: Mapping[str, str]) -> Model:
        """The model of the states recorded so far."""
        lines = ["[known]", *(f'"{name}" = "{error}"' for name, error in known.items())]
        path = self.folder / "campaign.toml"
        path.write_text("\n".join([*self.states, *lines]) + "\n")
        return device_model(read_campaign(path, materials=[MATERIALS]), accuracy=ACCURACY)

    def diagnosed(self, known: Mapping[str, str]) -> Diagnosis:
        return diagnose_model(self.model(known))


#: How well the constants of a disc are known whose density is in doubt.
CONSTANTS = {**{f"{PZT}.{name}": "5 %" for name in ("c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15")},
             f"{PZT}.eps33": "5 %", **{f"{PZT}.{name}.loss": "20 %" for name in ("c11", "c33", "c44")}}


def heavier(factor: float) -> dict[str, complex]:
    """Density and stiffnesses by one factor, piezoelectric constants by its root: a free disc is the same disc."""
    found: dict[str, complex] = {f"{PZT}.{name}": factor for name in ("density", "c11", "c12", "c13", "c33", "c44")}
    return found | {f"{PZT}.{name}": factor**0.5 for name in ("e31", "e33", "e15")}


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def named(found: Diagnosis) -> list[str]:
    print(f"{found.seconds:.0f} s: {found.headline}")
    return [effect.name for effect in found.effects]


def estimate(found: Diagnosis, name: str) -> FoundNumber:
    """The parameter of that name of what is established."""
    return next(each for every in found.established for each in every.estimates if each.name == name)


def test_a_ceramic_that_softens_is_seen_in_two_states_and_not_in_one(bench: Bench) -> None:
    """Driven at one level alone, it is just another ceramic."""
    known = {f"{PZT}.{name}": "2 %" for name in ("c11", "c33", "e33", "eps33")} | {f"{PZT}.c33.loss": "50 %"}
    bench.record("hard", "disc", drive="8 Vpp", factors={f"{PZT}.c33": 0.99 * (1.0 - 0.002j)})
    alone = bench.diagnosed(known)
    assert alone.verdict == "parameters_explain"
    assert not named(alone)
    bench.record("gentle", "disc", drive="0.5 Vpp")
    both = bench.diagnosed(known)
    assert named(both) == ["softening with the drive"]
    softening = estimate(both, f"{PZT}.softening")
    # c33 (1 - s V^2) at 4 V of amplitude is 0.99 of that at 0.25 V.
    assert softening.low < 0.01 / (4.0**2 - 0.99 * 0.25**2) < softening.high


def test_a_wrong_density_of_the_transducer_shows_in_no_free_disc(bench: Bench) -> None:
    """`tests/benchmarks/strong.py` finds it by a polymer on the disc, where it would be laid to that otherwise."""
    bench.record("disc", "disc", factors=heavier(1.048))
    free = bench.diagnosed(CONSTANTS)
    assert not named(free)
    assert free.base[0].reduced < 1.3


def test_a_lead_that_looks_like_damping_is_laid_to_the_bench(bench: Bench) -> None:
    known = {f"{PZT}.{name}.loss": "50 %" for name in ("c11", "c33", "c44", "eps33")}
    known |= {f"{PZT}.{name}": "2 %" for name in ("c33", "e33", "eps33")} | {"bench.series_resistance": "0.05 ohm"}
    bench.record("disc", "disc", bench={"bench.series_resistance": 1.5})
    found = bench.diagnosed(known)
    assert named(found) == ["resistance of leads and contacts"]
    leads = estimate(found, "bench.series_resistance")
    assert leads.low < 1.5 < leads.high


@pytest.mark.parametrize("seed", range(2))
def test_noise_with_a_colour_is_no_physics(bench: Bench, seed: int) -> None:
    bench.rng = np.random.default_rng(seed)
    known = {f"{PZT}.{name}": "2 %" for name in ("c33", "e33", "eps33")} | {f"{PZT}.c33.loss": "30 %"}
    bench.record("disc", "disc", colour=0.9)
    found = bench.diagnosed(known)
    assert not named(found)


KNOWN = {**{f"{PZT}.{name}": "2 %" for name in ("c11", "c13", "c33", "e33", "eps33")}, f"{PZT}.c33.loss": "30 %",
         **{f"{PLA}.{name}": "3 %" for name in ("shear_modulus", "bulk_modulus")}}


def test_recordings_exchanged_between_states_are_refused(bench: Bench) -> None:
    long = SAMPLE.replace('thickness = "1 mm"', 'thickness = "1.5 mm"').replace('"substrate"', '"sample"')
    (bench.folder / "long.toml").write_text(long)
    bench.record("short", "sample")
    bench.record("long", "long")
    short, other = bench.folder / "short.csv", bench.folder / "long.csv"
    spare = short.rename(bench.folder / "spare.csv")
    other.rename(short)
    spare.rename(other)
    with pytest.raises(InputError, match=r"campaign.toml: states\.short\.recording: received 'the one that "
                                         r"states\.long should have, it seems'; .*as stated, but of 0\.00"):
        bench.diagnosed(KNOWN)
