"""Arrows go one way: ggvs_eval <- metrics, baselines <- pipelines; reports read through ggvs_eval alone."""

import ast
import importlib.util
from pathlib import Path

import pytest

import ggvs_eval

# Package -> the packages it must not import. The command line and `pipelines.evaluate` alone may start a report.
FORBIDDEN = {
    "ggvs_eval": {"metrics", "baselines", "pipelines", "reports"},
    "metrics": {"baselines", "pipelines", "reports"},
    "baselines": {"metrics", "pipelines", "reports"},
    "pipelines": {"reports"},
    "reports": {"metrics", "baselines", "pipelines"},
}
DOORS = {"pipelines/commands/figures.py", "pipelines/run/evaluate.py", "ggvs_eval/__main__.py", "ggvs_eval/install.py"}


def folder_of(package: str) -> Path:
    name = "ggvs_eval" if package == "ggvs_eval" else f"ggvs_eval.{package}"
    spec = importlib.util.find_spec(name)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def imported_names(file: Path) -> set[str]:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    return names | {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}


def source_files(package: str) -> list[Path]:
    folder = folder_of(package)
    inner = {folder_of(other) for other in FORBIDDEN if other != package}
    return [file for file in folder.rglob("*.py") if not any(other in file.parents and other != folder for other in inner)]


@pytest.mark.parametrize("package", FORBIDDEN)
def test_no_package_imports_one_above_it(package):
    """A package imports only what stands below it; the doors are named."""
    wrong = [
        f"{package}/{file.relative_to(folder_of(package))} imports {name}"
        for file in source_files(package)
        if f"{package}/{file.relative_to(folder_of(package)).as_posix()}" not in DOORS
        for name in imported_names(file)
        for above in FORBIDDEN[package]
        if name == f"ggvs_eval.{above}" or name.startswith(f"ggvs_eval.{above}.")
    ]

    assert wrong == []


def test_importing_the_package_loads_nothing_heavy():
    """`import ggvs_eval` and its words stay light: torch, Open3D, pycolmap, PyAV and matplotlib load when they are used."""
    import subprocess
    import sys

    code = (
        "import sys, ggvs_eval.camera, ggvs_eval.capture, ggvs_eval.protocol, ggvs_eval.datasets;"
        "import ggvs_eval.pipelines.methods.registry;"
        "print([name for name in ('torch', 'open3d', 'pycolmap', 'av', 'matplotlib') if name in sys.modules])"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()

    assert loaded == "[]", ggvs_eval.__file__
