"""What users get: the installed wheel, with no checkout on the path. ``make wheel-test`` runs this
file.
"""

import configparser
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import ggvs_eval
from ggvs_eval.built_in import VERBS
from ggvs_eval.pipelines.commands.main import run_command
from helpers.packed_films import unpack_film

pytestmark = pytest.mark.wheel

PACKAGE = Path(str(ggvs_eval.__file__)).parent
# Imports every module of the package in one process; prints those that fail and which module it is
# that they miss.
IMPORT_ALL = """
import importlib, json, pkgutil
import ggvs_eval
failures = {}
for module in pkgutil.walk_packages(ggvs_eval.__path__, "ggvs_eval."):
    try:
        importlib.import_module(module.name)
    except ImportError as error:
        failures[module.name] = str(error.name)
print(json.dumps(failures))
"""


@pytest.fixture(scope="module")
def checkout() -> Path:
    """The folder that the wheel was built from, which the Makefile names."""
    folder = os.environ.get("GGVS_EVAL_CHECKOUT")
    if not folder:
        pytest.skip("GGVS_EVAL_CHECKOUT names no checkout to compare the wheel with")
    return Path(folder)


def listed_files(checkout: Path) -> set[str]:
    """Files that setup.cfg names, relative to the installed package: modules of its packages, and
    their data.
    """
    config = configparser.ConfigParser()
    config.read(checkout / "setup.cfg")
    rooms = dict(line.split(" = ") for line in config["options"]["package_dir"].split("\n") if line)
    patterns = {
        package: data.split(", ") for package, data in config["options.package_data"].items()
    }
    files = set()
    for package in config["options"]["packages"].split():
        room = ".".join(package.split(".")[:2])
        inner = package.removeprefix("ggvs_eval").strip(".").replace(".", "/")
        folder = checkout / (inner if room in rooms else f"ggvs_eval/{inner}")
        for pattern in ("*.py", *patterns.get(package, [])):
            files |= {
                f"{inner}/{file.relative_to(folder)}".lstrip("/")
                for file in folder.glob(pattern)
                if file.is_file()
            }
    return files


def test_the_wheel_holds_the_files_that_are_listed(checkout):
    """Every module and data file of setup.cfg and every compiled kernel is installed, and nothing
    else but its stubs.
    """
    assert checkout not in PACKAGE.resolve().parents or "build" in PACKAGE.resolve().parts
    installed = {
        str(file.relative_to(PACKAGE))
        for file in PACKAGE.rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    kernels = {name for name in installed if name.endswith(".so")}

    assert installed - kernels == listed_files(checkout)
    assert len(kernels) == len({name.split(".")[0] for name in kernels}) == 8


def test_every_module_can_be_imported():
    """What fails misses a package of an extra that is not installed, never a file of ours."""
    output = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, check=True
    ).stdout
    failures = json.loads(output.splitlines()[-1])

    assert {missing for missing in failures.values() if missing.startswith("ggvs_eval")} == set()
    assert set(failures.values()) <= {
        "warp",
        "distributed",
        "dask",
        "viser",
        "tensorboardX",
        "mlflow",
        "wandb",
        "cvvdp",
    }


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help(verb, capsys):
    """`--help` ends with 0 and shows how the verb is called."""
    with pytest.raises(SystemExit) as ended:
        run_command([verb, "--help"])

    assert ended.value.code in (0, None)
    assert f"ggvs-eval {verb}" in " ".join(capsys.readouterr().out.split())


def test_a_run_ends_with_its_page(tmp_path):
    """The command that was installed runs two methods on a capture, prints their scores and the
    path of the page.
    """
    unpack_film("small", tmp_path / "room", with_depth=False)
    command = [Path(sys.executable).with_name("ggvs-eval"), "run", "out", "--capture", "room"]
    options = ["--methods", "no-blending", "ours-geometric", "--jobs", "1"]
    done = subprocess.run(
        [*command, *options], cwd=tmp_path, capture_output=True, text=True, check=False
    )

    assert done.returncode == 0, done.stderr
    assert "ours-geometric" in done.stdout
    page = tmp_path / done.stdout.split()[-1]
    assert page.name == "index.html"
    assert "No Blending" in page.read_text(encoding="utf-8")
