"""The scripts of the page: plain JavaScript in files named by the thing in them, inlined in its head and at its end."""

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path

TEMPLATES = Path(__file__).parent / "templates"
FIRST_SCRIPTS = ("theme",)  # run before anything is drawn, so that no page flashes in the wrong colours
SCRIPTS = (
    *("zoom_window", "pointer_gestures", "picture_grid", "curve_cursor", "row_cutter", "linked_slices"),
    *("heat_map", "sortable_table", "viewer", "start"),
)


def page_script(names: Sequence[str] = SCRIPTS) -> str:
    """Scripts in the order in which they build on each other; the last one starts the page."""
    parts = [(TEMPLATES / f"{name}.js").read_text(encoding="utf-8") for name in names]
    return "\n".join(['"use strict";', *parts])


def script_digest(script: str) -> str:
    """What the page's policy knows a script by: SHA-256 of the text in UTF-8, in base64."""
    return base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
