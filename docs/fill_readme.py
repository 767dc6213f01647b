"""Write the measured figures into README.md: ``python docs/fill_readme.py`` after `make reports bench validate`.

The README's tables stand between ``<!-- name -->`` and ``<!-- /name -->``; nothing between them is typed by hand.
"""

import json
import re
from pathlib import Path
from typing import Any

import pandas as pd

from ggvs_eval.errors import ResultsError
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, read_json

ROOT = Path(__file__).parents[1]
OUT = ROOT / "out"
DECIMALS = {"PSNR": 2, "PSNR_cc": 2, "SSIM": 3, "LPIPS": 3, "L1": 2, "TCC": 3, "STED": 2, "Flicker": 2, "SDT": 3, "SDV": 3}
DECIMALS |= {"EPI_coherence": 3, "switch_ratio": 2}
# One region of the rooms stands for all; `python -m ggvs_eval.pipelines.depth_validation` prints the others.
DEPTH_FIGURES = r"depth\.(motorcycle\.(epe_px|bad_[23]_percent)\.[^.]*$|sparse|rendering|(rooms|demo)\.whole_picture)"


def main() -> None:
    """Fill every table whose figures have been computed."""
    tables = {
        "demo": lambda: results_table(OUT / "demo"),
        "ceilings": lambda: ceilings_table(OUT / "demo"),
        "calibration": lambda: figures_table(OUT / "validate.json", r"calibration\."),
        "real_frame": lambda: results_table(OUT / "real_frame"),
        "real_frame_views": lambda: views_table(OUT / "real_frame"),
        "validate": lambda: figures_table(OUT / "validate.json", r"(?!calibration|depth)"),
        "depth": lambda: figures_table(OUT / "depth_validation" / "figures.json", DEPTH_FIGURES),
        "bench": lambda: figures_table(OUT / "bench.json"),
    }
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for name, make in tables.items():
        pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
        if not pattern.search(text):
            raise SystemExit(f"README.md has no place for the table {name}")
        try:
            table = make()
        except (FileNotFoundError, ResultsError) as error:
            print(f"{name} is left as it is: {error}")
            continue
        text = pattern.sub(lambda match, table=table: f"{match[1]}{table}\n{match[2]}", text)
    (ROOT / "README.md").write_text(text, encoding="utf-8")


def results_table(run: Path) -> str:
    """Means of one run as Markdown, methods by their shown names."""
    summary = Results.read(run).summary().droplevel("dataset")
    columns = [name for name in DECIMALS if name in summary.columns]
    return _markdown(_named(summary[columns], run))


def views_table(run: Path) -> str:
    """PSNR per test view as Markdown."""
    return _markdown(_named(Results.read(run).per_view("PSNR"), run))


def ceilings_table(run: Path) -> str:
    """What perfect renderings would score on the capture of one run, as Markdown."""
    entries = [entry for entry in read_json(run / "references.json") if entry["group"] == "consistency"]
    columns = list(entries[0]["values"])
    values = [[entry["values"][column] for column in columns] for entry in entries]
    return _markdown(pd.DataFrame(values, [entry["name"] for entry in entries], columns))


def figures_table(file: Path, names: str = "") -> str:
    """Flat figures whose names begin with a pattern, as Markdown; a ratio above 1 means better than the peer."""
    known: dict[str, dict[str, Any]] = json.loads(file.read_text(encoding="utf-8"))
    figures = {name: figure for name, figure in known.items() if re.match(names, name)}
    if not figures:
        raise ResultsError(f"{file} holds no such figures")
    rows = ["| figure | value | target | peer | ratio |", "| --- | ---: | ---: | --- | ---: |"]
    for name, figure in figures.items():
        sign = "≥" if figure["higher_is_better"] else "≤"
        target = "" if figure.get("target") is None else f"{sign} {figure['target']:.4g}"
        peer = f"{figure['peer']}: {figure['peer_value']:.4g}" if figure.get("peer") else ""
        ratio = f"{figure['ratio']:.3g}" if figure.get("ratio") is not None else ""
        rows.append(f"| {name} | {figure['value']:.4g} {figure['unit']} | {target} | {peer} | {ratio} |")
    return "\n".join(rows)


def _named(table: pd.DataFrame, run: Path) -> pd.DataFrame:
    names = read_json(RunFolder(run).root / "methods.json")["names"]
    index = ["+".join(filter(None, label)) for label in table.index]
    return table.set_axis([names.get(label, label) for label in index], axis=0)


def _markdown(table: pd.DataFrame) -> str:
    rows = ["| method | " + " | ".join(map(str, table.columns)) + " |", "| --- |" + " ---: |" * len(table.columns)]
    for name, values in table.iterrows():
        cells = (f"{value:.{DECIMALS.get(column, DECIMALS['PSNR'])}f}" for column, value in values.items())
        rows.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


if __name__ == "__main__":
    main()
