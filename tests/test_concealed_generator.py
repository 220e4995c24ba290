"""The generator of concealed-effect trials: its solver against closed forms and reference spectra, and its folders."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from concealed import detection, folder, response, section, solver, trial
from concealed.design import BETWEEN, draw, draw_own, random_design
from concealed.device import DRIVES, FILLINGS, STATES, THIN, body, seen, swept
from concealed.mechanisms import CATALOGUED, DRAWS, MECHANISMS, OUTSIDE
from concealed.media import VACUUM_PERMITTIVITY, Bubbles, Hold, Liquid, Medium, Necks, Piezo, Solid, Viscous
from concealed.section import Body, Box, Face, grid
from concealed.solver import Model, assemble, spectrum, system
from numpy.typing import NDArray
from scipy.optimize import newton
from scipy.special import jn_zeros, jv

from geometry.chip import read_chip
from geometry.shapes import with_shapes
from materials.registry import Registry
from workbench.fem.operators import assemble as assemble_theirs
from workbench.fem.solve import solve_full
from workbench.model.problem import build, fill
from workbench.results.spectrum import Spectrum

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


def test_a_plate_held_at_one_face_has_the_impedance_of_the_one_dimensional_theory() -> None:
    density, c33, e33, eps33, height, radius = 7500.0, 1.2e11 - 4e8j, 16.0, 750.0 + 2.0j, 2e-3, 1e-3
    plate = Piezo(density, 1.3e11, 0.0, 0.0, c33, 2.2e10, 0.0, e33, 0.0, 760.0, eps33)
    frequency, spring = np.linspace(0.8e6, 1.3e6, 101), 3e13 * (1.0 - 0.1j)
    found = spectrum(Body((Box(0.0, radius, 0.0, height, plate),), (height, 0.0, radius), (0.0, 0.0, radius),
                          (Face(0.0, radius, 0.0, 0.0, Hold(spring, 0.0)),)), frequency, tolerance=1e-7)
    # u = A cos kz + B sin kz, T = c u' - (e / eps) D, T(0) = K u(0), T(h) = 0, V = D h / eps - (e / eps) (u(h) - u(0)).
    permittivity = eps33 * VACUUM_PERMITTIVITY
    coupling, stiffened = e33 / permittivity, c33 + e33**2 / permittivity
    k = 2.0 * np.pi * frequency * np.sqrt(density / stiffened)
    cosine, sine = np.cos(k * height), np.sin(k * height)
    a = coupling * (1.0 - cosine) / (spring * cosine - stiffened * k * sine)
    stretch = a * (cosine - 1.0) + (spring * a + coupling) / (stiffened * k) * sine
    expected = np.conj((height / permittivity - coupling * stretch)
                       / (-2j * np.pi * frequency * math.pi * radius**2))
    # As for the free plate.
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


def vessel(radius: float, height: float, layer: float, necks: Necks | None = None, *, open_above: bool = False
           ) -> Model:
    """A viscous fluid in a vessel too heavy and too stiff to move, with necks in its side wall or without, or open."""
    wall: Medium = Solid.isotropic(1e9, 1e17, 1e17)
    thick = 0.3 * height
    fluid = Viscous(DENSITY, SPEED, VISCOSITY, 0.0)
    lines = tuple(x for s in (2.5, 8.0) for x in (s * layer, height - s * layer))
    faces = () if necks is None else (Face(radius, radius, 0.0, height, necks),)
    nothing = (Box(0.0, radius, height, height + thick, None),) if open_above else ()
    section = Body((Box(0.0, radius + thick, -thick, height + thick, wall), Box(0.0, radius, 0.0, height, fluid),
                    *nothing),
                   (1.0, 0.0, 0.0), (1.0, 0.0, 0.0), faces, (radius - 2.5 * layer, radius - 8.0 * layer), lines)
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


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_necks_in_the_side_wall_take_what_they_let_pass(share: float) -> None:
    radius, height = 2e-3, 100e-6
    rigid = SPEED * jn_zeros(1, 1)[0] / radius
    necks = Necks(share, DENSITY, 4e-4, 2e5, 0.0)

    def dispersion(omega: complex) -> complex:
        # In the slit rho_eff w^2 u = grad p, p = J0(k r); at the wall u = share p / (-w^2 m - i w R).
        s = (1.0 - 1.0j) * height / 2.0 * np.sqrt(omega * DENSITY / (2.0 * VISCOSITY))
        slit = 1.0 - np.tanh(s) / s
        k = omega / np.sqrt((SPEED**2 - 4j / 3.0 * omega * VISCOSITY / DENSITY) * slit)
        passed = share / (-(omega**2) * DENSITY * necks.length - 1j * omega * necks.resistance)
        return complex(k * jv(1, k * radius) * slit / (DENSITY * omega**2) + passed * jv(0, k * radius)) * 1e12

    exact = complex(newton(dispersion, rigid * (1.0 - 0.02j)))
    found = mode(vessel(radius, height, math.sqrt(2.0 * VISCOSITY / (DENSITY * rigid)), necks), exact)
    print(f"necks: shift {exact.real / rigid - 1.0:+.4f}, damping {exact.imag / exact.real:.5f}, "
          f"found {found.real / rigid - 1.0:+.4f}, {found.imag / found.real:.5f}")
    # As for the slit; and the fluid does not slip along the wall that it passes, within a layer of the side wall.
    assert abs(found.real / exact.real - 1.0) < 1e-3
    assert abs(found.imag / exact.imag - 1.0) < 1e-2


@pytest.mark.parametrize("open_above", [False, True])
def test_a_cylinder_has_the_damping_of_its_side_wall(open_above: bool) -> None:
    # Half a wave between lids, a quarter below a free surface.
    radius, height = 0.3e-3, 0.75e-3 if open_above else 1.5e-3
    along = 0.5 * math.pi / height if open_above else math.pi / height
    rigid = SPEED * along
    layer = math.sqrt(2.0 * VISCOSITY / (DENSITY * rigid))

    def dispersion(omega: complex) -> complex:
        # Kirchhoff's tube without heat: rho_eff = rho / (1 - 2 J1(b R) / (b R J0(b R))), b = (1 + i) / delta.
        b = (1.0 + 1.0j) * np.sqrt(omega * DENSITY / (2.0 * VISCOSITY)) * radius
        bulk = SPEED**2 - 4j / 3.0 * omega * VISCOSITY / DENSITY
        return complex(omega**2 / bulk / (1.0 - 2.0 * jv(1, b) / (b * jv(0, b))) - along**2)

    exact = complex(newton(dispersion, rigid * (1.0 - 0.01j)))
    found = mode(vessel(radius, height, layer, open_above=open_above), exact)
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
        return detection.detectability(lambda moves: change - tangents @ moves, lambda _: tangents, 3,
                                       noise**2 * np.eye(50))

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
    white = noise**2 * np.eye(50)
    assert detection.detectability(lambda moves: concealed - first @ moves, lambda _: first, 3, white) > 4.9
    assert detection.detectability(lambda moves: concealed - spectrum(moves), tangents, 3, white) < detection.LOW
    # What the covariance holds costs nothing: the parameter alone is left.
    wide = white + 1e3 * np.outer(normal, normal)
    assert detection.detectability(lambda moves: concealed - first @ moves, lambda _: first, 3, wide) < 1.01


def test_an_imitation_goes_no_further_than_there_are_devices() -> None:
    rng = np.random.default_rng(2)
    slopes, refused = rng.standard_normal((50, 3)), []
    concealed = slopes @ np.array([28.0, 0.0, 0.0]) + rng.standard_normal(50)

    def change(moves: Real) -> Real:
        if np.abs(moves).max() > 15.0:
            refused.append(moves)
            raise solver.NotAccurate("relative residual nan")
        return np.asarray(concealed - slopes @ moves)

    found = detection.detectability(change, lambda _: slopes, 3, np.eye(50))
    free = detection.detectability(lambda moves: concealed - slopes @ moves, lambda _: slopes, 3, np.eye(50))
    assert refused
    # Never more than a linear device would leave.
    assert found == pytest.approx(free, rel=1e-2)


@pytest.mark.slow
def test_what_known_parameters_do_is_imitated_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(section, "CELLS", 1.0)
    design = random_design(np.random.default_rng(4), points=41)
    plain, priors = draw(np.random.default_rng(5), design), design.prior
    device = response.Device(design, order=3)
    state = next(s for s in STATES if s.filling == "disc")
    moved = {**plain, **{name: plain[name] + 1.5 * priors[name] for name in ("pzt/trial.c33", "transducer.thickness")}}
    spectra = {"disc": device.spectrum(moved, {}, state)}
    without = detection.Bystander(device, plain, {}, (state,), {"disc": {}})
    nothing = np.zeros(len(detection.unknowns(device, (state,))))
    whole = float(np.linalg.norm(without.rest(spectra, nothing))) / design.noise
    left = without.detectability(spectra)
    print(f"thickness and stiffness: {whole:.0f} standard deviations, {left:.2f} of them left")
    assert whole > 200.0
    # Moved back by their priors, they cost no more than that.
    assert left < 1.5 * np.sqrt(2.0)


def test_there_are_enough_mechanisms() -> None:
    assert len(CATALOGUED) >= 16
    assert len(OUTSIDE) >= 5
    assert not set(CATALOGUED) & set(OUTSIDE)
    with pytest.raises(ValueError, match="'gremlins' is not one of none, fluid_absorption"):
        trial.make_trial(1, "gremlins", Path("nowhere"))


#: States in which a mechanism leaves the impedance alone; those of the bench and the transducer act in all.
SPARED = {"cavity": ("disc", "empty"), **dict.fromkeys(("couplant", "substrate", "sidewall", "bond", "superstrate"),
                                                       ("disc",))}


@pytest.mark.slow
@pytest.mark.parametrize("name", DRAWS)
def test_a_mechanism_acts_where_it_sits_and_gives_no_energy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(section, "CELLS", 1.0)
    design = random_design(np.random.default_rng(3))
    effect = DRAWS[name](np.random.default_rng(5), design, design.nominal)
    middle = design.frequency[120:121]
    for state in STATES[:3]:
        seen_by = []
        for values, defects in ((design.nominal, {}), ({**design.nominal, **effect.values}, effect.defects)):
            section_of = body(values, defects, state)
            model = assemble(section_of, grid(section_of, middle[0]), order=3)
            frequency = swept(values, defects, state, middle)
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
    before = response.ORDER, response.TOLERANCE, section.CELLS
    response.ORDER, response.TOLERANCE, section.CELLS = 2, 3e-2, 1.0
    try:
        made = {}
        for name in ("none", "bench_resistance", "fluid_absorption"):
            into = tmp_path_factory.mktemp("trials") / "one"
            made[name] = (into, trial.make_trial(7, name, into, points=41))
    finally:
        response.ORDER, response.TOLERANCE, section.CELLS = before
    return made


def test_the_folder_tells_nothing_but_by_its_spectra(coarse_trials: dict[str, tuple[Path, trial.Truth]]) -> None:
    plain = coarse_trials["none"][0]
    files = sorted(p.relative_to(plain) for p in plain.rglob("*") if p.is_file())
    for name, (into, truth) in coarse_trials.items():
        assert sorted(p.relative_to(into) for p in into.rglob("*") if p.is_file()) == files
        assert truth.mechanism == (name,)
        for file in files:
            text = (into / file).read_text(encoding="utf-8")
            if file.suffix != ".csv":
                assert text == (plain / file).read_text(encoding="utf-8")
            assert not any(word in text for word in (*MECHANISMS, "seed", "truth", "conceal"))
    spectra = [(into / "disc.csv").read_text(encoding="utf-8") for into, _ in coarse_trials.values()]
    assert len(set(spectra)) == 2, "absorption in the cavity must leave the disc alone, and a resistance must not"


def test_the_truth_is_told_to_whoever_asked(coarse_trials: dict[str, tuple[Path, trial.Truth]]) -> None:
    truth = coarse_trials["bench_resistance"][1]
    (told,) = json.loads(json.dumps(truth.to_dict()))["effects"]
    assert (told["name"], told["region"]) == ("bench series resistance", "bench")
    assert told["parameters"]["bench.series_resistance"] == truth.values["bench.series_resistance"]
    assert told["detectability"] == pytest.approx(truth.detectability)
    assert coarse_trials["none"][1].effects == ()
    assert {state.name for state in STATES if state.held_out} == {"filled_again"}


def test_the_set_of_states_does_not_give_the_mechanism_away() -> None:
    sets = [trial.states_of(np.random.default_rng([1, k]), ("gel_bubbles",)) for k in range(600)]
    # A third, within three standard deviations of 600 draws.
    assert sum(s == DRIVES for s in sets) / 600 == pytest.approx(1.0 / 3.0, abs=0.06)
    for k in range(20):
        assert trial.states_of(np.random.default_rng([1, k]), ("softening", "water_uptake")) == DRIVES
        assert trial.states_of(np.random.default_rng([1, k]), ("water_uptake",)) == FILLINGS
    for states in (FILLINGS, DRIVES):
        assert sum(not s.held_out for s in states) == 3
        assert [s.temperature for s in states if s.held_out] == [308.15]


def test_designs_are_tied_and_differ_between_states_as_they_say() -> None:
    designs = [random_design(np.random.default_rng(k)) for k in range(400)]
    assert sum(d.remounted for d in designs) / 400 == pytest.approx(0.3, abs=0.07)
    assert {d.tied for d in designs} == {(), ("couplant.radius",), ("substrate.radius",),
                                         ("couplant.radius", "substrate.radius")}
    for design in designs:
        radius, cavity = design.nominal["transducer.radius"], design.nominal["cavity.radius"]
        assert 1e-3 <= cavity <= 3e-3
        assert cavity < design.nominal["couplant.radius"] <= radius <= design.nominal["substrate.radius"]
        truth = draw(np.random.default_rng(1), design)
        assert all(truth[name] == truth["transducer.radius"] for name in design.tied)
        own = draw_own(np.random.default_rng(1), design, {s.name: s.filling for s in STATES})
        assert ("couplant.thickness" in own["empty"]) == design.remounted
        assert set(own["disc"]) == {"bench.gain", "bench.series_resistance", "bench.clock"}
    drawn = [draw_own(np.random.default_rng(k), designs[0], {"disc": "disc"})["disc"] for k in range(2000)]
    for name, size in BETWEEN.items():
        # Cut at two and a half standard deviations, a normal number has 0.95 of its own.
        assert np.std([d[name] for d in drawn]) == pytest.approx(0.95 * size, rel=0.06)


def test_gel_mounted_anew_is_said(tmp_path: Path) -> None:
    for k in range(8):
        design = random_design(np.random.default_rng(k), points=41)
        flat = {s.name: np.full(41, 100.0 - 50.0j) for s in FILLINGS}
        folder.write(tmp_path / str(k), design, FILLINGS, flat, np.random.default_rng(1))
        text = (tmp_path / str(k) / "campaign.toml").read_text(encoding="utf-8")
        assert ('[between]\n"couplant.thickness" = "10 %"' in text) == design.remounted
        # What every bench has is not said.
        assert "clock" not in text


def test_constants_fitted_with_a_wrong_density_do_not_show_in_the_disc(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(section, "CELLS", 1.0)
    design = random_design(np.random.default_rng(3), points=21)
    effect = CATALOGUED["density_gauge"](np.random.default_rng(5), design, design.nominal)
    assert 5e-3 <= abs(effect.parameters["transducer.gauge"]) <= 6e-2
    device = response.Device(design, order=3, tolerance=1e-9)
    disc, empty = (np.log(device.spectrum({**design.nominal, **effect.values}, {}, state)
                          / device.spectrum(design.nominal, {}, state)) for state in FILLINGS[:2])
    # Density, stiffness and the square of e have one factor: the disc moves less, and as much current flows.
    assert np.abs(disc).max() < 1e-7
    assert np.abs(empty).max() > 1e-3


def volume(model: Model, medium: type) -> float:
    """Volume (m^3) of what is filled with a kind of fluid: the functions that stand for pressure add up to one."""
    return float(sum(block.matrices["compressibility"].sum() for block in model.blocks
                     if isinstance(block.medium, medium)))


def test_warped_cells_have_the_volume_of_their_shape() -> None:
    design = random_design(np.random.default_rng(5))
    values, filled = design.nominal, next(s for s in STATES if s.filling == "filled")
    a, c, wide = (values[f"{name}.radius"] for name in ("transducer", "couplant", "cavity"))
    bond, wall = values["bond.thickness"], values["sidewall.thickness"]
    top, outer = wide + math.tan(0.05) * wall, values["substrate.radius"]
    expected = {
        "sidewall.draft": (0.05, math.pi * (wall * (wide**2 + wide * top + top**2) / 3.0 + bond * top**2),
                           math.pi * c**2 * values["couplant.thickness"]),
        "superstrate.bow": (5e-6, math.pi * (wide**2 * (wall + bond + 5e-6) - 5e-6 * wide**4 / (2.0 * outer**2)),
                            math.pi * c**2 * values["couplant.thickness"]),
        "transducer.dome": (3e-6, math.pi * wide**2 * (wall + bond),
                            math.pi * (c**2 * (values["couplant.thickness"] - 3e-6) + 3e-6 * c**4 / (2.0 * a**2))),
        "sidewall.barrel": (5e-5, math.pi * wide**2 * (wall + bond), math.pi * c**2 * values["couplant.thickness"]),
    }
    for name, (size, water, gel) in expected.items():
        section = body(values, {name: size}, filled)
        model = assemble(section, grid(section, float(design.frequency[-1]), per_wavelength=0.5), order=4)
        assert volume(model, Viscous) == pytest.approx(water, rel=1e-12), name
        assert volume(model, Liquid) == pytest.approx(gel, rel=1e-12), name


def test_what_happens_in_labs_leaves_the_liquid_that_it_says() -> None:
    design = random_design(np.random.default_rng(5))
    values, filled = design.nominal, next(s for s in STATES if s.filling == "filled")
    radius, height = values["cavity.radius"], values["sidewall.thickness"] + values["bond.thickness"]
    inner, outer = 0.3 * radius, 0.5 * radius
    for defects, expected in (
        ({"fill.share": 0.7}, math.pi * radius**2 * 0.7 * height),
        ({"bubble.inner": inner, "bubble.outer": outer}, math.pi * (radius**2 * height - THIN * (outer**2 - inner**2))),
    ):
        section = body(values, defects, filled)
        model = assemble(section, grid(section, float(design.frequency[-1]), per_wavelength=0.5), order=4)
        assert volume(model, Viscous) == pytest.approx(expected, rel=1e-12)


def test_a_disc_with_a_dome_is_that_of_the_workbench(tmp_path: Path) -> None:
    design = random_design(np.random.default_rng(5), points=21)
    folder.write(tmp_path, design, FILLINGS[:1], {"disc": np.ones(21, dtype=complex)}, np.random.default_rng(1))
    frequency, disc = design.frequency[[4, 10, 16]], FILLINGS[0]
    known = Registry((tmp_path / "materials",))
    changes = []
    for dome in (0.0, 5e-6):
        section = body(design.nominal, {"transducer.dome": dome}, disc)
        model = assemble(section, grid(section, float(design.frequency[-1])))
        ours = np.array([solver.solve(model, each)[0] for each in frequency])
        chip = with_shapes(read_chip(tmp_path / "disc.toml"), ["transducer.dome"])
        made = build(fill(chip.with_dimensions({"transducer.dome": dome}), None, known), accuracy=2e-4,
                     band=(float(design.frequency[0]), float(design.frequency[-1])))
        theirs = solve_full(assemble_theirs(made.mesh, made.terms), frequency, made.values).impedance
        changes.append((ours, theirs))
    (flat, flat_there), (bent, bent_there) = changes
    effect = np.log(bent / flat)
    assert np.abs(effect).max() > 0.1
    # 8e-7 of the effect measured; the reference is good for 1e-6 of Z.
    assert np.abs(effect - np.log(bent_there / flat_there)).max() < 1e-5 * np.abs(effect).max()
