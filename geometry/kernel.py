"""CadQuery, the kernel that makes solids. Lengths are in **millimetres** there, as in every CAD file."""

from __future__ import annotations

from types import ModuleType

#: Millimetres in a metre.
MILLIMETRES = 1e3


class SolidError(RuntimeError):
    """A solid differs from the chip, or CadQuery is not available."""


def cadquery_module() -> ModuleType:
    """CadQuery, which takes seconds to import.

    Raises:
        SolidError: it is not installed.
    """
    try:
        import cadquery
    except (ImportError, OSError) as error:
        raise SolidError(f"solids need CadQuery and its system libraries (./setup installs both): {error}; "
                         "simulate --no-cad leaves them out") from error
    module: ModuleType = cadquery
    return module
