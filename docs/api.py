"""The list of public names for the page `api`, from `workbench.PUBLIC`."""

from __future__ import annotations

import workbench


def page() -> str:
    """One directive of autodoc for every public name, in reStructuredText."""
    parts = []
    for name in sorted(workbench.PUBLIC, key=str.lower):
        kind = "autoclass" if isinstance(getattr(workbench, name), type) else "autofunction"
        parts.append(f".. {kind}:: workbench.{name}\n" + ("   :members:\n" if kind == "autoclass" else ""))
    return "\n".join(parts)
