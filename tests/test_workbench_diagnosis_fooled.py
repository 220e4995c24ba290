"""What fools a diagnosis: imitations, what one state cannot show, a bench that looks like damping, noise with a colour,
recordings that do not belong together.

The recordings are the model's own with noise, so that nothing but the inference is on trial (other meshes, elements and
physics: `tests/benchmarks/trials.py`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from geometry.chip import read_chip
from materials.kinds import Fluid
from materials.registry import user_registry
from workbench.diagnosis.belong import cleared, each_alone
from workbench.diagnosis.campaign import read_campaign
from workbench.diagnosis.device import Model, model
from workbench.diagnosis.procedure import diagnose_model
from workbench.diagnosis.refit import MODELLED, UNNEEDED, base_fit, checked, refit
from workbench.diagnosis.score import scores_at
from workbench.diagnosis.verdict import Diagnosis
from workbench.files.errors import InputError
from workbench.fitting.search import Search
from workbench.fitting.seen import through_bench
from workbench.operators import assemble
from workbench.physics import bubbles
from workbench.problem import build, fill, with_boundary_layers
from workbench.reduction import NotEnriched, reduce
from workbench.spectrum import Spectrum, write_csv

Real = NDArray[np.float64]

pytestmark = pytest.mark.slow

FREQUENCIES = np.linspace(0.9e6, 1.1e6, 121)
#: Meshes are made for what they are filled with: what they leave must be small beside the noise, whatever fills them.
ACCURACY = 1e-4
NOISE = 3e-3
PZT, PLA = "pzt/trial", "pla/trial"

#: Lossy materials of no particular maker.
MATERIALS = Path(__file__).parent / "data" / "trials" / "0000" / "materials"

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
        problem = with_boundary_layers(build(fill(there, there.states[0].name, registry), accuracy=ACCURACY))
        values = {**problem.values, **{key: problem.values[key] * factor for key, factor in (factors or {}).items()}}
        solved = reduce(assemble(problem.mesh, problem.terms), FREQUENCIES, values).solve(FREQUENCIES, values)
        clean, _, _ = through_bench(np.conj(solved.impedance), 2.0 * np.pi * FREQUENCIES, dict(bench or {}))
        noise = self.rng.standard_normal((2, FREQUENCIES.size))
        for k in range(1, FREQUENCIES.size):
            noise[:, k] = colour * noise[:, k - 1] + np.sqrt(1.0 - colour**2) * noise[:, k]
        seen = clean * (1.0 + NOISE * (noise[0] + 1j * noise[1]))
        write_csv(Spectrum(FREQUENCIES, seen, NOISE * np.abs(seen)), self.folder / f"{name}.csv")
        self.states.append(f'[states.{name}]\nchip = "{chip}.toml"\nrecording = "{name}.csv"\ndrive = "{drive}"\n')

    def model(self, known: Mapping[str, str]) -> Model:
        """The model of the states recorded so far."""
        lines = ["[known]", *(f'"{name}" = "{error}"' for name, error in known.items())]
        path = self.folder / "campaign.toml"
        path.write_text("\n".join([*self.states, *lines]) + "\n")
        return model(read_campaign(path, materials=[MATERIALS]), accuracy=ACCURACY, cache=self.folder / "cache")

    def diagnosed(self, known: Mapping[str, str]) -> Diagnosis:
        return diagnose_model(self.model(known))


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def named(found: Diagnosis) -> list[str]:
    return [effect.name for effect in found.effects]


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
    low, high = both.best.interval(f"{PZT}.softening")
    # c33 (1 - s V^2) at 4 V of amplitude is 0.99 of that at 0.25 V.
    assert low < 0.01 / (4.0**2 - 0.99 * 0.25**2) < high


def test_a_wrong_density_of_the_transducer_is_not_laid_to_the_polymer(bench: Bench) -> None:
    """Density and stiffnesses by one factor, piezoelectric constants by its root: a free disc is the same disc."""
    factor = 1.04
    heavier = {f"{PZT}.{name}": factor for name in ("density", "c11", "c12", "c13", "c33", "c44")}
    heavier |= {f"{PZT}.{name}": factor**0.5 for name in ("e31", "e33", "e15")}
    known = {**{f"{PZT}.{name}": "5 %" for name in ("c11", "c12", "c13", "c33", "c44", "e31", "e33", "e15")},
             f"{PZT}.eps33": "5 %", **{f"{PZT}.{name}.loss": "20 %" for name in ("c11", "c33", "c44")}}
    bench.record("disc", "disc", factors=heavier)
    free = bench.diagnosed(known)
    assert not named(free)
    assert free.base.reduced < 1.3
    bench.record("loaded", "sample", factors=heavier)
    known |= {f"{PLA}.shear_modulus": "10 %", f"{PLA}.bulk_modulus": "10 %"}
    found = bench.diagnosed(known)
    assert named(found) == ["density that the constants were fitted with"]
    low, high = found.best.interval("transducer.gauge")
    print("density off by", low, high)
    assert low < factor - 1.0 < high
    # Known to 5 %, the constants make up for a density that alone is wrong.
    assert {effect.name for rival in found.rivals for effect in rival.refit.effects} <= {"density of the transducer"}
    # Without it the polymer takes the blame.
    moduli = [found.model.index(f"{PLA}.{name}") for name in ("shear_modulus", "bulk_modulus")]
    bias = [abs(found.base.x[i] / found.model.parameters[i].start - 1.0) for i in moduli]
    left = [abs(found.best.x[i] / found.model.parameters[i].start - 1.0) for i in moduli]
    print("bias of the moduli", bias, left)
    assert max(bias) > 3.0 * max(left)


def test_a_lead_that_looks_like_damping_is_laid_to_the_bench(bench: Bench) -> None:
    known = {f"{PZT}.{name}.loss": "50 %" for name in ("c11", "c33", "c44", "eps33")}
    known |= {f"{PZT}.{name}": "2 %" for name in ("c33", "e33", "eps33")} | {"bench.series_resistance": "0.05 ohm"}
    bench.record("disc", "disc", bench={"bench.series_resistance": 1.5})
    found = bench.diagnosed(known)
    assert named(found) == ["resistance of leads and contacts"]
    low, high = found.best.interval("bench.series_resistance")
    assert low < 1.5 < high


@pytest.mark.parametrize("seed", range(3))
def test_noise_with_a_colour_is_no_physics(bench: Bench, seed: int) -> None:
    bench.rng = np.random.default_rng(seed)
    known = {f"{PZT}.{name}": "2 %" for name in ("c33", "e33", "eps33")} | {f"{PZT}.c33.loss": "30 %"}
    bench.record("disc", "disc", colour=0.9)
    found = bench.diagnosed(known)
    assert not named(found)
    assert any("no white noise" in text for text in found.findings)


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


def test_recordings_of_two_devices_are_told_from_missing_physics(bench: Bench) -> None:
    """A disc, and a sample on another disc: each alone is explained by what is known of it, both together are not."""
    bench.record("disc", "disc")
    bench.record("sample", "sample", factors={f"{PZT}.c33": 1.02, f"{PZT}.c13": 0.98, f"{PZT}.eps33": 1.03,
                                              f"{PZT}.e33": 0.98})
    device = bench.model(KNOWN)
    _, base, _ = base_fit(device)
    assert "explain disc (0." in (said := each_alone(device, base))
    assert "each alone, but not together" in said


@pytest.mark.parametrize(("chip", "regions"), [("sample", {"transducer"}), ("disc", set())])
def test_a_disc_that_is_in_order_alone_clears_the_transducer(bench: Bench, chip: str, regions: set[str]) -> None:
    for name in ("disc", "sample"):
        bench.record(name, name, bench={"bench.series_resistance": 1.5 if name == chip else 0.0})
    assert cleared(bench.model(KNOWN))[0] == regions


def test_an_effect_that_bends_far_away_from_its_tangent_is_found(bench: Bench) -> None:
    """Gel that gas makes three times slower: its known parameters alone leave ten thousand times the noise.

    Asked where they fit best the score is of no use, and at nothing it asks for a tenth: only held at several strengths
    from where the disc alone leaves everything does it lead there.
    """
    fraction = 7e-4
    gel = user_registry([MATERIALS]).load("gel/trial")
    assert isinstance(gel, Fluid)
    gas = bubbles.AIR_IN_WATER["ambient_pressure"] * bubbles.AIR_IN_WATER["heat_capacity_ratio"]
    liquid = gel.density * gel.sound_speed**2
    # Wood: compressibility and density are those of the volume.
    speed = ((1.0 - fraction) * ((1.0 - fraction) + fraction * liquid / gas)) ** -0.5
    bench.record("disc", "disc")
    bench.record("sample", "sample", factors={"gel/trial.density": 1.0 - fraction, "gel/trial.sound_speed": speed})
    found = bench.diagnosed(KNOWN)
    assert found.base.reduced > 1e3
    assert named(found) == ["bubbles in the couplant"]
    assert found.best.good
    # To the model's own error: noise alone would be known to a hundred times less.
    low, high = found.best.interval("couplant bubbles.void_fraction")
    assert low < fraction < high
    assert high - low == pytest.approx(4.0 * MODELLED * fraction, rel=0.05)


def test_intervals_are_wider_where_points_go_together(bench: Bench) -> None:
    """Of noise with a colour of 0.8 one point in nine counts."""
    widths, correlations = [], []
    for name, colour in (("white", 0.0), ("red", 0.8)):
        bench.states, bench.rng = [], np.random.default_rng(3)
        bench.record(name, "disc", colour=colour)
        device = bench.model({f"{PZT}.c33": "2 %", f"{PZT}.eps33": "2 %"})
        _, base, _ = base_fit(device)
        effect = next(e for e in device.effects if e.name == "resistance of leads and contacts")
        fit = refit(device, (effect,), base.x, scores_at(device, base.search, base.x, base.here, [effect]))
        assert fit is not None
        widths.append(fit.error["bench.series_resistance"])
        correlations.append(fit.correlation * max(1.0, fit.reduced))
    assert correlations[0] == pytest.approx(1.0, abs=0.2)
    assert correlations[1] > 4.0
    # The tangents are the same but for where the two fits ended.
    assert widths[1] / widths[0] == pytest.approx((correlations[1] / correlations[0]) ** 0.5, rel=0.05)


def test_what_the_reduced_model_does_to_a_fit_is_said(bench: Bench) -> None:
    """Bases that were made for another place, c33 one and a half per cent off."""
    bench.record("disc", "disc")
    device = bench.model({f"{PZT}.c33": "1 %"})
    _, base, _ = base_fit(device)
    _, off = checked(device, base)
    assert off < 1e-4
    strayed = base.x.copy()
    strayed[device.index(f"{PZT}.c33")] *= 1.015
    # Another model of the same device, which has grown nowhere else.
    device = bench.model({f"{PZT}.c33": "1 %"})
    device.fitted.cover(base.x, {}, 0.1)
    stale = replace(base, states=tuple(replace(state, impedance=impedance) for state, impedance in zip(
        base.states, device.fitted(strayed, deviation=device.deviations()).impedance, strict=True)), x=strayed)
    _, off = checked(device, stale)
    values, bench_there = device.fitted.settings(strayed, 0)
    exact, _, _ = through_bench(device.fitted.predictors[0].full(values, FREQUENCIES), 2.0 * np.pi * FREQUENCIES,
                                bench_there)
    print(f"off by {off:.2e}")
    assert off == pytest.approx(np.abs(stale.states[0].impedance / exact - 1.0).max(), rel=0.02)
    assert off > 1e-3


def test_a_search_stays_where_the_reduced_model_is_trusted(bench: Bench) -> None:
    """The recording is of a c33 that lies 4 % from where the bases were made."""
    bench.record("disc", "disc", factors={f"{PZT}.c33": 1.04})
    device = bench.model({f"{PZT}.c33": "5 %", f"{PZT}.c13": "5 %"})
    free, released = device.free(())
    search = Search(device.fitted, free=free, released=released)
    device.fitted.cover(search.centre, {}, UNNEEDED)
    anywhere = search.minimise(search.centre, device.deviations())
    trusted = 0.01 * search.evaluate(anywhere.x, device.deviations()).data.error
    found = search.minimise(search.centre, device.deviations(), trusted=trusted)
    error = search.evaluate(found.x, device.deviations()).data.error
    print(f"anywhere to {100.0 * trusted:.1e}, trusted to {error:.1e}")
    assert 0.1 * trusted < error <= trusted
    assert found.cost < search.minimise(search.centre, device.deviations(), limit=0).cost
    with pytest.raises(NotEnriched):
        search.minimise(anywhere.x, device.deviations(), trusted=trusted)
