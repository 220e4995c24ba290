"""The wheel in a root folder of its own: installed, the main job run, minutes and sizes measured.

    .venv/bin/python tests/benchmarks/clean_install.py FOLDER [--json FILE]        (Linux, as root; some 3 GB)

The root folder holds this Python without its packages, the libraries that Python links to, and devices. The wheel is
built from the files of the checkout, and its dependencies are gathered beside it; the new root has no network. First it
has Python alone: spectra, readers and materials work, and a command that needs more names it. Then it gets the system
libraries of `./setup`: the chip of the paper is simulated with CAD and pictures, and the first example runs.

It is slow because of the packages: 600 MB are fetched once and unpacked. FOLDER/wheels is used again if it is there.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(Path(__file__).resolve().parent)]

from measurements import Measurements, measurements, with_json  # noqa: E402

NAME = "acoustofluidic-chip-workbench"
#: Parts of Python's own folder that a user's Python does not need.
LEFT_OUT = shutil.ignore_patterns("site-packages", "test", "idlelib", "config-*", "__pycache__")
#: The folder of shared libraries.
LIBRARIES = Path("/usr/lib/x86_64-linux-gnu")
#: Libraries that wheels may expect of any Linux (the policy "manylinux"): the parts of glibc, and those of GCC.
EXPECTED = ("libstdc++.so.6", "libgcc_s.so.1", "libpthread.so.0", "libdl.so.2", "librt.so.1", "libutil.so.1",
            "libresolv.so.2")
#: Libraries that the EGL of Debian loads without being linked to them.
LOADED = ("libEGL_mesa.so.0", "libGLX_mesa.so.0", "dri/swrast_dri.so", "dri/kms_swrast_dri.so")
ENVIRONMENT = {"PATH": "/venv/bin:/usr/bin", "HOME": "/home", "LANG": "C.UTF-8", "OPENBLAS_NUM_THREADS": "1",
               "VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}
#: Commands with Python alone: words, exit status, and a part of the output.
ALONE: tuple[tuple[str, int, str], ...] = (
    ("workbench --version", 0, ""),
    ("workbench materials list", 0, "water/iapws_2011"),
    ("workbench chips copy free_disc_25x2", 0, "free_disc_25x2.toml"),
    ("workbench simulate free_disc_25x2.toml --no-cad --no-pictures -o disc", 0, "done in"),
    ("workbench compare disc/spectrum.csv free_disc_25x2.toml -o compare", 0, "done in"),
    ("workbench export free_disc_25x2.toml -o cad", 1, "CadQuery"),
    ("workbench doctor", 1, "libGL.so.1"),
)
#: Commands with the libraries of `./setup`.
WHOLE = (
    ("workbench chips copy acevedo_2026_chip", 0, "acevedo_2026_chip.toml"),
    ("workbench simulate acevedo_2026_chip.toml -o paper_chip", 0, "done in"),
    ("python 01_first_spectrum.py", 0, "f0=10304"),
    ("workbench doctor", 0, ""),
)


def processor() -> float:
    """Processor time (s) of this process and its ended children."""
    return sum(use.ru_utime + use.ru_stime for use in map(resource.getrusage, (
        resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


@contextmanager
def timed(name: str, kept: Measurements) -> Iterator[None]:
    """Print and keep the seconds of a block, by the clock and of the processor."""
    clock, own = time.perf_counter(), processor()
    yield
    kept.add(name, time.perf_counter() - clock, "s")
    kept.add(f"{name}, processor", processor() - own, "s")
    print(f"{name}: {time.perf_counter() - clock:.1f} s, {processor() - own:.1f} s of the processor", flush=True)


def gather(wheels: Path) -> None:
    """Build the wheel of this checkout, and fetch those of its dependencies, unless they are there."""
    source = wheels.parent / "source"
    shutil.rmtree(source, ignore_errors=True)
    for name in ("workbench", "geometry", "materials"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    alone = ["--no-deps"] if wheels.exists() else []
    subprocess.run([sys.executable, "-m", "pip", "wheel", "--quiet", *alone, "-w", str(wheels), str(source)],
                   check=True)


def linked(files: Sequence[Path]) -> set[Path]:
    """The shared libraries that files are linked to, directly or not."""
    printed = subprocess.run(["ldd", *map(str, files)], capture_output=True, text=True).stdout
    return {Path(path) for path in re.findall(r"(?:=> )?(/\S+) \(0x", printed)}


def copied(root: Path, files: set[Path]) -> None:
    """Copy files to the same paths below `root`, links as the files they lead to."""
    for file in files:
        target = root / file.relative_to("/")
        target.parent.mkdir(parents=True, exist_ok=True)
        if not target.exists():
            shutil.copy(file.resolve(), target)


def python_alone(root: Path) -> None:
    """Make the root folder with this Python and its libraries."""
    prefix, version = Path(sys.base_prefix), f"python{sys.version_info.major}.{sys.version_info.minor}"
    program = prefix / "bin" / version
    shutil.copytree(prefix / "lib" / version, root / prefix.relative_to("/") / "lib" / version, ignore=LEFT_OUT)
    expected = [LIBRARIES / name for name in EXPECTED]
    copied(root, {program, *expected, *linked([program, *expected,
                                               *(prefix / "lib" / version / "lib-dynload").glob("*.so")])})
    for folder in ("tmp", "home", "proc", "dev/shm", "usr/bin"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    (root / "usr/bin/python3").symlink_to(program)
    for name, minor in (("null", 3), ("zero", 5), ("urandom", 9)):
        os.mknod(root / "dev" / name, 0o20666, os.makedev(1, minor))


def with_libraries(root: Path) -> None:
    """Add the system libraries that `./setup` installs."""
    names = re.findall(r"lib\w+\.so\.\d+", (ROOT / "setup").read_text(encoding="utf-8"))
    files = {LIBRARIES / name for name in (*names, *LOADED) if (LIBRARIES / name).exists()}
    copied(root, files | linked(sorted(files)) | set(Path("/usr/share/glvnd").rglob("*.json")))
    # find_library of ctypes reads the cache of the loader.
    (root / "etc").mkdir(exist_ok=True)
    subprocess.run(["ldconfig", "-r", str(root)], check=True)
    copied(root, {Path("/sbin/ldconfig").resolve()})
    (root / "sbin").mkdir(exist_ok=True)
    shutil.copy("/sbin/ldconfig", root / "sbin")


def inside(root: Path, command: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run a command in the root folder, in /home, without network and with a /proc of its own."""
    return subprocess.run(
        ["unshare", "--mount", "--net", "--pid", "--fork", f"--root={root}", "--wd=/home", "--mount-proc", *command],
        env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def tried(root: Path, commands: Sequence[tuple[str, int, str]], kept: Measurements) -> int:
    """Run commands; returns the number of those that end with another status or do not print their words."""
    wrong = 0
    for command, status, words in commands:
        with timed(command, kept):
            done = inside(root, command.split())
        is_right = done.returncode == status and words in done.stdout
        wrong += not is_right
        if not is_right or status:
            print(f"  {'as expected' if is_right else 'WRONG'}: status {done.returncode}",
                  *done.stdout.strip().splitlines()[-12:], sep="\n  ", flush=True)
    return wrong


def megabytes(path: Path) -> float:
    """Size of a folder on disk (MB)."""
    return int(subprocess.run(["du", "-sk", str(path)], capture_output=True, text=True).stdout.split()[0]) / 1e3


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="for the wheels and the root; FOLDER/root is made anew")
    with_json(parser)
    options = parser.parse_args()
    folder = options.folder.resolve()
    root, wheels = folder / "root", folder / "wheels"
    folder.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(root, ignore_errors=True)
    with measurements(options.json) as kept:
        with timed("wheel built, dependencies gathered", kept):
            gather(wheels)
        with timed("root with Python alone", kept):
            python_alone(root)
        kept.add("Python alone", megabytes(root), "MB")
        shutil.copytree(wheels, root / "wheels", copy_function=os.link)
        with timed("wheel installed", kept):
            for command in ("/usr/bin/python3 -m venv /venv",
                            f"/venv/bin/pip install --quiet --no-index --find-links /wheels {NAME}"):
                done = inside(root, command.split())
                if done.returncode:
                    raise SystemExit(f"{command}\n{done.stdout}")
        shutil.rmtree(root / "wheels")
        kept.add("installed packages", megabytes(root / "venv"), "MB")
        for name in ("workbench", "geometry", "materials"):
            (package,) = (root / "venv/lib").glob(f"python*/site-packages/{name}")
            kept.add(f"installed {name}", megabytes(package), "MB")
        wrong = tried(root, ALONE, kept)
        with_libraries(root)
        shutil.copy(ROOT / "examples" / "01_first_spectrum.py", root / "home")
        kept.add("root with packages and libraries", megabytes(root), "MB")
        wrong += tried(root, WHOLE, kept)
        for name, figure in kept.figures.items():
            if figure["unit"] == "MB":
                print(f"{name}: {figure['value']:.0f} MB")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
