"""A spectrum of electrical impedance, measured or simulated.

Convention: the electrical engineer's e^{+j w t}, so a capacitor stands at -90 degrees. The solver works with e^{-i w
t}; :meth:`Spectrum.from_solver` is the one place where its impedance is conjugated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from workbench.files.errors import InputError
from workbench.files.names import visible
from workbench.files.quantities import frequency_text
from workbench.files.writing import write_atomic
from workbench.results.notebook import Shown, Summary
from workbench.results.signs import with_signs

if TYPE_CHECKING:
    import xarray

ORIGIN_KINDS = ("measured", "simulated", "unknown")

#: The columns of the workbench's own file; the last one is present only if the uncertainty is known.
CSV_COLUMNS = ("frequency_hz", "z_real_ohm", "z_imag_ohm")
UNCERTAINTY_COLUMN = "uncertainty_ohm"

#: The key of the line above the columns with the shared part of the uncertainty.
SHARED_UNCERTAINTY = "shared uncertainty"
#: The key of the line with the number of rows, which reveals a truncated file.
ROWS = "rows"


@dataclass(frozen=True)
class Origin:
    """The source of a spectrum.

    ``kind`` is "measured", "simulated" or "unknown"; ``source`` is the path of the recording as text, ``sha256`` the
    digest of its bytes, ``settings`` are further statements of the source (oscillator level, adapter, applied
    corrections). Every text is one line without surrounding blanks, so that a file can store it; control characters
    become escapes.

    Raises:
        ValueError: an unknown kind, or a text that a file cannot store.
    """

    kind: str = "unknown"
    source: str = ""
    sha256: str = ""
    instrument: str = ""
    date: str = ""
    settings: Mapping[str, str] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        if self.kind not in ORIGIN_KINDS:
            raise ValueError(f"origin kind {self.kind!r} is not one of {', '.join(ORIGIN_KINDS)}")
        for name in ("source", "sha256", "instrument", "date"):
            object.__setattr__(self, name, _one_line(getattr(self, name)))
        object.__setattr__(self, "settings", {_one_line(key): _one_line(text) for key, text in self.settings.items()})
        for text in (self.source, self.sha256, self.instrument, self.date, *self.settings, *self.settings.values()):
            if text != text.strip():
                raise ValueError(f"origin text {text!r} must not begin or end with blanks")
        for name in self.settings:
            if not name or ":" in name:
                raise ValueError(f"origin setting name {name!r} must not be empty or contain a colon")


def _one_line(text: str) -> str:
    return visible(text, keep="\t")


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum(Shown):
    """Impedance against frequency, e^{+j w t}.

    ``frequency`` (n,) Hz is strictly increasing and positive; ``impedance`` (n,) complex ohm is nowhere zero;
    ``uncertainty`` (n,) ohm or None is the standard uncertainty of the real part and of the imaginary part, each.
    ``shared_uncertainty`` is its common part relative to Z: one factor of all points, from a standard's tolerance or a
    gain. The arrays are copied and read-only. At least two points.

    Raises:
        ValueError: a condition above is violated; the message gives the index and the value.
    """

    frequency: NDArray[np.float64]
    impedance: NDArray[np.complex128]
    uncertainty: NDArray[np.float64] | None = None
    origin: Origin = field(default_factory=Origin)
    shared_uncertainty: float = 0.0

    def __post_init__(self) -> None:
        if np.iscomplexobj(self.frequency):
            raise ValueError("frequency must be real, received complex values")
        frequency = np.array(self.frequency, dtype=np.float64)
        impedance = np.array(self.impedance, dtype=np.complex128)
        if frequency.ndim != 1 or impedance.shape != frequency.shape:
            raise ValueError(
                f"frequency and impedance must be one-dimensional and of equal length, "
                f"received shapes {frequency.shape} and {impedance.shape}"
            )
        if frequency.size < 2:
            raise ValueError(f"a spectrum needs at least 2 points, received {frequency.size}")
        _refuse(~np.isfinite(frequency), frequency, "frequency", "finite")
        _refuse(~np.isfinite(impedance), impedance, "impedance", "finite")
        _refuse(frequency <= 0.0, frequency, "frequency", "positive")
        _refuse(impedance == 0.0, impedance, "impedance", "other than zero")
        falls = np.concatenate(([False], np.diff(frequency) <= 0.0))
        _refuse(falls, frequency, "frequency", "larger than the one before it")
        if self.uncertainty is not None:
            uncertainty = np.array(self.uncertainty, dtype=np.float64)
            if uncertainty.shape != frequency.shape:
                raise ValueError(f"uncertainty must have shape {frequency.shape}, received {uncertainty.shape}")
            _refuse(~(np.isfinite(uncertainty) & (uncertainty > 0.0)), uncertainty, "uncertainty", "finite, positive")
            uncertainty.flags.writeable = False
            object.__setattr__(self, "uncertainty", uncertainty)
        shared = self.shared_uncertainty
        if not 0.0 <= shared < 1.0 or (shared > 0.0 and self.uncertainty is None):
            raise ValueError(f"shared_uncertainty {shared!r} must be a share of Z from 0 to less than 1, and a part of "
                             "an uncertainty that is given")
        frequency.flags.writeable = False
        impedance.flags.writeable = False
        object.__setattr__(self, "frequency", frequency)
        object.__setattr__(self, "impedance", impedance)

    @classmethod
    def from_solver(
        cls, frequency: ArrayLike, impedance_minus: ArrayLike, *, origin: Origin | None = None
    ) -> Spectrum:
        """The spectrum of a solution in e^{-i w t}, conjugated here."""
        return cls(
            np.asarray(frequency, dtype=np.float64),
            np.conj(np.asarray(impedance_minus, dtype=np.complex128)),
            origin=Origin("simulated") if origin is None else origin,
        )

    @property
    def admittance(self) -> NDArray[np.complex128]:
        """Admittance 1 / Z, (n,) complex siemens."""
        return 1.0 / self.impedance

    @property
    def noise(self) -> NDArray[np.float64] | None:
        """Uncertainty of each point, (n,) ohm, without the shared part. It is at least a thousandth of the whole, since
        it is a difference of rounded numbers."""
        if self.uncertainty is None or self.shared_uncertainty == 0.0:
            return self.uncertainty
        shared = self.shared_uncertainty * self.magnitude
        return np.sqrt(np.maximum(self.uncertainty**2 - shared**2, (1e-3 * self.uncertainty) ** 2))

    @property
    def magnitude(self) -> NDArray[np.float64]:
        """Magnitude |Z|, (n,) ohm."""
        return np.abs(self.impedance)

    @property
    def phase_deg(self) -> NDArray[np.float64]:
        """Phase of Z, (n,) degrees in (-180, 180]."""
        return np.angle(self.impedance, deg=True)

    def summary(self) -> Summary:
        """Band, points and origin, for a notebook."""
        rows = (("band", f"{self.frequency[0] / 1e6:.6g} to {self.frequency[-1] / 1e6:.6g} MHz"),
                ("points", str(self.frequency.size)), ("origin", " ".join((self.origin.kind, self.origin.source))))
        return Summary("Impedance spectrum", rows, {self.origin.kind: self},
                       ("measured",) if self.origin.kind == "measured" else ())

    def to_xarray(self) -> xarray.Dataset:
        """``resistance``, ``reactance`` and, if known, ``uncertainty`` (ohm) over ``frequency`` (Hz). Real numbers
        only, so that it can be written as NetCDF."""
        import xarray

        parts = {"resistance": self.impedance.real, "reactance": self.impedance.imag}
        if self.uncertainty is not None:
            parts["uncertainty"] = self.uncertainty
        attributes = {"kind": self.origin.kind, "source": self.origin.source, "time_factor": "e^{+j w t}"}
        return xarray.Dataset({name: ("frequency", part, {"units": "ohm"}) for name, part in parts.items()},
                              {"frequency": ("frequency", self.frequency, {"units": "Hz"})}, attributes)

    def restricted(self, low: float, high: float) -> Spectrum:
        """The points with `low` <= frequency <= `high` (hertz).

        Raises:
            ValueError: fewer than two points lie there.
        """
        inside = (self.frequency >= low) & (self.frequency <= high)
        if np.count_nonzero(inside) < 2:
            raise ValueError(
                f"the band {frequency_text(low, high)} holds {np.count_nonzero(inside)} points of a spectrum from "
                f"{frequency_text(*self.frequency[[0, -1]])}; at least 2 are needed"
            )
        return self.at(inside)

    def at(self, kept: NDArray[np.bool_]) -> Spectrum:
        """The points that are `kept` (n,), at least two."""
        uncertainty = None if self.uncertainty is None else self.uncertainty[kept]
        return replace(self, frequency=self.frequency[kept], impedance=self.impedance[kept], uncertainty=uncertainty)

    def interpolant(self) -> Callable[[ArrayLike], NDArray[np.complex128]]:
        """A smooth Z(f) through every point, within the band.

        It is a cubic spline through the reflection coefficient G = (Z - Z0) / (Z + Z0), with Z0 the geometric mean of
        |Z|. A spline of Z is poor at an antiresonance and one of Y at a resonance, because each has a pole half a line
        width away; G is bounded for passive devices and its poles are many line widths away, since Z0 loads the loop.
        For a resonator of Q = 600 at 1 MHz sampled every 500 Hz the error is 1e-8 in Z, but several per cent with a
        spline of Y.
        """
        z0 = float(np.exp(np.mean(np.log(np.abs(self.impedance)))))
        # A passive spectrum never does this. One of reversed polarity may pass near -Z0; its mirror image is bounded.
        if np.min(np.abs(self.impedance - z0)) > np.min(np.abs(self.impedance + z0)):
            z0 = -z0
        spline = CubicSpline(self.frequency, (self.impedance - z0) / (self.impedance + z0))
        low, high = float(self.frequency[0]), float(self.frequency[-1])

        def impedance_at(frequency: ArrayLike) -> NDArray[np.complex128]:
            at = np.asarray(frequency, dtype=np.float64)
            outside = ~((at >= low) & (at <= high))
            if np.any(outside):
                first = np.ravel(at)[np.argmax(np.ravel(outside))]
                raise ValueError(
                    f"frequency {frequency_text(first)} lies outside the spectrum, {frequency_text(low, high)}; "
                    "a spectrum is never extrapolated"
                )
            reflection = spline(at)
            return np.asarray(z0 * (1.0 + reflection) / (1.0 - reflection))

        return impedance_at

    def on(self, frequencies: ArrayLike) -> Spectrum:
        """The spectrum interpolated (see :meth:`interpolant`) on `frequencies`, (m,) Hz.

        The uncertainty is interpolated linearly, not reduced by averaging.

        Raises:
            ValueError: a frequency lies outside the band, or they do not increase.
        """
        at = np.array(frequencies, dtype=np.float64)
        uncertainty = None if self.uncertainty is None else np.interp(at, self.frequency, self.uncertainty)
        return replace(self, frequency=at, impedance=self.interpolant()(at), uncertainty=uncertainty)


class WithSpectrum(Protocol):
    """A result with one spectrum: a reading, a simulation, a fit."""

    @property
    def spectrum(self) -> Spectrum: ...


def spectrum_of(given: Spectrum | WithSpectrum) -> Spectrum:
    """The spectrum itself, or the spectrum of a result.

    Raises:
        TypeError: the argument is neither.
    """
    found = given if isinstance(given, Spectrum) else getattr(given, "spectrum", None)
    if not isinstance(found, Spectrum):
        raise TypeError(f"received a {type(given).__name__}; expected a Spectrum, or a result with one in .spectrum: "
                        "a Reading, a Simulation, a MaterialFit")
    return found


def _refuse(
    wrong: NDArray[np.bool_], values: NDArray[np.float64] | NDArray[np.complex128], name: str, expected: str
) -> None:
    """Raise a ValueError for the first index at which `wrong` is true."""
    if np.any(wrong):
        index = int(np.argmax(wrong))
        raise ValueError(f"{name}[{index}] = {values[index]} must be {expected}")


#: A correction in messages, on the command line and in Python.
CORRECTION = '--correction {name} (correction="{name}")'


def corrected(spectrum: Spectrum, correction: str) -> Spectrum:
    """Correct the sign of a spectrum; its origin's settings note this.

    `correction` is "negate" (phase off by 180 degrees), "conjugate" (phase of the wrong sign) or "signs" (phase or
    reactance without its sign, see :mod:`workbench.results.signs`).

    Raises:
        ValueError: another correction.
    """
    match correction:
        case "negate":
            impedance = -spectrum.impedance
        case "conjugate":
            impedance = np.conj(spectrum.impedance)
        case "signs":
            impedance = with_signs(spectrum.impedance)
        case _:
            raise ValueError(f"correction {correction!r} is not one of negate, conjugate, signs")
    before = spectrum.origin.settings.get("correction")
    settings = {**spectrum.origin.settings, "correction": f"{before}, {correction}" if before else correction}
    return replace(spectrum, impedance=impedance, origin=replace(spectrum.origin, settings=settings))


def turns_anticlockwise(spectrum: Spectrum) -> bool:
    """Whether the reflection coefficient turns anticlockwise, so the phase's sign is wrong.

    Twice the area that it sweeps about the origin is then clearly positive, against Foster's reactance theorem. A
    capacitor or inductor sweeps at least 2 |X| Z0 / (X^2 + Z0^2), about one, times ln(f2 / f1) in the other sense; a
    quarter of that is required, so that a resistor (which sweeps only noise) is excluded.
    """
    z0 = float(np.exp(np.mean(np.log(spectrum.magnitude))))
    reflection = (spectrum.impedance - z0) / (spectrum.impedance + z0)
    swept = float(np.sum((np.conj(reflection[:-1]) * reflection[1:]).imag))
    return swept > 0.25 * float(np.log(spectrum.frequency[-1] / spectrum.frequency[0]))


def scatter(spectrum: Spectrum) -> float:
    """Relative standard deviation of a point about a smooth curve.

    It follows from third differences of ln Z. For white noise in the real and in the imaginary part their variance is
    20 times its square; the median excludes sharp resonances. It is at least 1e-6, also for fewer than four points.
    """
    third = np.diff(np.log(spectrum.impedance), 3)
    if not third.size:
        return 1e-6
    # The median of |x| of normal x is 0.6745 sigma.
    size = np.median(np.abs(np.concatenate([third.real, third.imag]))) / 0.6745
    return float(max(size / np.sqrt(20.0), 1e-6))


def write_spectrum(spectrum: Spectrum | WithSpectrum, path: Path | str) -> Path:
    """Write a spectrum, or that of a result, and return its path.

    The workbench's own format has ``# key: value`` lines of the origin, the column names, and the rows. Numbers are
    read back bit for bit, and the file is complete or absent. :func:`workbench.readers.read_recording` reads it.

    Raises:
        InputError: `path` is no path, or that of a folder.
        TypeError: there is no spectrum.
        OSError: the file cannot be written.
    """
    spectrum = spectrum_of(spectrum)
    if not isinstance(path, str | Path) or not str(path):
        raise InputError("write_spectrum", "path", path, 'the path of a file to write, such as "spectrum.csv"')
    path = Path(path)
    if path.is_dir():
        raise InputError("write_spectrum", "path", str(path), f'the path of a file to write, such as '
                         f'"{path / "spectrum.csv"}"; this is a folder')
    origin = spectrum.origin
    lines = [f"# kind: {origin.kind}"]
    for key, text in (("source", origin.source), ("sha256", origin.sha256), ("instrument", origin.instrument),
                      ("date", origin.date)):
        if text:
            lines.append(f"# {key}: {text}")
    lines += [f"# setting {name}: {text}" for name, text in origin.settings.items()]
    if spectrum.shared_uncertainty:
        lines.append(f"# {SHARED_UNCERTAINTY}: {spectrum.shared_uncertainty!r}")
    lines.append(f"# {ROWS}: {spectrum.frequency.size}")
    columns = [spectrum.frequency, spectrum.impedance.real, spectrum.impedance.imag]
    names = list(CSV_COLUMNS)
    if spectrum.uncertainty is not None:
        columns.append(spectrum.uncertainty)
        names.append(UNCERTAINTY_COLUMN)
    lines.append(",".join(names))
    lines += [",".join(repr(float(value)) for value in row) for row in zip(*columns, strict=True)]
    write_atomic(path, "\n".join(lines) + "\n")
    return path
