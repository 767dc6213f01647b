"""Tests import their scene and capture builders as plain modules, in the checkout and beside an installed wheel alike."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
