"""The folder of a sweep over K made by hand, as `ggvs-eval sweep` leaves one."""

from dataclasses import replace
from pathlib import Path

import pandas as pd

from helpers.run_folders import RunShape, write_run

SWEPT = RunShape(metrics=("PSNR",), poses=0, views=("cam00",))
KS = (2, 3, 5)
LINES = [
    (f"k{k}", method, base + k / 10, 0.2 * k)
    for k in KS
    for method, base in (("GGVS (online)", 30.0), ("No Blending", 20.0))
]


def write_sweep(root: Path) -> Path:
    """A sweep of one capture over three K: a run folder for each, and the table."""
    for k in KS:
        write_run(root / f"k{k}", replace(SWEPT, k=k))
    pd.DataFrame(LINES, columns=["variant", "method", "PSNR", "s/frame"]).to_csv(
        root / "sweep.csv", index=False
    )
    return root
