"""Acoustofluidic chip workbench: simulation, comparison with recordings, and diagnosis.

    import workbench as wb

    chip = wb.read_chip("geometry/chips/reference_chip.toml")
    run = wb.simulate(chip, "filled")
    recording = wb.read_recording("chip_filled.csv")
    print(wb.compare(recording, run).mape_percent)
    found = wb.diagnose(wb.read_campaign("campaign.toml"))

The names in :data:`PUBLIC` are the stable interface; everything else may change. A name is loaded at its first use, so
that importing the package is fast.

Data flows one way: ``Chip -> Section -> SectionMesh -> Problem -> Operators -> Solution -> Spectrum | Fields -> Figures
-> Comparison``. Each stage takes a frozen value and returns one.
"""

from __future__ import annotations

#: Version of the package, as in ``pyproject.toml``.
__version__ = "0.5.0"

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from geometry.chip import Chip as Chip
    from geometry.chip import read_chip as read_chip
    from geometry.chip_file import write_chip as write_chip
    from geometry.features import Feature as Feature
    from materials.registry import Registry as Registry
    from workbench.acoustics.captures import Window as Window
    from workbench.acoustics.captures import capture_statistics as capture_statistics
    from workbench.acoustics.captures import light_curve as light_curve
    from workbench.acoustics.heat import Heating as Heating
    from workbench.acoustics.trajectories import Trajectories as Trajectories
    from workbench.bench.setup import read_bench as read_bench
    from workbench.bench.sweep import measure as measure
    from workbench.campaign.campaign import Campaign as Campaign
    from workbench.campaign.campaign import read_campaign as read_campaign
    from workbench.design.evaluation import Evaluation as Evaluation
    from workbench.design.evaluation import Operation as Operation
    from workbench.design.goal import Goal as Goal
    from workbench.design.goal import read_goal as read_goal
    from workbench.design.input_uncertainty import stated_uncertainty as stated_uncertainty
    from workbench.design.model import DesignModel as DesignModel
    from workbench.design.model import design_model as design_model
    from workbench.design.model import full_evaluation as full_evaluation
    from workbench.design.optimisation import Design as Design
    from workbench.design.optimisation import optimise as optimise
    from workbench.design.plan import Study as Study
    from workbench.design.plan import read_study as read_study
    from workbench.design.study import study as study
    from workbench.design.study_result import StudyResult as StudyResult
    from workbench.design.tolerance import Tolerance as Tolerance
    from workbench.design.tolerance import tolerance as tolerance
    from workbench.diagnosis.appraisal import diagnose as diagnose
    from workbench.diagnosis.outcome import Diagnosis as Diagnosis
    from workbench.diagnosis.posterior import Posterior as Posterior
    from workbench.files.errors import InputError as InputError
    from workbench.fitting.recordings import MaterialFit as MaterialFit
    from workbench.fitting.recordings import fit as fit
    from workbench.instruments.simulated import SimulatedBench as SimulatedBench
    from workbench.model.drive import parse_drive as parse_drive
    from workbench.readers import Reading as Reading
    from workbench.readers import read_recording as read_recording
    from workbench.readers.energy_table import read_energy_recording as read_energy_recording
    from workbench.reduced.ranges import RangeModel as RangeModel
    from workbench.reduced.ranges import range_model as range_model
    from workbench.render.beads import draw_from_above as draw_from_above
    from workbench.render.gallery import draw_state as draw_state
    from workbench.render.plots import draw_spectra as draw_spectra
    from workbench.render.tolerances import draw_tolerance as draw_tolerance
    from workbench.results.circuit import CircuitFit as CircuitFit
    from workbench.results.circuit import FittedResonance as FittedResonance
    from workbench.results.circuit import bvd_impedance as bvd_impedance
    from workbench.results.circuit import fit_circuit as fit_circuit
    from workbench.results.comparison import Comparison as Comparison
    from workbench.results.comparison import compare as compare
    from workbench.results.energy_recording import EnergyRecording as EnergyRecording
    from workbench.results.merit import Figures as Figures
    from workbench.results.merit import figures as figures
    from workbench.results.resonances import fit_resonances as fit_resonances
    from workbench.results.spectrum import Spectrum as Spectrum
    from workbench.results.spectrum import write_spectrum as write_spectrum
    from workbench.simulation.beads import trajectories as trajectories
    from workbench.simulation.channel import channel_figures as channel_figures
    from workbench.simulation.dispersion import GuidedWaves as GuidedWaves
    from workbench.simulation.dispersion import dispersion as dispersion
    from workbench.simulation.energy_comparison import EnergyComparison as EnergyComparison
    from workbench.simulation.energy_comparison import compare_energy as compare_energy
    from workbench.simulation.finite_length import FiniteLength as FiniteLength
    from workbench.simulation.finite_length import finite_length as finite_length
    from workbench.simulation.heating import LiquidWarming as LiquidWarming
    from workbench.simulation.heating import heating as heating
    from workbench.simulation.heating import liquid_warming as liquid_warming
    from workbench.simulation.heating import thermal_resistances as thermal_resistances
    from workbench.simulation.liquid_motion import LiquidMotion as LiquidMotion
    from workbench.simulation.liquid_motion import liquid_motion as liquid_motion
    from workbench.simulation.modes import ChipMode as ChipMode
    from workbench.simulation.modes import ChipModes as ChipModes
    from workbench.simulation.modes import modes as modes
    from workbench.simulation.run import Simulation as Simulation
    from workbench.simulation.run import Snapshot as Snapshot
    from workbench.simulation.run import energy_spectrum as energy_spectrum
    from workbench.simulation.run import simulate as simulate
    from workbench.simulation.run import snapshot as snapshot
    from workbench.simulation.streaming import streaming as streaming
    from workbench.simulation.warm import WarmState as WarmState
    from workbench.simulation.warm import WarmUp as WarmUp

#: The public names and the modules that define them.
PUBLIC = {
    "Campaign": "workbench.campaign.campaign",
    "Chip": "geometry.chip",
    "CircuitFit": "workbench.results.circuit",
    "Comparison": "workbench.results.comparison",
    "Design": "workbench.design.optimisation",
    "DesignModel": "workbench.design.model",
    "Diagnosis": "workbench.diagnosis.outcome",
    "EnergyComparison": "workbench.simulation.energy_comparison",
    "EnergyRecording": "workbench.results.energy_recording",
    "Evaluation": "workbench.design.evaluation",
    "Feature": "geometry.features",
    "Figures": "workbench.results.merit",
    "FiniteLength": "workbench.simulation.finite_length",
    "FittedResonance": "workbench.results.circuit",
    "Goal": "workbench.design.goal",
    "GuidedWaves": "workbench.simulation.dispersion",
    "Heating": "workbench.acoustics.heat",
    "InputError": "workbench.files.errors",
    "LiquidMotion": "workbench.simulation.liquid_motion",
    "LiquidWarming": "workbench.simulation.heating",
    "MaterialFit": "workbench.fitting.recordings",
    "ChipMode": "workbench.simulation.modes",
    "ChipModes": "workbench.simulation.modes",
    "Operation": "workbench.design.evaluation",
    "Posterior": "workbench.diagnosis.posterior",
    "RangeModel": "workbench.reduced.ranges",
    "Reading": "workbench.readers",
    "Registry": "materials.registry",
    "SimulatedBench": "workbench.instruments.simulated",
    "Simulation": "workbench.simulation.run",
    "Snapshot": "workbench.simulation.run",
    "Spectrum": "workbench.results.spectrum",
    "Tolerance": "workbench.design.tolerance",
    "Trajectories": "workbench.acoustics.trajectories",
    "WarmState": "workbench.simulation.warm",
    "WarmUp": "workbench.simulation.warm",
    "Window": "workbench.acoustics.captures",
    "capture_statistics": "workbench.acoustics.captures",
    "light_curve": "workbench.acoustics.captures",
    "Study": "workbench.design.plan",
    "StudyResult": "workbench.design.study_result",
    "bvd_impedance": "workbench.results.circuit",
    "channel_figures": "workbench.simulation.channel",
    "compare": "workbench.results.comparison",
    "compare_energy": "workbench.simulation.energy_comparison",
    "design_model": "workbench.design.model",
    "diagnose": "workbench.diagnosis.appraisal",
    "dispersion": "workbench.simulation.dispersion",
    "draw_from_above": "workbench.render.beads",
    "draw_spectra": "workbench.render.plots",
    "draw_state": "workbench.render.gallery",
    "draw_tolerance": "workbench.render.tolerances",
    "figures": "workbench.results.merit",
    "finite_length": "workbench.simulation.finite_length",
    "fit": "workbench.fitting.recordings",
    "fit_circuit": "workbench.results.circuit",
    "fit_resonances": "workbench.results.resonances",
    "full_evaluation": "workbench.design.model",
    "heating": "workbench.simulation.heating",
    "liquid_motion": "workbench.simulation.liquid_motion",
    "liquid_warming": "workbench.simulation.heating",
    "measure": "workbench.bench.sweep",
    "modes": "workbench.simulation.modes",
    "optimise": "workbench.design.optimisation",
    "parse_drive": "workbench.model.drive",
    "range_model": "workbench.reduced.ranges",
    "read_bench": "workbench.bench.setup",
    "read_campaign": "workbench.campaign.campaign",
    "read_chip": "geometry.chip",
    "read_energy_recording": "workbench.readers.energy_table",
    "read_goal": "workbench.design.goal",
    "read_recording": "workbench.readers",
    "read_study": "workbench.design.plan",
    "energy_spectrum": "workbench.simulation.run",
    "simulate": "workbench.simulation.run",
    "snapshot": "workbench.simulation.run",
    "stated_uncertainty": "workbench.design.input_uncertainty",
    "streaming": "workbench.simulation.streaming",
    "study": "workbench.design.study",
    "thermal_resistances": "workbench.simulation.heating",
    "tolerance": "workbench.design.tolerance",
    "trajectories": "workbench.simulation.beads",
    "write_chip": "geometry.chip_file",
    "write_spectrum": "workbench.results.spectrum",
}

__all__ = sorted(PUBLIC)


def __getattr__(name: str) -> Any:
    """A public name, loaded from its module at first use."""
    if name not in PUBLIC:
        raise AttributeError(f"module 'workbench' has no attribute {name!r}; public are {', '.join(sorted(PUBLIC))}")
    import importlib

    found = getattr(importlib.import_module(PUBLIC[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), "PUBLIC", *PUBLIC})
