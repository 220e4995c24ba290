"""workbench.bench.waveforms: Tektronix CSV and ISF, with every trap seen in real files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from workbench.bench.sine_fit import fit_sines
from workbench.bench.waveforms import pair_files, read_waveform
from workbench.files.errors import InputError

SAMPLES, STEP, SCALE = 2500, 4e-9, 0.2
SETTINGS = {
    "Record Length": "2.500000e+03", "Sample Interval": "4.000000e-09", "Trigger Point": "1.250000e+03",
    "Source": "CH1",
    "Vertical Units": "V", "Vertical Scale": "2.000000e-01", "Vertical Offset": "0.0", "Pt Fmt": "Y", "Yzero": "0.0",
    "Probe Atten": "1.0",
}


def samples(amplitude: float = 0.6, phase: float = 0.0) -> Any:
    time = STEP * (np.arange(SAMPLES) - 1250)
    quantum = SCALE / 25.0
    return time, np.round(amplitude * np.cos(2e6 * np.pi * time + phase) / quantum) * quantum


def csv(
    path: Path, *, first: str = "", drop: int = 0, amplitude: float = 0.6, phase: float = 0.0, **changed: str
) -> Path:
    settings = {key: changed.get(key.replace(" ", "_"), value) for key, value in SETTINGS.items()}
    rows = list(zip(*samples(amplitude, phase), strict=True))
    heads = [f"{key},{value}" for key, value in settings.items()] + [","] * (SAMPLES - len(settings))
    # The odd zeros are how some firmware writes negative numbers.
    lines = [f"{head},,{'-0' if t < 0 else ' '}{abs(t):.12f},  {v:.5f},"
             for head, (t, v) in zip(heads, rows, strict=True)]
    path.write_text(first + "\r\n".join(lines[:len(lines) - drop]) + "\r\n")
    return path


def isf(
    path: Path, *, points: Any = SAMPLES, form: str = "Y", short: bool = False, tail: Any = b"", cut: int = 0
) -> Path:
    _, volts = samples()
    raw = np.round(volts / 0.008).astype(">i1").tobytes()
    header = (f':WFMPRE:BYT_NR 1;BIT_NR 8;ENCDG BIN;BN_FMT RI;BYT_OR MSB;NR_PT {points};'
              f'WFID "Ch1, DC coupling, 0.2 V/div";PT_FMT {form};XINCR 4.0E-9;PT_OFF 0;'
              f'XZERO -5.0E-6;XUNIT "s";YMULT 8.0E-3;YZERO 0.1E0;YOFF 2.5E1;'
              f'YUNIT "V";:CURVE #42500')
    if short:
        for long, brief in (("WFMPRE", "WFMP"), ("BYT_NR", "BYT_N"), ("ENCDG", "ENC"), ("NR_PT", "NR_P"),
                            ("XINCR", "XIN"), ("XZERO", "XZE"), ("YMULT", "YMU"), ("YZERO", "YZE"), ("YOFF", "YOF"),
                            ("CURVE", "CURV")):
            header = header.replace(long, brief)
    data = header.encode() + raw + tail
    path.write_bytes(data[:len(data) - cut])
    return path


@pytest.mark.parametrize("first", ["", ",,,time,volt,\r\n"])
def test_csv_with_its_odd_numbers_and_a_line_added_by_hand(tmp_path: Path, first: Any) -> None:
    found = read_waveform(csv(tmp_path / "F0001CH1.CSV", first=first))
    time, volts = samples()
    np.testing.assert_allclose(found.volts, volts, atol=1e-9)
    assert (found.channel, found.step, found.volts_per_count) == (1, 4e-9, SCALE / 25.0)
    assert found.start == pytest.approx(time[0])
    np.testing.assert_array_equal(found.raw, np.round(volts / 0.008))
    assert not found.clipped


def test_isf_in_long_and_short_words(tmp_path: Path) -> None:
    _, volts = samples()
    for short in (False, True):
        found = read_waveform(isf(tmp_path / "a.isf", short=short))
        # volt = (raw - YOFF) YMULT + YZERO
        np.testing.assert_allclose(found.volts, volts - 25 * 0.008 + 0.1, atol=1e-12)
        assert (found.channel, found.start, found.step) == (1, -5e-6, 4e-9)


def test_an_envelope_beside_the_samples_is_left_out(tmp_path: Path) -> None:
    envelope = isf(tmp_path / "b.isf", form="ENV").read_bytes()
    found = read_waveform(isf(tmp_path / "a.isf", tail=envelope))
    assert len(found.volts) == SAMPLES
    with pytest.raises(InputError, match="extremes"):
        read_waveform(tmp_path / "b.isf")


def test_a_flat_crest_is_noticed(tmp_path: Path) -> None:
    path = csv(tmp_path / "F0001CH1.CSV")
    text = path.read_text()
    assert not read_waveform(path).clipped
    for steps in range(60, 76):
        text = text.replace(f" {steps * 0.008:.5f}", f" {60 * 0.008:.5f}")
    path.write_text(text)
    assert read_waveform(path).clipped


@pytest.mark.parametrize(("changed", "said"), [
    ({"drop": 1}, "2500 of 'Record Length'"),
    ({"Vertical_Units": "W"}, "Vertical Units"),
    ({"Pt_Fmt": "ENV"}, "envelope"),
    ({"Sample_Interval": "5e-9"}, "after the one before"),
    ({"Vertical_Scale": "none"}, "above zero"),
    ({"Source": "MATH", "name": "MATH.CSV"}, "not a calculated trace"),
])
def test_csv_that_cannot_be_trusted_is_refused(tmp_path: Path, changed: Any, said: Any) -> None:
    name = changed.get("name", "F0001CH1.CSV")
    with pytest.raises(InputError, match=said):
        read_waveform(csv(tmp_path / name, **{k: v for k, v in changed.items() if k != "name"}))


@pytest.mark.parametrize(("changed", "said"), [({"cut": 1}, "cut short"), ({"points": 2499}, "of NR_PT")])
def test_isf_that_cannot_be_trusted_is_refused(tmp_path: Path, changed: Any, said: Any) -> None:
    with pytest.raises(InputError, match=said):
        read_waveform(isf(tmp_path / "a.isf", **changed))


def test_other_files_are_refused_with_what_they_are(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("f,U\n1,2\n")
    with pytest.raises(InputError, match="f,U"):
        read_waveform(path)
    with pytest.raises(InputError, match="readable"):
        read_waveform(tmp_path / "absent.csv")


def test_pairs_by_name(tmp_path: Path) -> None:
    for number, phase in ((3, 0.5), (4, 0.25)):
        csv(tmp_path / f"F000{number}CH1.CSV", phase=phase)
        csv(tmp_path / f"F000{number}CH2.CSV", amplitude=0.3, Source="CH2")
    pairs = pair_files([tmp_path], total=1, reference=2)
    assert list(pairs) == ["F0003", "F0004"]
    fit = fit_sines([read_waveform(path) for path in pairs["F0003"]])
    assert fit.frequency == pytest.approx(1e6, rel=1e-5)
    # Eight bits over 2500 samples: a part in a thousand of a clean sine.
    assert fit.amplitude[0] / fit.amplitude[1] == pytest.approx(2.0 * np.exp(0.5j), rel=3e-3)
    with pytest.raises(InputError, match="channel 3"):
        pair_files([tmp_path], total=1, reference=3)
    with pytest.raises(InputError, match="readable file"):
        pair_files([tmp_path / "trace.csv"], total=1, reference=2)
    (tmp_path / "trace.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="channel in it"):
        pair_files([tmp_path / "trace.csv"], total=1, reference=2)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="folder with waveforms"):
        pair_files([tmp_path / "empty"], total=1, reference=2)
