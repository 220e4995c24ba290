"""The generator of concealed-effect trials: its solver against closed forms and reference spectra, and its folders."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from concealed import solver, trial
from concealed.design import draw, random_design
from concealed.device import STATES, body, seen
from concealed.mechanisms import CATALOGUED, MECHANISMS, OUTSIDE
from concealed.media import VACUUM_PERMITTIVITY, Bubbles, Liquid, Medium, Piezo, Solid, Viscous
from concealed.solver import Body, Box, Model, assemble, grid, spectrum, system
from numpy.typing import NDArray
from scipy.optimize import newton
from scipy.special import jn_zeros, jv

from workbench.spectrum import Spectrum

Real = NDArray[np.float64]

DENSITY, SPEED, VISCOSITY = 998.0, 1482.0, 1e-2


def test_a_plate_without_lateral_coupling_has_the_impedance_of_the_one_dimensional_theory() -> None:
    # With c12 = c13 = e31 = 0 nothing moves sideways, whatever the radius.
    density, c33, e33, eps33, height, radius = 7500.0, 1.2e11 - 4e8j, 16.0, 750.0 + 2.0j, 2e-3, 1e-3
    plate = Piezo(density, 1.3e11, 0.0, 0.0, c33, 2.2e10, 0.0, e33, 0.0, 760.0, eps33)
    frequency = np.linspace(0.8e6, 1.3e6, 101)
    found = spectrum(Body((Box(0.0, radius, 0.0, height, plate),), (height, 0.0, radius), (0.0, 0.0, radius)),
                     frequency, tolerance=1e-7)
    permittivity = eps33 * VACUUM_PERMITTIVITY
    stiffened = c33 + e33**2 / permittivity
    x = np.pi * frequency * height / np.sqrt(stiffened / density)
    capacitance = permittivity * math.pi * radius**2 / height
    expected = np.conj((1.0 - e33**2 / (stiffened * permittivity) * np.tan(x) / x)
                       / (-2j * np.pi * frequency * capacitance))
    # Fourth order, (k h / p)^(2 p) of a cell of half a shear wavelength, and the reduction's 1e-7.
    assert np.abs(found / expected - 1.0).max() < 1e-5


def mode(model: Model, start: complex) -> complex:
    """Angular frequency of the mode nearest to `start`, by Newton's method on its Rayleigh quotient."""
    from scipy import sparse
    from scipy.sparse.linalg import splu

    omega, rng = start, np.random.default_rng(1)
    x = rng.standard_normal(model.size - 1) + 0j
    for _ in range(8):
        matrix, scale = system(model, omega)  # type: ignore[arg-type]
        near, _ = system(model, omega * (1.0 + 1e-6))  # type: ignore[arg-type]
        diagonal = sparse.diags(scale)
        inner = (diagonal @ matrix[:-1, :-1] @ diagonal).tocsc()
        slope = (diagonal @ near[:-1, :-1] @ diagonal - inner) / (1e-6 * omega)
        x = splu(inner).solve(slope @ x)
        x /= np.linalg.norm(x)
        omega = omega - (x @ (inner @ x)) / (x @ (slope @ x))
    return complex(omega)


def vessel(radius: float, height: float, layer: float) -> Model:
    """A viscous fluid in a vessel too heavy and too stiff to move."""
    wall: Medium = Solid.isotropic(1e9, 1e17, 1e17)
    thick = 0.3 * height
    fluid = Viscous(DENSITY, SPEED, VISCOSITY, 0.0)
    lines = tuple(x for s in (2.5, 8.0) for x in (s * layer, height - s * layer))
    section = Body((Box(0.0, radius + thick, -thick, height + thick, wall), Box(0.0, radius, 0.0, height, fluid)),
                   (1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (), (radius - 2.5 * layer, radius - 8.0 * layer), lines)
    return assemble(section, grid(section, 0.5e6), order=5)


def test_between_plates_a_wave_has_the_damping_of_a_narrow_slit() -> None:
    radius, height = 2e-3, 100e-6
    rigid = SPEED * jn_zeros(1, 1)[0] / radius
    layer = math.sqrt(2.0 * VISCOSITY / (DENSITY * rigid))

    def dispersion(omega: complex) -> complex:
        # rho_eff = rho / (1 - tanh(s) / s), s = (1 - i) H / (2 delta) (PHYSICS: low reduced frequency).
        s = (1.0 - 1.0j) * height / 2.0 * np.sqrt(omega * DENSITY / (2.0 * VISCOSITY))
        bulk = SPEED**2 - 4j / 3.0 * omega * VISCOSITY / DENSITY
        return complex(omega**2 / bulk / (1.0 - np.tanh(s) / s) - (jn_zeros(1, 1)[0] / radius) ** 2)

    exact = complex(newton(dispersion, rigid * (1.0 - 0.02j)))
    found = mode(vessel(radius, height, layer), exact)
    quality = -found.real / (2.0 * found.imag)
    print(f"plates: Q {quality:.3f}, exact {-exact.real / (2.0 * exact.imag):.3f}, H / delta {height / layer:.2f}")
    # The slit's theory leaves out the layer where the wave meets the side wall, delta / R times small factors.
    assert abs(found.real / exact.real - 1.0) < 1e-3
    assert abs(found.imag / exact.imag - 1.0) < 1e-2
    assert abs(quality * layer / height - 1.0) < 0.05


def test_a_cylinder_has_the_damping_of_its_side_wall() -> None:
    radius, height = 0.3e-3, 1.5e-3
    rigid = SPEED * math.pi / height
    layer = math.sqrt(2.0 * VISCOSITY / (DENSITY * rigid))

    def dispersion(omega: complex) -> complex:
        # Kirchhoff's tube without heat: rho_eff = rho / (1 - 2 J1(b R) / (b R J0(b R))), b = (1 + i) / delta.
        b = (1.0 + 1.0j) * np.sqrt(omega * DENSITY / (2.0 * VISCOSITY)) * radius
        bulk = SPEED**2 - 4j / 3.0 * omega * VISCOSITY / DENSITY
        return complex(omega**2 / bulk / (1.0 - 2.0 * jv(1, b) / (b * jv(0, b))) - (math.pi / height) ** 2)

    exact = complex(newton(dispersion, rigid * (1.0 - 0.01j)))
    found = mode(vessel(radius, height, layer), exact)
    quality = -found.real / (2.0 * found.imag)
    print(f"cylinder: Q {quality:.3f}, exact {-exact.real / (2.0 * exact.imag):.3f}, r / delta {radius / layer:.2f}")
    assert abs(found.real / exact.real - 1.0) < 1e-3
    assert abs(found.imag / exact.imag - 1.0) < 1e-2
    assert abs(quality * layer / radius - 1.0) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rms"), [("free_disc_fitted_rho7500", 1e-3), ("disc_gel_PLA", 1e-3)])
def test_the_spectra_are_those_of_a_third_solver(
    name: str, rms: float, reference_spectrum: Callable[[str], Spectrum]
) -> None:
    # Stated error of the reference: about 0.1 % in Z.
    reference = reference_spectrum(name)
    data = json.loads((Path(__file__).parent / "data" / "reference" / f"{name}.json").read_text(encoding="utf-8"))
    constants = ("C11", "C12", "C13", "C33", "C44", "e31", "e33", "e15", "eps11", "eps33")
    ceramic = Piezo(data["pzt"]["rho"], *(complex(data["pzt"][k], data["pzt"].get(f"{k}i", 0.0)) for k in constants))
    height, radius = 2.02e-3, 12.5e-3
    boxes = [Box(0.0, radius, 0.0, height, ceramic)]
    if name == "disc_gel_PLA":
        (gel,), (pla,) = data["fluids"].values(), data["solids"].values()
        boxes += [Box(0.0, radius, height, height + 20e-6, Liquid(gel["rho"], gel["c"])),
                  Box(0.0, 13e-3, height + 20e-6, height + 1.02e-3,
                      Solid.isotropic(pla["rho"], complex(*pla["K"]), complex(*pla["G"])))]
    # Every fourth point: what is tested is the model, and a reduced model costs solves, not points.
    frequency = reference.frequency[::4]
    section = Body(tuple(boxes), (height, 0.0, radius), (0.0, 0.0, radius))
    found = spectrum(section, frequency, order=5, per_wavelength=1.6, tolerance=1e-4)
    error = np.abs(np.log(found / reference.impedance[::4]))
    print(f"{name}: rms {100 * np.sqrt(np.mean(error**2)):.3f} %, worst {100 * error.max():.2f} %")
    assert np.sqrt(np.mean(error**2)) < rms


def test_small_bubbles_are_the_limit_of_resonant_ones_and_take_energy() -> None:
    omega = 2.0 * np.pi * np.array([50.0, 1e6])
    # A bubble of 5 mm resonates at 650 Hz, and its thermal layer is 0.37 mm at 50 Hz: adiabatic but for a tenth.
    adiabatic = Bubbles(1e-4, 0.0, DENSITY, SPEED, 1e-3).compressibility(omega)
    large = Bubbles(1e-4, 5e-3, DENSITY, SPEED, 1e-3).compressibility(omega)
    assert large[0].real == pytest.approx(adiabatic[0].real, rel=0.1)
    # e^{-i w t}: a lossy compressibility has a positive imaginary part.
    assert (Bubbles(1e-6, 3e-6, DENSITY, SPEED, 1e-3).compressibility(omega).imag > 0.0).all()


def test_detectability_is_what_no_parameter_imitates() -> None:
    rng = np.random.default_rng(2)
    tangents, noise = rng.standard_normal((50, 3)), 0.1

    def found(change: Real) -> float:
        return trial.detectability(lambda moves: change - tangents @ moves, lambda _: tangents, 3, noise)

    # A parameter moved by its prior costs at most one standard deviation, however far the spectrum moves.
    assert found(tangents[:, 0]) < 1.0
    normal = np.linalg.svd(tangents, full_matrices=True)[0][:, 3]
    assert found(normal) == pytest.approx(1.0 / noise, rel=1e-12)
    assert found(normal + 5.0 * tangents[:, 1]) < 1.0 / noise + 5.0


def test_an_imitation_is_found_where_tangents_do_not_reach() -> None:
    rng = np.random.default_rng(2)
    first, noise = rng.standard_normal((50, 3)), 0.1
    normal = np.linalg.svd(first, full_matrices=True)[0][:, 3]

    def spectrum(moves: Real) -> Real:
        return np.asarray(first @ moves + 0.5 * moves[0] ** 2 * normal)

    def tangents(moves: Real) -> Real:
        return first + np.outer(moves[0] * normal, [1.0, 0.0, 0.0])

    concealed = spectrum(np.array([1.0, 0.0, 0.0]))
    # The tangents leave half of the normal, five standard deviations; the parameter itself costs one.
    assert trial.detectability(lambda moves: concealed - first @ moves, lambda _: first, 3, noise) > 5.0
    assert trial.detectability(lambda moves: concealed - spectrum(moves), tangents, 3, noise) < 1.0


@pytest.mark.slow
def test_what_known_parameters_do_is_imitated_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver, "CELLS", 1.0)
    design = random_design(np.random.default_rng(4), points=41)
    plain, priors = draw(np.random.default_rng(5), design), design.prior
    device = trial.Device(design)
    state = next(s for s in STATES if s.filling == "disc")
    moved = {**plain, **{name: plain[name] + 1.5 * priors[name] for name in ("pzt/trial.c33", "transducer.thickness")}}

    def at(moves: Real) -> dict[str, float]:
        return {**plain, **{name: plain[name] + move * prior
                            for move, (name, prior) in zip(moves.tolist(), priors.items(), strict=True)}}

    def change(moves: Real) -> Real:
        log = np.log(device.spectrum(moved, {}, state) / device.spectrum(at(moves), {}, state))
        return np.concatenate([log.real, log.imag])

    whole = float(np.linalg.norm(change(np.zeros(len(priors))))) / design.noise
    left = trial.detectability(change, lambda moves: device.tangents(at(moves), {}, state), len(priors), design.noise)
    print(f"thickness and stiffness: {whole:.0f} standard deviations, {left:.2f} of them left")
    assert whole > 200.0
    # Moved back by their priors, they cost no more than that.
    assert left < 1.5 * np.sqrt(2.0)


def test_there_are_enough_mechanisms() -> None:
    assert len(CATALOGUED) >= 16
    assert len(OUTSIDE) >= 3
    assert not set(CATALOGUED) & set(OUTSIDE)
    with pytest.raises(ValueError, match="'gremlins' is not one of none, fluid_absorption"):
        trial.make_trial(1, "gremlins", Path("nowhere"))


#: States in which a mechanism leaves the impedance alone; those of the bench and the transducer act in all.
SPARED = {"cavity": ("disc", "empty"), "couplant": ("disc",), "substrate": ("disc",), "bond": ("disc",)}


@pytest.mark.slow
@pytest.mark.parametrize("name", [*CATALOGUED, *OUTSIDE])
def test_a_mechanism_acts_where_it_sits_and_gives_no_energy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver, "CELLS", 1.0)
    design = random_design(np.random.default_rng(3))
    effect = {**CATALOGUED, **OUTSIDE}[name](np.random.default_rng(5), design, design.nominal)
    frequency = design.frequency[60:61]
    for state in STATES[:3]:
        seen_by = []
        for values, defects in ((design.nominal, {}), ({**design.nominal, **effect.values}, effect.defects)):
            section = body(values, defects, state)
            model = assemble(section, grid(section, frequency[0]), order=3)
            own = np.conj([solver.solve(model, frequency[0])[0]])
            assert own[0].real > 0.0
            seen_by.append(seen(values, defects, state, frequency, own)[0])
        if state.name in SPARED.get(effect.region, ()):
            assert seen_by[0] == seen_by[1]
        elif state.name == "filled":
            assert abs(seen_by[1] / seen_by[0] - 1.0) > 1e-5


@pytest.fixture(scope="module")
def coarse_trials(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, trial.Truth]]:
    """Three trials of one device on a mesh too coarse for anything but the files."""
    before = trial.ORDER, trial.TOLERANCE, solver.CELLS
    trial.ORDER, trial.TOLERANCE, solver.CELLS = 2, 3e-2, 1.0
    try:
        made = {}
        for name in ("none", "bench_resistance", "fluid_absorption"):
            folder = tmp_path_factory.mktemp("trials") / "one"
            made[name] = (folder, trial.make_trial(7, name, folder, points=41))
    finally:
        trial.ORDER, trial.TOLERANCE, solver.CELLS = before
    return made


def test_the_folder_tells_nothing_but_by_its_spectra(coarse_trials: dict[str, tuple[Path, trial.Truth]]) -> None:
    plain = coarse_trials["none"][0]
    files = sorted(p.relative_to(plain) for p in plain.rglob("*") if p.is_file())
    for name, (folder, truth) in coarse_trials.items():
        assert sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file()) == files
        assert truth.mechanism == (name,)
        for file in files:
            text = (folder / file).read_text(encoding="utf-8")
            if file.suffix != ".csv":
                assert text == (plain / file).read_text(encoding="utf-8")
            assert not any(word in text for word in (*MECHANISMS, "seed", "truth", "conceal"))
    spectra = [(folder / "disc.csv").read_text(encoding="utf-8") for folder, _ in coarse_trials.values()]
    assert len(set(spectra)) == 2, "absorption in the cavity must leave the disc alone, and a resistance must not"


def test_the_truth_is_told_to_whoever_asked(coarse_trials: dict[str, tuple[Path, trial.Truth]]) -> None:
    truth = coarse_trials["bench_resistance"][1]
    (told,) = json.loads(json.dumps(truth.to_dict()))["effects"]
    assert (told["name"], told["region"]) == ("bench series resistance", "bench")
    assert told["parameters"]["bench.series_resistance"] == truth.values["bench.series_resistance"]
    assert told["detectability"] == pytest.approx(truth.detectability)
    assert coarse_trials["none"][1].effects == ()
    assert {state.name for state in STATES if state.held_out} == {"filled_again"}
