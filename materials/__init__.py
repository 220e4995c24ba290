"""Materials: numbers with unit, source and conditions, checked on loading.

>>> from materials import Registry >>> water = Registry().load("water", temperature=298.15) >>> pla =
Registry().load("pla")

A :class:`Registry` lists its materials (``names()``) and loads one by name (``load``): a frozen :class:`Piezoelectric`,
:class:`IsotropicSolid`, :class:`CubicSolid` or :class:`Fluid`. ``dataclasses.replace(material, density=7500.0)`` makes
a changed copy. Units are SI. Losses have the time factor e^{-i w t}: a *negative* imaginary stiffness or modulus and a
*positive* imaginary permittivity.

Adding a material
-----------------
1. Write ``data/<material>/<source_year>.toml`` (or the same inside a folder of your own, given to ``Registry``)::

       kind = "isotropic solid"            # or "piezoelectric", "cubic solid", "fluid"
       title = "Polylactic acid, 3-D printed"
       source = "acevedo_2026"             # a key of references.bib; a number below may name another
       conditions = "1.033 MHz, room temperature"
       default = true                      # only if a material has several entries

       density = { value = 1131.7, unit = "kg/m^3", rounding = 0.05 }
       bulk_modulus = { value = 3.57, loss = -0.03, unit = "GPa", rounding = 0.005 }
       shear_modulus = { value = 0.93, loss = -0.05, unit = "GPa", rounding = 0.005 }

   Write the numbers *as printed*, in the printed unit, with ``rounding`` (half a unit of the last printed digit) and,
   if known, ``uncertainty`` and ``loss_uncertainty`` (standard). A solid may be given by bulk_modulus shear_modulus,
   youngs_modulus poisson_ratio, longitudinal_speed shear_speed or longitudinal_speed poisson_ratio; a piezoelectric one
   in stress-charge form (c11 c12 c13 c33 c44 e31 e33 e15 eps11 eps33, permittivities at constant strain) or in the
   strain-charge form of datasheets (s11 s12 s13 s33 s44 d31 d33 d15 free_eps11 free_eps33), which coupling factors,
   frequency constants and Poisson's ratio may complete (see :mod:`materials.completion`).
2. Add the source to ``data/references.bib``. No source, no entry. Never average sources: one file each.
3. Numbers that depend on temperature get a ``law`` (see :mod:`materials.temperature`) and the file a reference
   ``temperature``; then all its numbers need one, with its range of validity.
4. Load it once. A wrong sign or a material that creates energy raises; if it creates energy only within its declared
   rounding, it loads with a :class:`PassivityWarning`. The tests find every file automatically.

Saved fits
----------
``fitted`` returns the initial material with the numbers of a fit, and ``save_fit`` writes it as the next version of an
entry in a user's folder (``user_folder()``)::

    found = fitted(start, {"c33": Value(121.7e9 - 0.3e9j, "Pa", "", uncertainty=2e8, low=..., high=...)}, fit=Fit(...))
    save_fit(found, "pzt4/disc_7", folder=user_folder())        # "pzt4/disc_7@1", next time "pzt4/disc_7@2"

The file has the same form as every other. Its ``source`` is ``"recording"``, the one key that is not in
``references.bib``: the ``[fit]`` table names the recording, with chip, band, algorithm and software (see
:mod:`materials.fit`), and ``material.fit`` has the same content. A version never changes; ``withdraw`` marks it
as withdrawn. ``check_use`` warns if a fitted material is used outside its band or with another density.
"""

from materials.assumed import ASSUMED, with_assumed_loss
from materials.completion import SheetWarning
from materials.describe import describe
from materials.difference import Difference, differences
from materials.entry import LossWarning
from materials.exchange import Imported, export_entries, import_entries
from materials.fit import Correlation, Fit, RecordingSource
from materials.history import Version, history, withdraw
from materials.kinds import CubicSolid, Fluid, IsotropicSolid, Material, Piezoelectric
from materials.passivity import PassivityWarning
from materials.registry import Registry, user_folder, user_registry
from materials.saving import fitted, save_fit
from materials.use import UseWarning, check_use
from materials.value import Value
from materials.versions import Withdrawal, WithdrawnWarning

__all__ = [
    "ASSUMED",
    "Correlation",
    "CubicSolid",
    "Difference",
    "Fit",
    "Fluid",
    "Imported",
    "IsotropicSolid",
    "LossWarning",
    "Material",
    "PassivityWarning",
    "Piezoelectric",
    "RecordingSource",
    "Registry",
    "SheetWarning",
    "UseWarning",
    "Value",
    "Version",
    "Withdrawal",
    "WithdrawnWarning",
    "check_use",
    "describe",
    "differences",
    "export_entries",
    "fitted",
    "history",
    "import_entries",
    "save_fit",
    "user_folder",
    "user_registry",
    "with_assumed_loss",
    "withdraw",
]
