"""The pictures that an example wrote below ``out``, for its page of the gallery."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import Any

STARTED = time.time()


def written(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Move what was drawn since the start into the gallery; an example is run in the folder of examples."""
    from sphinx_gallery.scrapers import figure_rst

    made = Path(block_vars["src_file"]).parent / "out"
    pictures = sorted((path for path in made.rglob("*.png") if path.stat().st_mtime > STARTED),
                      key=lambda path: path.stat().st_mtime)
    shown = []
    for path, name in zip(pictures, block_vars["image_path_iterator"], strict=False):
        shutil.move(path, name)
        shown.append(name)
    return str(figure_rst(shown, gallery_conf["src_dir"]))
