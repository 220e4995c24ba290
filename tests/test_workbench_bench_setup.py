"""workbench.bench.setup: what BENCH.toml says, and every mistake in it answered with file, field and value."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from workbench.bench.setup import SweepPlan, read_bench
from workbench.bench.spectra import read_compensation
from workbench.files.errors import InputError

TEXT = """
[generator]
port = "/dev/ttyUSB0"

[oscilloscope]
port = "/dev/usbtmc0"
probe_reference = 1
timeout = "2 s"

[reference]
resistance = "0.5 ohm"
tolerance = "1 %"

[sweep]
centre = "1 MHz"
span = "12 %"
step = "500 Hz"
direction = "both"
repeats = 2

[drive]
amplitude = ["1 Vpp", "5 Vpp"]

[limits]
device_voltage = "10 Vpp"
device_current = "60 mA"

[acquisition]
settle = "20 ms"

[compensation]
load = "load.h5"
load_resistance = "50 ohm"
load_tolerance = "0.1 %"

[device]
name = "chip 3"
temperature = "22 degC"
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "BENCH.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_everything_is_read_in_si(tmp_path: Path) -> None:
    setup = read_bench(written(tmp_path, TEXT))
    assert (setup.generator.port, setup.oscilloscope.port, setup.oscilloscope.timeout) == (
        "/dev/ttyUSB0", "/dev/usbtmc0", 2.0)
    assert (setup.oscilloscope.probe_total, setup.oscilloscope.probe_reference) == (10, 1)
    assert (setup.reference.resistance, setup.reference.tolerance) == (0.5, 0.01)
    assert setup.levels == (1.0, 5.0)
    assert setup.sweep.passes == 4
    assert setup.acquisition.settle == 0.02
    assert setup.limits.device_current == pytest.approx(0.06)
    # 60 mA through 50 ohm are 3 V, less than the 10 V that the device may see.
    assert setup.safe_amplitude == pytest.approx(3.0)
    assert setup.standards.load == tmp_path / "load.h5"
    assert setup.metadata == {"name": "chip 3", "temperature": "22 degC"}
    assert setup.text == TEXT


def test_a_note_about_the_device_has_no_control_characters(tmp_path: Path) -> None:
    """It becomes a line of every recording."""
    path = written(tmp_path, TEXT.replace("chip 3", r"chip\u001b[2J3"))
    with pytest.raises(InputError, match=r"device.name: received 'chip\\x1b\[2J3'; expected a text on one line"):
        read_bench(path)


def test_the_papers_sweep_has_481_points_that_the_generator_can_be_set_to() -> None:
    grid = SweepPlan(0.88e6, 1.12e6, step=500.0).grid()
    assert len(grid) == 481
    assert grid[0] == 0.88e6
    assert grid[-1] == 1.12e6
    uneven = SweepPlan(1e6, 1.001e6, step=33.333).grid()
    np.testing.assert_allclose(uneven * 100.0, np.round(uneven * 100.0), atol=1e-6)


@pytest.mark.parametrize(("old", "new", "field", "said"), [
    ('port = "/dev/ttyUSB0"', "", "generator.port", "one line of text"),
    ('resistance = "0.5 ohm"', 'resistance = "0.5"', "reference.resistance", "ohm"),
    ('resistance = "0.5 ohm"', 'resistance = "0 ohm"', "reference.resistance", "above zero"),
    ('tolerance = "1 %"', 'tolerance = "150 %"', "reference.tolerance", "less than"),
    ('tolerance = "1 %"', 'tolerence = "1 %"', "reference.tolerence", "'tolerance'"),
    ('span = "12 %"', 'from = "1 MHz"', "sweep", "from and to"),
    ('step = "500 Hz"', 'step = "1 MHz"', "sweep", "rising band"),
    ('step = "500 Hz"', 'kind = "adaptiv"', "sweep.kind", "'adaptive'"),
    ("repeats = 2", "repeats = 0", "sweep.repeats", "1 to 1000"),
    ('"5 Vpp"]', '"5.001 Vpp"]', "drive.amplitude", "steps of 0.01 V"),
    ('"5 Vpp"]', '"1 Vpp"]', "drive.amplitude", "twice"),
    ('"60 mA"', '"60 mV"', "limits.device_current", "A, mA"),
    ('"60 mA"', '"0 mA"', "limits.device_current", "above zero"),
    ("probe_reference = 1", "probe_reference = 5", "oscilloscope.probe_reference", "1 or 10"),
    ("probe_reference = 1", "channel_reference = 1", "oscilloscope.channel_reference", "another channel"),
    ('settle = "20 ms"', 'settle = "-1 ms"', "acquisition.settle", "not below zero"),
    ('settle = "20 ms"', "averages = 3", "acquisition.averages", "1, 4, 16, 64, 128"),
    ('load_resistance = "50 ohm"', "", "compensation.load_resistance", "with load"),
    ("[limits]", "[limit]", "limit", "'limits'"),
])
def test_mistakes_are_named(tmp_path: Path, old: Any, new: Any, field: Any, said: Any) -> None:
    assert old in TEXT
    path = written(tmp_path, TEXT.replace(old, new))
    with pytest.raises(InputError) as caught:
        read_bench(path)
    assert (caught.value.source, caught.value.field) == (str(path), field)
    assert said in str(caught.value)


def test_recordings_of_the_fixture_may_have_a_column_map(tmp_path: Path) -> None:
    text = TEXT.replace('load = "load.h5"', 'load = "load.csv"\ncolumns = "map.toml"')
    (tmp_path / "load.csv").write_text("f (Hz),Z,angle\n300000,50,0.1\n400000,50,0.2\n")
    (tmp_path / "map.toml").write_text('frequency = "f (Hz)"\nfirst = "Z"\nsecond = "angle"\nquantity = { kind = '
                                       '"impedance", form = "polar", unit = "ohm", phase_unit = "rad" }\n')
    load = read_compensation(read_bench(written(tmp_path, text)).standards).load
    np.testing.assert_allclose(np.angle(load.recorded.impedance), [0.1, 0.2])
    with pytest.raises(InputError, match=r"in degrees or in radians.*columns = .MAP.toml."):
        read_compensation(read_bench(written(tmp_path, text.replace('columns = "map.toml"', ""))).standards)
