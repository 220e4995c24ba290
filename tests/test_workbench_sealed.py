"""A file with a digest: every changed byte and every cut is noticed, and nothing in it is executed."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from workbench.files.errors import InputError
from workbench.files.sealed import is_sealed, read_arrays, seal, write_arrays


class Poison:
    """Leaves a file where it is unpickled."""

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (Path("EXECUTED"),))


def test_arrays_come_back_and_other_programs_read_them(tmp_path: Path) -> None:
    path, values = tmp_path / "a.npz", {"a": np.arange(3.0), "b": np.array(["x", "yz"])}
    write_arrays(path, values, {"format": 1})
    content, found = read_arrays(path)
    assert content == {"format": 1}
    assert {name: each.tolist() for name, each in found.items()} == {"a": [0.0, 1.0, 2.0], "b": ["x", "yz"]}
    with np.load(path, allow_pickle=False) as archive:
        assert archive["a"].tolist() == [0.0, 1.0, 2.0]


def test_every_byte_and_every_length_counts(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_arrays(path, {"a": np.arange(2.0)}, {"format": 1})
    whole = path.read_bytes()
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ (1 << place % 8)]) + whole[place + 1:])
        with pytest.raises(InputError, match=r"a\.npz: content: received"):
            read_arrays(path)
        path.write_bytes(whole[:place])
        with pytest.raises(InputError, match=r"a\.npz: content: received"):
            read_arrays(path)
    path.write_bytes(whole)
    read_arrays(path)


@pytest.mark.parametrize("sealed", [False, True])
def test_a_pickle_is_refused_and_does_not_run(sealed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "a.npz"
    for written in (pickle.dumps(Poison()), None):
        if written is None:
            with path.open("wb") as stream:
                np.savez(stream, content=np.array([Poison()], dtype=object), allow_pickle=True)
        else:
            path.write_bytes(written)
        if sealed:
            seal(path)
        with pytest.raises(InputError, match=r"a\.npz"):
            read_arrays(path)
    assert not Path("EXECUTED").exists()


def test_a_file_without_a_digest_is_known_as_one(tmp_path: Path) -> None:
    path = tmp_path / "short"
    path.write_bytes(b"x")
    assert not is_sealed(path)
    seal(path)
    assert is_sealed(path)
    with pytest.raises(InputError, match="a readable file"):
        is_sealed(tmp_path)
    with pytest.raises(InputError, match="a readable file"):
        read_arrays(tmp_path / "absent.npz")
