"""A fit from Python: recording and chip in, material out.

    found = fit(read_recording("disc.csv"), read_chip("disc.toml"), "pzt")
    found.values, found.findings
    found.save("pzt_mine/disc_7")
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geometry.chip import Chip
from materials.kinds import Material
from materials.registry import Registry, user_folder, user_registry
from materials.saving import save_fit
from workbench.fitting import joint
from workbench.fitting.joint import FitResult
from workbench.fitting.multistart import TRIES
from workbench.fitting.prepare import DEFAULT, Prepared, material_starts, other_ceramics, prepare
from workbench.fitting.record import Source, file_digest, refusals, registry_entry, tried
from workbench.jobs.progress import Progress, no_progress
from workbench.model.discretisation import ACCURACY, Discretisation
from workbench.readers import Reading
from workbench.results.notebook import Shown, Summary
from workbench.results.spectrum import Spectrum

if TYPE_CHECKING:
    import xarray

class NotAccepted(RuntimeError):
    """Saving of a rejected fit without `force`; ``reasons`` say why."""

    def __init__(self, reasons: tuple[str, ...]) -> None:
        super().__init__("; ".join(reasons) + "; force=True saves it all the same")
        self.reasons = reasons


@dataclass(frozen=True, eq=False, repr=False)
class MaterialFit(Shown):
    """A material fitted to a recording: ``result``, ``prepared`` input, and ``source`` files."""

    result: FitResult
    prepared: Prepared
    source: Source

    @property
    def values(self) -> dict[str, float]:
        """The fitted numbers (SI) by parameter name."""
        return {each.parameter.name: each.value for each in self.result.estimates}

    @property
    def findings(self) -> tuple[str, ...]:
        """Findings of the fit, in plain statements."""
        return self.result.findings

    @property
    def reasons_against(self) -> tuple[str, ...]:
        """Reasons not to trust the fit; empty if there are none."""
        return refusals(self.result)

    @property
    def spectrum(self) -> Spectrum:
        """The fitted spectrum, at the frequencies of the recording."""
        return self.result.recordings[0].fitted

    @property
    def material(self) -> Material:
        """The freed material with fitted values, intervals and sources."""
        temperature = self.prepared.chip.state(self.prepared.state).temperature
        return registry_entry(self.result, self.prepared, [self.source], date=datetime.now(UTC),
                              forced=bool(self.reasons_against), temperature=temperature)

    def save(self, name: str, *, folder: Path | str | None = None, force: bool = False) -> str:
        """Save the material as the next version of `name` in a folder. By default it is the user's own.

        Returns:
            the name it is kept under, such as ``"pzt_mine/disc_7@1"``.

        Raises:
            NotAccepted: there are reasons against the fit, and `force` is not set.
            InputError: a name that no material can have.
        """
        if self.reasons_against and not force:
            raise NotAccepted(self.reasons_against)
        return save_fit(self.material, name, folder=user_folder() if folder is None else Path(folder))

    def summary(self) -> Summary:
        """Values, intervals, and reasons not to trust the fit, for a notebook."""
        match = self.result.recordings[0]
        rows = [("parameter", "value", "95 % interval", "unit")]
        rows += [(e.parameter.name, f"{e.value:.5g}", f"{e.low:.5g} to {e.high:.5g}" if math.isfinite(e.low) else "",
                  e.parameter.unit) for e in self.result.estimates]
        rows.append(("MAPE of |Z|", f"{match.after.mape_percent:.3g} %",
                     f"before {match.before.mape_percent:.3g} %", ""))
        rows += [("not accepted", reason, "", "") for reason in self.reasons_against]
        return Summary(f"{self.prepared.material.name}, fitted to {match.name}", tuple(rows),
                       {"measured": match.measured, "fitted": match.fitted}, ("measured",))

    def to_xarray(self) -> xarray.Dataset:
        """Values, 95 % intervals, standard errors (SI) and ``correlation`` over ``parameter``."""
        import xarray

        estimates = self.result.estimates
        names = [each.parameter.name for each in estimates]
        return xarray.Dataset(
            {**{key: ("parameter", np.array([getattr(each, key) for each in estimates]))
                for key in ("value", "low", "high", "standard_error")},
             "start": ("parameter", np.array([each.parameter.start for each in estimates])),
             "correlation": (("parameter", "other_parameter"), self.result.correlation)},
            {"parameter": names, "other_parameter": names,
             "unit": ("parameter", [each.parameter.unit for each in estimates])},
            {"mape_percent": self.result.recordings[0].after.mape_percent})


def fit(
    recording: Reading | Spectrum, chip: Chip, kind: str = "pzt", *, state: str | None = None,
    material: str | None = None, region: str | None = None, free: Sequence[str] = (DEFAULT,),
    band: tuple[float, float] | None = None, starts: Sequence[str] = (), registry: Registry | None = None,
    accuracy: float | Discretisation = ACCURACY, tries: int = TRIES, progress: Progress = no_progress,
) -> MaterialFit:
    """Fit a material to the recording of a device.

    Args:
        kind: "pzt" frees the constants of the transducer, "polymer" the moduli of the sample.
        state: of the chip; its last one by default.
        material: the start of the fit, in place of the chip's own material of that region.
        region: whose material is free, in place of the kind's own.
        free: names of parameters, such as ``c33``, ``c33.loss``, ``transducer.thickness``,
            ``bench.series_resistance``; "default" stands for the constants of a ceramic that the recording shows, or
            for the moduli of a sample.
        band: the part of the recording that is fitted, Hz; the chip's own by default.
        starts: further materials of the registry to start from: their values of the free parameters. All other
            ceramics of the registry are tried where the recording stays unexplained.
        registry: where materials are looked up; the package's and the user's own by default.
        accuracy: relative error of Z that the mesh is made for, or a discretisation of your own.
        tries: most further descents where the recording stays unexplained.

    Raises:
        InputError: a name that does not exist, too few points, or a recording that cannot be of this device.
        FitError: no start can be predicted.
        MeshError: the mesh cannot be made.
    """
    registry = user_registry() if registry is None else registry
    measured = recording if isinstance(recording, Spectrum) else recording.spectrum
    findings = () if isinstance(recording, Spectrum) else tuple(each.message for each in recording.findings)
    name = Path(measured.origin.source).stem or "recording"
    prepared = prepare(chip, registry, kind=kind, name=name, measured=measured, state=state, material=material,
                       region=region, free=free, band=band, accuracy=accuracy)
    result = joint.fit_parameters(
        prepared.recordings, prepared.parameters, coarse=prepared.coarse,
        starts=material_starts(prepared, registry, starts),
        others=material_starts(prepared, registry, other_ceramics(prepared, registry, starts)), tries=tries,
        progress=progress)
    result = tried(result, prepared, registry, tries, progress)
    # The digest of the content where there is no file.
    file, origin = Path(chip.file), measured.origin
    content = np.concatenate([measured.frequency, measured.impedance.real, measured.impedance.imag]).tobytes()
    described = file_digest(file) if file.is_file() else hashlib.sha256(repr(chip).encode()).hexdigest()
    return MaterialFit(result, prepared, Source(
        origin.source or "a spectrum of no file", origin.sha256 or hashlib.sha256(content).hexdigest(),
        chip.file or chip.name, described, findings))
