"""The options of every command, listed in :data:`COMMANDS`.

Only argparse is imported, so that help and mistakes in options need no waiting.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from typing import NoReturn

from workbench import __version__
from workbench.commands.driven_options import DRIVE_HELP, KEPT_COLD, with_warmth

#: Default accuracy of Z of meshes (`workbench.model.discretisation.ACCURACY`).
ACCURACY = "0.05 %"

OUTPUT_HELP = "folder for the results, created if needed"


class _Parser(argparse.ArgumentParser):
    """A parser that names the nearest choices in its errors."""

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Refuse unknown long options first, so that no other error hides them."""
        # Behind a command, its own parser checks.
        is_own = (lambda text: text.startswith("-")) if self._subparsers else "--".__ne__
        args = sys.argv[1:] if args is None else args
        for text in takewhile(is_own, args):
            name = text.partition("=")[0]
            if name.startswith("--") and not any(known.startswith(name) for known in self._option_string_actions):
                self.error(f"unrecognized argument: {text}{_near(name, self._option_string_actions)}")
        return super().parse_known_args(args, namespace)

    def _check_value(self, action: argparse.Action, value: object) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message += _near(str(value), action.choices or ())
            raise


def _near(name: str, known: Iterable[str]) -> str:
    from workbench.files.errors import hint, nearest_names

    return hint(nearest_names(name, known))


def command_parser() -> argparse.ArgumentParser:
    """The parser of the command line; ``options.command`` names the command."""
    whole = _Parser(
        prog="workbench", formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Simulate an acoustofluidic chip, compare it with a recording, look at its fields.",
        epilog="exit status: 0 done, 1 computation failed (or memory was not enough), 2 mistake in the command or a "
               "file,\n130 interrupted, 143 terminated (SIGTERM), 129 terminal closed (SIGHUP)",
    )
    whole.add_argument("--version", action="version", version=f"workbench {__version__}")
    subparsers = whole.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (text, add_options) in COMMANDS.items():
        add_options(subparsers.add_parser(name, help=text, description=text))
    return whole


def _with_materials(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--materials", type=Path, action="append", default=[], metavar="DIR",
                     help="a further folder of materials, material/source.toml, beside the package's and your own (may "
                          "be repeated; default none)")


def _with_scripts(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--no-scripts", action="store_true",
                     help="refuse chip files with a script, which is a program with all your rights (default: its name "
                          "is printed, and it runs)")


def _with_filling(sub: argparse.ArgumentParser) -> None:
    """The options of commands that fill a chip with materials."""
    _with_materials(sub)
    _with_scripts(sub)
    sub.add_argument("--inviscid", action="store_true",
                     help="leave out the boundary layers of the cavity's fluid (default: part of the model)")


def _with_state(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--state", metavar="NAME", help="state of the chip (default: the last of its file)")


def _with_band(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--from", dest="low", metavar="FREQ",
                     help='lower end of the band, such as "0.91 MHz" (default: of the chip)')
    sub.add_argument("--to", dest="high", metavar="FREQ", help="upper end of the band (default: of the chip)")


def _with_model(sub: argparse.ArgumentParser) -> None:
    _with_band(sub)
    _with_accuracy(sub)
    _with_filling(sub)
    sub.set_defaults(points=481, at=None, full=False, relative_error="0.01 %", drive="10 Vpp", assumed_losses=True,
                     **KEPT_COLD)


def _with_losses(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--no-assumed-losses", dest="assumed_losses", action="store_false", default=True,
                     help="leave a ceramic whose source states no loss without one (default: that of a usual ceramic)")


def _with_chip(sub: argparse.ArgumentParser) -> None:
    """A chip in one of its states, and its model."""
    sub.add_argument("chip", type=Path, metavar="CHIP.toml")
    _with_state(sub)
    _with_model(sub)


def _with_accuracy(sub: argparse.ArgumentParser) -> None:
    # argparse formats its help with %.
    sub.add_argument("--accuracy", default=ACCURACY, metavar="ERROR",
                     help=f'relative error of Z, rms over the band, that the mesh is made for (default "{ACCURACY}")'
                     .replace("%", "%%"))


def _with_jobs(sub: argparse.ArgumentParser, pieces: str) -> None:
    sub.add_argument("--jobs", type=int, metavar="N",
                     help=f"{pieces} at a time (default: one for each core, or for each thread of the cluster)")
    sub.add_argument("--dask", metavar="ADDRESS",
                     help='a Dask cluster, by the address of its scheduler, such as "tcp://127.0.0.1:8786" (default: '
                     "processes of this machine)")
    sub.add_argument("--workers", action=_Renamed, nargs="?", default=argparse.SUPPRESS, const="--jobs",
                     help=argparse.SUPPRESS)


class _Renamed(argparse.Action):
    """An option that fails with its new name, ``const``."""

    def __call__(self, parser: argparse.ArgumentParser, _namespace: object, _values: object,
                 option_string: str | None = None) -> NoReturn:
        parser.error(f"{option_string} is {self.const} now")


def _with_recording(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--columns", type=Path, metavar="MAP.toml",
                     help="column map of the recording (default: by its headings; if they are unclear, the error "
                          "proposes a map)")
    sub.add_argument("--format", metavar="NAME",
                     help="format of the recording: workbench, e4990a, 4294a, touchstone, labone, bode100, gamry, "
                          "biologic, zplot, hioki, lines or table (default: found out)")
    sub.add_argument("--correction", choices=("negate", "conjugate", "signs"),
                     help="correct a phase that you know to be wrong (default: as recorded)")
    sub.add_argument("--without-outliers", action="store_true",
                     help="leave out the points that the findings name with their rows: those far from their "
                          "neighbours, or impossible for a passive device (default: they stay)")


def _simulate(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("chip", type=Path, metavar="CHIP.toml")
    sub.add_argument("--state", action="append", metavar="NAME",
                     help="only this state (may be repeated; default all)")
    _with_model(sub)
    _with_losses(sub)
    sub.add_argument("--points", type=int, default=481, metavar="N", help="frequencies in the band (default 481)")
    sub.add_argument("--full", action="store_true",
                     help="solve every frequency instead of a reduced model (default); may be interrupted and "
                     "continued")
    sub.add_argument("--at", metavar="FREQ", help="frequency of the fields, or \"energy\" or \"f0\"; by default the "
                     "chip's operating point, or the largest peak of the energy in the cavity under the drive")
    sub.add_argument("--drive", default="10 Vpp", help=DRIVE_HELP)
    with_warmth(sub)
    sub.add_argument("--relative-error", default="0.01 %", metavar="ERROR",
                     help="relative error of the reduced model's impedance (default \"0.01 %%\")")
    sub.add_argument("--no-pictures", action="store_true",
                     help="leave out the pictures of fields and solid model (default: drawn)")
    sub.add_argument("--no-cad", action="store_true", help="leave out the solid model (default: STEP, STL, view)")
    sub.add_argument("--vtu", action="store_true", help="write the fields for ParaView too (default: not)")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _study(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("study", type=Path, metavar="STUDY.toml", help="a chip, its varied parameters, and the "
                     "figures; see workbench/design/plan.py")
    _with_jobs(sub, "pieces of work")
    sub.add_argument("--overwrite", action="store_true",
                     help="begin anew in a folder with another study (default: an error; the same one continues)")
    _with_filling(sub)
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _compare(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("recording", type=Path, metavar="RECORDING")
    sub.add_argument("chip", type=Path, metavar="CHIP.toml")
    _with_state(sub)
    _with_recording(sub)
    _with_model(sub)
    _with_losses(sub)
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _mesh(sub: argparse.ArgumentParser) -> None:
    _with_chip(sub)
    sub.add_argument("--converge", action="store_true",
                     help="the meshes of all accuracies against a finer one; status 1 if --accuracy is not met")
    sub.add_argument("-o", "--output", type=Path, metavar="DIR",
                     help="folder for the report of the convergence (default: none is written)")


def _modes(sub: argparse.ArgumentParser) -> None:
    _with_chip(sub)
    sub.add_argument("--orders", default="0", metavar="LIST",
                     help='numbers of waves around the axis of a round chip, such as "0,1,2" (default 0)')
    sub.add_argument("--wavelengths", default="", metavar="LIST",
                     help='wavelengths along a straight chip, such as "5 mm,2 mm" (default: uniform modes alone)')
    sub.add_argument("--dispersion", action="store_true", help="frequency over the wave number along a straight chip, "
                     "with a picture (default: not)")
    sub.add_argument("--shortest", metavar="LENGTH", help="shortest wavelength of --dispersion (default: of sound in "
                     "the liquid, or of shear in the transducer, at the end of the band)")
    sub.add_argument("--wave-numbers", type=int, metavar="N", help="wave numbers of --dispersion, beside those that "
                     "are added between them (default 33)")
    sub.add_argument("--least-q", type=float, default=20.0, metavar="Q",
                     help="smallest quality factor of a mode (default 20)")
    sub.add_argument("--recording", type=Path, metavar="FILE", help="a recording of this state: its resonances beside "
                     "the modes that the electrodes drive (default: none)")
    _with_recording(sub)
    sub.add_argument("--draw", type=int, default=6, metavar="N", help="modes to draw, those of the largest coupling or "
                     "energy in the liquid (default 6)")
    sub.add_argument("--animate", action="store_true", help="a cycle of each drawn mode too, as a GIF (default: not)")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _along(sub: argparse.ArgumentParser) -> None:
    _with_chip(sub)
    sub.add_argument("--points", type=int, default=241, metavar="N", help="frequencies in the band (default 241)")
    sub.add_argument("--at", metavar="FREQ", help="frequency of the energy along the channel (default: the three "
                     "highest peaks of the energy)")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _export(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("chip", type=Path, metavar="CHIP.toml")
    _with_scripts(sub)
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _render(sub: argparse.ArgumentParser) -> None:
    _with_chip(sub)
    sub.add_argument("--at", metavar="FREQ", help="frequency of the fields (default as of simulate)")
    sub.add_argument("--drive", default="10 Vpp", help=DRIVE_HELP)
    with_warmth(sub)
    sub.add_argument("--field", action="append", metavar="NAME", help="displacement, pressure, gorkov, cutaway, "
                     "losses or mesh (may be repeated; default all)")
    sub.add_argument("--vtu", action="store_true", help="write the fields for ParaView too (default: not)")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _particles(sub: argparse.ArgumentParser) -> None:
    _with_chip(sub)
    sub.add_argument("--drive", default=None,
                     help=f"{DRIVE_HELP.replace(' (default)', '')} (no default: the times depend on it)")
    sub.add_argument("--at", metavar="FREQ", help="frequency of the field (default as of simulate)")
    sub.add_argument("--minutes", type=float, default=30.0, metavar="M", help="time to follow them for (default 30)")
    sub.add_argument("--count", type=int, default=200, metavar="N", help="number of particles (default 200)")
    sub.add_argument("--seed", type=int, default=0, metavar="N", help="of their start points (default 0)")
    sub.add_argument("--start", choices=("spread", "floor"), default="spread",
                     help="where they are at switch-on: spread over the cavity (default), or on its floor")
    sub.add_argument("--flow", choices=("heat", "sound", "none"), default="heat",
                     help="cause of the liquid's flow: heat beside sound (default), sound alone, or none")
    with_warmth(sub)
    sub.add_argument("--particle", metavar="NAME", help="its material (default: of the state)")
    sub.add_argument("--particle-radius", metavar="LENGTH", help='such as "5 um" (default: of the state)')
    sub.add_argument("--window", metavar="RADIUS",
                     help="radius about the axis, or distance from the middle of a channel, within which the light "
                     "curve counts them (default: a quarter of the cavity's)")
    sub.add_argument("--no-pictures", action="store_true", help="leave pictures and animation out (default: drawn)")
    sub.add_argument("--no-animation", action="store_true", help="leave the animation out (default: a GIF)")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _chips(sub: argparse.ArgumentParser) -> None:
    actions = sub.add_subparsers(dest="action", required=True, metavar="ACTION")
    text = "the chip files of the package"
    actions.add_parser("list", help=text, description=text)
    text = "copy one of them, to begin with"
    copy = actions.add_parser("copy", help=text, description=text)
    copy.add_argument("name", metavar="NAME", help="of the list (must be given)")
    # A Path has no slash at its end.
    copy.add_argument("-o", "--output", dest="target", default="./", metavar="FILE",
                      help="path that does not exist yet, or a folder, which with a slash at its end need not exist "
                           "(default: NAME.toml, or folder NAME, in this folder)")


def _materials(sub: argparse.ArgumentParser) -> None:
    actions = sub.add_subparsers(dest="action", required=True, metavar="ACTION")

    def action(name: str, text: str) -> argparse.ArgumentParser:
        found = actions.add_parser(name, help=text, description=text)
        _with_materials(found)
        return found

    action("list", "every material, fitted and withdrawn ones marked")
    for name, text, default in (("show", "every number of a material, with its source or its fit", "must be given"),
                                ("check", "read materials and check them", "default: all")):
        one = action(name, text)
        one.add_argument("name", nargs="?", metavar="NAME", help=f"material, or material/source ({default})")
        one.add_argument("--temperature", metavar="TEMP",
                         help='such as "25 degC" (default: the reference temperature of the material)')
    diff = action("diff", "two materials beside each other")
    diff.add_argument("first", metavar="A")
    diff.add_argument("second", metavar="B")
    history = action("history", "the versions of a saved fit")
    history.add_argument("name", metavar="NAME", help="material/name")
    withdraw = action("withdraw", "take back one version of a saved fit; it can still be read by its full name")
    withdraw.add_argument("name", metavar="NAME", help="material/name@version")
    withdraw.add_argument("--reason", required=True, metavar="TEXT", help="for those who used it")
    export = action("export", "materials of your own in one file")
    export.add_argument("names", nargs="+", metavar="NAME")
    export.add_argument("-o", "--output", type=Path, required=True, metavar="FILE",
                        help="the file; replaced if materials were exported to it")
    importing = action("import", "put exported materials into the last folder of --materials, or else your own")
    importing.add_argument("file", type=Path, metavar="FILE")


def _sensitivity(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("chip", type=Path, metavar="DISC.toml")
    _with_state(sub)
    sub.add_argument("--density", metavar="DENSITY",
                     help='of the transducer, such as "7500 kg/m^3" (default: of the chip)')
    sub.add_argument("--loss", type=float, default=0.0, metavar="SHARE",
                     help="losses that the material does not state, over the real part (default 0: they stay zero, and "
                          "cannot be ranked)")
    _with_model(sub)
    sub.add_argument("--points", type=int, default=481, metavar="N", help="frequencies in the band (default 481)")
    sub.add_argument("--scalings", type=int, default=50, metavar="N",
                     help="scalings of every part from 0.7 to 1.3 (default 50, as in the paper)")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _tolerance(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("chip", type=Path, metavar="CHIP.toml")
    _with_state(sub)
    sub.add_argument("--require", action="append", default=[], metavar="TEXT",
                     help='requirement of the chip, such as "f0 within 5 kHz" or "e_ac >= 20 J/m^3 at 10 Vpp" (may be '
                          "repeated; without any: only sensitivities, no yield)")
    _with_uncertainty(sub)
    sub.add_argument("--figure", action="append", default=[], metavar="NAME",
                     help="a further figure (may be repeated; default f0, z_min, q and those of the requirements)")
    sub.add_argument("--drive", default="10 Vpp", help=DRIVE_HELP + "; of figures whose requirement states none")
    sub.add_argument("--thermal-resistance", action="append", default=[], metavar="R",
                     help='of heating: "10 K/W" for all regions, or "transducer = 10 K/W" (may be repeated; default '
                          "none)")
    follows = sub.add_mutually_exclusive_group()
    follows.add_argument("--track", dest="tracking", action="store_true",
                         help="the drive follows the resonance of each chip, as a bench does (default)")
    follows.add_argument("--fixed-frequency", dest="tracking", action="store_false",
                         help="the drive stays at that of the chip as stated")
    sub.add_argument("--at", metavar="FREQ", help="frequency of the drive, or the resonance that it follows, "
                     "\"energy\" or \"f0\" (default as of simulate)")
    sub.add_argument("--samples", type=int, default=2000, metavar="N",
                     help="samples of the yield (default 2000, whose interval is 2 %% to either side)")
    sub.add_argument("--seed", type=int, default=0, metavar="N", help="of all samples (default 0)")
    sub.add_argument("--sobol", type=int, default=0, metavar="N",
                     help="Sobol indices by N (a power of two) times the uncertain numbers plus two evaluations "
                          "(default: none)")
    sub.add_argument("--every", action="store_true",
                     help="sensitivities to every number, by 1 %% of it where no uncertainty is stated (default: the "
                          "uncertain ones, or every one if none is)")
    _with_model(sub)
    _with_jobs(sub, "parcels of samples")
    sub.set_defaults(tracking=True)
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _with_uncertainty(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--uncertainty", action="append", default=[], metavar="TEXT",
                     help='an uncertainty beside chip file and registry: "superstrate.thickness = 20 um" (limits), '
                          '"pla.shear_modulus = 3 %%" (standard uncertainty); followed by uniform, normal or standard, '
                          "or exact (may be repeated)")
    sub.add_argument("--uncertainties", type=Path, metavar="FILE.toml",
                     help="the same in a table [uncertainty] of a file (default: none)")
    sub.add_argument("--distribution", choices=("uniform", "normal"), default="uniform",
                     help="meaning of the tolerance of a length: limits of a uniform law (default), or three standard "
                          "deviations of a normal law")
    sub.add_argument("--posterior", type=Path, action="append", default=[], metavar="FIT.json",
                     help="fit.json of a fit, with its values, uncertainties and correlations (may be repeated; "
                          "default: as the registry states)")


def _fit(sub: argparse.ArgumentParser) -> None:
    kinds = sub.add_subparsers(dest="kind", required=True, metavar="KIND")

    def kind(name: str, text: str) -> argparse.ArgumentParser:
        return kinds.add_parser(name, help=text, description=text)

    def with_search(found: argparse.ArgumentParser) -> None:
        found.add_argument("--algorithm", choices=("joint", "paper"), default="joint",
                           help="joint (default): all parameters at once, with intervals; paper: as Acevedo-Espinosa "
                                "et al. printed theirs")
        found.add_argument("--start", action="append", default=[], metavar="MATERIAL",
                           help="a further start: the free parameters as this material has them (may be repeated); all "
                                "others stay: --material takes the whole entry. Where the recording stays unexplained, "
                                "all ceramics are tried")
        found.add_argument("--tries", type=int, default=32, metavar="N",
                           help="further descents, at most, where the recording stays unexplained: from other ceramics "
                                "and neighbours of the best end, then from the prior (default 32)")
        found.add_argument("--force", action="store_true",
                           help="fit a recording that seems to be of another device, and save a fit that was not "
                                "accepted")

    def with_one(found: argparse.ArgumentParser, region: str) -> None:
        found.add_argument("recording", type=Path, metavar="RECORDING")
        found.add_argument("--chip", type=Path, required=True, metavar="CHIP.toml", help="the recorded chip (required)")
        _with_state(found)
        found.add_argument("--material", metavar="NAME", help="start of the fit (default: the chip's material)")
        found.add_argument("--region", metavar="NAME", help=f"whose material is fitted (default: {region})")
        found.add_argument("--free", metavar="A,B,C",
                           help="parameters: coefficients such as c33 or c33.loss, dimensions such as "
                                "transducer.thickness, bench elements such as bench.series_resistance; default stands "
                                "for the constants of a ceramic that the recording shows, or the moduli of a sample")
        with_search(found)
        _with_recording(found)
        _with_model(found)
        found.add_argument("--save", metavar="MATERIAL/NAME", help="save the result as the next version of this "
                           "material, if it is accepted (default: not saved)")
        found.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)

    pzt = kind("pzt", "fit the material of a transducer to a recording")
    with_one(pzt, "transducer")
    pzt.set_defaults(gel_study=None)
    polymer = kind("polymer", "fit the material of a sample on a transducer that is known")
    with_one(polymer, "sample")
    polymer.add_argument("--gel-study", metavar="A,B,C",
                         help='thicknesses of the gel to predict the spectrum with after the fit, such as '
                              '"5um,20um,50um" (default: none)')
    batch = kind("batch", "fit many recordings, several at a time; a further run does only the unfinished ones")
    batch.add_argument("file", type=Path, metavar="FILE.toml",
                       help="lists the recordings: see the page on fits")
    with_search(batch)
    batch.add_argument("--again", action="store_true", help="repeat finished fits (default: only the others)")
    batch.add_argument("--only", metavar="NAME", help="fit this one, and write no summary (default: all)")
    _with_jobs(batch, "fits")
    _with_accuracy(batch)
    _with_filling(batch)
    batch.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _diagnose(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("diagnosed", type=Path, metavar="CAMPAIGN.toml|RECORDING",
                     help="states of a device with their recordings, and its priors; or one recording, with --chip and "
                          "the options of a recording")
    sub.add_argument("--chip", type=Path, metavar="CHIP.toml",
                     help="the recorded chip, for a recording without a campaign file; its priors are those stated in "
                          "this file and its materials")
    _with_state(sub)
    _with_recording(sub)
    sub.add_argument("--noise", metavar="SHARE",
                     help='standard deviation of a recorded point, such as "0.5 %%" (default: as the recording states '
                          "it, or its scatter)")
    _with_band(sub)
    _with_accuracy(sub)
    _with_materials(sub)
    _with_scripts(sub)
    _with_jobs(sub, "pieces of the search")
    sub.add_argument("--minutes", type=float, metavar="M",
                     help="begin no further step after this time, and report the results so far")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _app(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("chip", type=Path, metavar="CHIP.toml")
    _with_state(sub)
    sub.add_argument("--recording", type=Path, metavar="FILE",
                     help="recorded impedance, drawn over the spectrum; free parameters are fitted to it (default: "
                          "none)")
    _with_recording(sub)
    sub.add_argument("--campaign", type=Path, metavar="CAMPAIGN.toml",
                     help="campaign of a diagnosis (default: the recording alone)")
    sub.add_argument("--vary", nargs="+", action="extend", default=[], metavar="NAME",
                     help="adjustable parameters: lengths such as substrate.thickness, constants such as "
                          "pla/acevedo_2026.shear_modulus, each with a range if wanted, "
                          '"substrate.thickness=0.8mm..0.9mm" (default: all thicknesses, the radius of the cavity, the '
                          "sound speed in it, a shear modulus; by 5 % to either side)".replace("%", "%%"))
    sub.add_argument("--port", type=int, default=0, metavar="N", help="of the page (default: any that is free)")
    sub.add_argument("--no-browser", action="store_true", help="only print the address (default: it is opened)")
    _with_model(sub)
    sub.add_argument("--drive", default="10 Vpp", help=DRIVE_HELP)
    # Another name than `output`, which the command line reports at the end.
    sub.add_argument("-o", "--output", dest="folder", type=Path, default=Path(), metavar="DIR",
                     help="where chip files and reports are saved (default: this folder)")


def _bench(sub: argparse.ArgumentParser) -> None:
    actions = sub.add_subparsers(dest="action", required=True, metavar="ACTION")

    def action(name: str, text: str) -> argparse.ArgumentParser:
        return actions.add_parser(name, help=text, description=text)

    found = action("list", "the ports of this computer, and their instruments")
    found.add_argument("ports", nargs="*", metavar="PORT", help="a further port, such as a simulated one")
    found.add_argument("--timeout", type=float, default=1.0, metavar="SECONDS",
                       help="longest time for an answer (default 1)")
    check = action("check", "identify both instruments, set and read back, capture once; print faults")
    check.add_argument("bench", type=Path, metavar="BENCH.toml")
    served = action("simulate", "serve a simulated bench, two ports that speak the real protocols, until interrupted")
    served.add_argument("device", type=Path, nargs="?", metavar="DEVICE",
                        help="the measured device: a CHIP.toml, or a recorded spectrum; not needed with --connect")
    _with_state(served)
    _with_recording(served)
    _with_model(served)
    served.add_argument("--ports", type=Path, metavar="DIR", help="folder in which the ports 'generator' and "
                        "'oscilloscope' appear (default: a temporary one)")
    served.add_argument("--connect", default="device", metavar="WHAT",
                        help='device (default), open, short, or a load such as "50 ohm"')
    served.add_argument("--reference", default="0.5 ohm", metavar="R", help="the reference resistor (default 0.5 ohm)")
    served.add_argument("--probes", default="10,10", metavar="TOTAL,REFERENCE",
                        help="factors of the two probes, 1 or 10 each (default 10,10)")
    served.add_argument("--ideal", action="store_true",
                        help="no leads, probes without capacitance, exact gains (default: those of a real bench)")
    served.add_argument("--noise", type=float, default=0.4, metavar="COUNTS",
                        help="noise of the converter, root mean square (default 0.4)")
    served.add_argument("--drift", type=float, default=0.0, metavar="RATE",
                        help="relative change of the device's frequencies per simulated second (default 0)")
    served.add_argument("--pace", type=float, default=0.0, metavar="N",
                        help="real seconds for a simulated second, 1 for the speed of a real bench (default 0)")
    served.add_argument("--seed", type=int, default=0, metavar="N", help="of all noise (default 0)")
    served.add_argument("--fault", action="append", default=[], metavar="INSTRUMENT:KIND@N",
                        help="a fault at the Nth command, such as generator:silence@120; x3 after it repeats it three "
                             "times (may be repeated; default none)")


def _measure(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("bench", type=Path, metavar="BENCH.toml", help="instruments, resistor, sweep, drive, limits: see "
                     "the page on the bench")
    sub.add_argument("--resume", action="store_true",
                     help="continue an interrupted run (default: RUN.h5 must not exist)")
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="RUN.h5",
                     help="the run file; RUN.csv, the spectrum, and RUN.html, the report, are written beside it")


def _import(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("files", nargs="+", type=Path, metavar="FILE",
                     help="waveforms of an oscilloscope: CSV with all channels in one file, or CSV or ISF in pairs "
                     "named alike but for CH1 and CH2; or folders of them")
    sub.add_argument("--total", type=int, default=1, metavar="N",
                     help="channel across device and reference resistor (default 1)")
    sub.add_argument("--reference", type=int, default=2, metavar="N",
                     help="channel across the reference resistor (default 2)")
    sub.add_argument("--current", type=int, metavar="N", help="channel of a current probe: --total is then across the "
                     "device, and --resistance the volts per ampere of a probe in V (default: none)")
    sub.add_argument("--resistance", metavar="R", help='the reference resistor, such as "0.5 ohm" (default: none; only '
                     "the ratio of the two channels is written)")
    sub.add_argument("--tolerance", default="0 %", metavar="LIMITS", help='of the resistor, such as "1 %%" (default 0)')
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)
    # "import" is a keyword of Python, so the module has another name.
    sub.set_defaults(command="import_waveforms")


def _design(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("goal", type=Path, metavar="GOAL.toml",
                     help="variables, objectives and constraints; see workbench/design/goal.py")
    _with_jobs(sub, "starts")
    sub.add_argument("--no-cad", action="store_true", help="leave the solid model out")
    _with_accuracy(sub)
    _with_filling(sub)
    sub.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help=OUTPUT_HELP)


def _doctor(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--json", action="store_true", help="print a record in place of lines (default: lines)")


#: Purpose of every command, and the function that adds its options.
COMMANDS: Mapping[str, tuple[str, Callable[[argparse.ArgumentParser], None]]] = {
    "simulate": ("spectrum, figures of merit, fields, traps, CAD and report of a chip", _simulate),
    "study": ("figures of a chip over ranges of its dimensions and materials, resumable, with pictures", _study),
    "compare": ("compare a recorded impedance, or focusing over frequency, with a simulated chip", _compare),
    "mesh": ("mesh a chip; with --converge the change of f0 and Z_min between refinements", _mesh),
    "export": ("write the solids of a chip as STEP and STL", _export),
    "modes": ("the modes of a chip, which are the peaks of its spectrum, with pictures", _modes),
    "along": ("a straight chip between its ends: impedance, energy along the channel, where beads bunch", _along),
    "render": ("draw the fields of a chip at one frequency", _render),
    "particles": ("follow the particles of a chip: where they are after minutes, with pictures", _particles),
    "sensitivity": ("rank the constants of a transducer by their effect on its spectrum", _sensitivity),
    "tolerance": ("the effect of tolerances on a chip: sensitivities, yield, tolerances to tighten", _tolerance),
    "fit": ("find material constants from recordings, with intervals, and save them", _fit),
    "diagnose": ("locate differences between model and recordings, and name the missing physics", _diagnose),
    "design": ("the best chip for a goal: lengths, stock and materials, confirmed by full solves", _design),
    "app": ("the live view: move dimensions and constants on a page, see spectrum and fields", _app),
    "measure": ("sweep on the bench into a crash-safe run file, with spectrum and report", _measure),
    "import": ("impedance from waveforms that an oscilloscope saved, in pairs", _import),
    "chips": ("list the chip files of the package, or copy one to begin with", _chips),
    "bench": ("the instruments: list, check, and a simulated bench", _bench),
    "doctor": ("check the installation, and print the lines for a bug report; status 1 if there is a fault", _doctor),
    "materials": ("list, show, compare, check, withdraw, export or import materials", _materials),
}
