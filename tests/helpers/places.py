"""Where the tests find files: their own, and those that may lie beside the checkout."""

from pathlib import Path

DATA_FOLDER = Path(__file__).parents[1] / "data"
# of the checkout; beside an installed wheel there is no more than the tests
ROOT = Path(__file__).resolve().parents[2]
# real captures and oracles; tests that want them skip where they are absent
SHARED = ROOT.parent / "shared"
