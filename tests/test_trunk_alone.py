"""The trunk works alone: with every leaf deleted the README's renders are scored and shown; each
leaf comes back alone.
"""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import ggvs_eval
from ggvs_eval.tasks.identity import TOP_ROOMS
from helpers.deleted_parts import RUN_COMMANDS
from helpers.house_measures import imported_names
from helpers.import_graph import modules
from helpers.leaves import LEAVES, leaf_of, names_of_api, needs_of
from helpers.places import ROOT

MODULES = modules()
KEPT = "metrics"  # that the README prints; each of them is loaded by name as well
PARTS = sorted({leaf for module in MODULES if (leaf := leaf_of(module)) and leaf != KEPT})
OF_DEPTH = (
    "matcher sgbm",
    "matcher live",
    "matcher sweep",
    "matcher raft",
    "IterMVS",
    "sensor depth",
)
BLOCK = re.compile(r"```sh\n(ggvs-eval demo .*?)```", re.DOTALL)
PRINTED = re.compile(r"^ *(PSNR|late|mine) +([A-Z].*|[\d. ±†*]+)$", re.MULTILINE)
ASKED = (
    "check ROOM",
    "calibrate VIDEOS OUT",
    "steadiness mine=RENDERS",
    "play ROOM OUT.mp4",
    "compare A B",
    "run RUN --methods fwd",
    "run RUN --methods ours",
    "run RUN --methods 4dgs",
)
RUN = f"{RUN_COMMANDS}print(json.dumps(run_commands(json.loads(sys.argv[1]))))"
# For each leaf a process of its own, in which other leaves are not found: imports its modules, and
# loads what the tables of built-ins name of them. A foreign package that is not installed is
# nobody's fault.
LOAD = """
import importlib, json, os, sys
import cv2, numpy, pandas, scipy.ndimage, torch  # once for all
from importlib.machinery import PathFinder
from ggvs_eval import built_in
from ggvs_eval.plugins import Registry

def load(own, hidden):
    finders = sys.meta_path[:]
    class Finder(PathFinder):
        @classmethod
        def find_spec(cls, name, path=None, target=None):
            specs = (finder.find_spec(name, path, target) for finder in finders if name not in hidden)
            return next(filter(None, specs), None)
    sys.meta_path[:] = [Finder]  # also in place of the finder of an editable install
    try:
        for module in own:
            importlib.import_module(module)
        for table, entries in vars(built_in).items():
            if table.isupper() and isinstance(entries, dict):
                registry = Registry(table, {name: getattr(entry, "target", entry) for name, entry in entries.items()})
                [registry[name] for name in registry.present() if registry.root(name) in own]
    except ModuleNotFoundError as error:
        return str(error) if error.name.startswith("ggvs_eval") else ""
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""

faults = {}
for leaf, (own, hidden) in json.load(open(sys.argv[1])).items():
    reading, writing = os.pipe()
    if not os.fork():
        os.write(writing, load(own, set(hidden)).encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        faults[leaf] = pipe.read()
    os.wait()
print(json.dumps(faults))
"""  # noqa: E501


@pytest.mark.slow
def test_the_trunk_imports_no_leaf():
    """Neither at the head of a module nor inside a function: leaves are known by the text of
    `built_in` alone.
    """
    wrong = {
        f"{module} imports {imported}"
        for module, file in MODULES.items()
        if not leaf_of(module)
        for imported, _ in imported_names(file)
        if leaf_of(imported)
    }

    assert sorted(wrong) == []


@pytest.mark.slow
def test_leaves_use_the_api_alone():
    """Of the trunk a leaf imports public modules, and the names that `ggvs_eval.api` lists
    besides.
    """
    public = names_of_api()
    wrong = {
        f"{module} imports {name} of {imported}"
        for module, file in MODULES.items()
        if leaf_of(module)
        for imported, name in imported_names(file)
        if not leaf_of(imported) and not {(imported, name), (imported, "*")} & public
    }

    assert sorted(wrong) == []


@pytest.mark.slow
def test_every_leaf_is_there():
    """A leaf's modules have not moved away under its list."""
    wrong = {
        part
        for parts in LEAVES.values()
        for part in parts
        if not any(leaf_of(name) and name.startswith(part) for name in MODULES)
    }

    assert wrong == set()


@pytest.fixture(scope="module")
def trunk(tmp_path_factory) -> Path:
    """A folder with the package, without any leaf: Python's path is this folder alone."""
    site = tmp_path_factory.mktemp("trunk")
    kept = {module for module in MODULES if leaf_of(module) == KEPT}
    copy_modules(
        site, {module for module in MODULES if not leaf_of(module)} | kept | needs_of(kept)
    )
    roots = {"": Path(str(ggvs_eval.__file__)).resolve().parent}
    roots |= {room: MODULES[room].parent for room in TOP_ROOMS if room != "contrib"}
    for room, root in roots.items():
        for file in root.rglob("*"):
            place = site / "ggvs_eval" / room / file.relative_to(root)
            if file.is_file() and file.suffix not in (".py", ".pyc") and not place.exists():
                place.parent.mkdir(parents=True, exist_ok=True)
                place.symlink_to(file)
    return site


def copy_modules(site: Path, names: set[str]) -> None:
    """Copy modules to where they are imported from."""
    for name in names:
        file = MODULES[name]
        place = site.joinpath("ggvs_eval", *name.split(".")) if name else site / "ggvs_eval"
        place = place / file.name if file.name == "__init__.py" else place.with_suffix(".py")
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, place)


def run_python(site: Path, code: str, argument: object, folder: Path) -> Any:
    """Run code on a copy of the package; returns what it printed as JSON in its last line."""
    ended = subprocess.run(
        [sys.executable, "-c", code, str(argument)],
        capture_output=True,
        text=True,
        env={"PATH": "", "HOME": str(folder), "PYTHONPATH": str(site), "PYTHONSAFEPATH": "1"},
        cwd=folder,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr[-2000:]
    return json.loads(ended.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def readme(trunk, tmp_path_factory) -> tuple[str, dict[str, tuple[object, str]]]:
    """The README, and what its first block of commands and those of `ASKED` write without any leaf,
    by verb or command.
    """
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    block = BLOCK.search(text)
    assert block is not None
    commands = [
        line.partition("  #")[0].removeprefix("ggvs-eval ") for line in block[1].splitlines()
    ]
    alone = [
        f"{command} --jobs 1" if command.startswith("score") else command for command in commands
    ]
    folder = tmp_path_factory.mktemp("readme")
    outputs = run_python(trunk, RUN, json.dumps([*alone, *ASKED]), folder)
    names = [*(command.split()[0] for command in commands), *ASKED]
    return text, dict(zip(names, outputs.values(), strict=True))


def read_table(text: str) -> dict[str, list[float]]:
    """Metric -> values of the rows of the table that `score` prints."""
    lines = reversed(PRINTED.findall(text))  # of columns that follow below the first ones count
    rows = {name: re.sub(r"± \S+|\*", "", values).split() for name, values in lines}
    columns = ["PSNR", *rows.pop("PSNR")]
    return {
        metric: [float(values[at]) for values in rows.values()]
        for at, metric in enumerate(columns)
        if metric != ".."
    }


@pytest.mark.slow
@pytest.mark.skipif(
    not (ROOT / "README.md").is_file(), reason="an installed wheel has no README; a checkout has"
)
def test_the_readme_prints_its_numbers_without_any_leaf(readme):
    """Its renders are scored and shown; a command of a leaf is one line that names the part."""
    text, outputs = readme

    code, printed = outputs["score"]
    assert code == 0
    wanted, scored = read_table(text), read_table(printed)
    names = wanted.keys() & scored.keys()  # LPIPS needs weights that are fetched
    assert {name: scored[name] for name in names} == {name: wanted[name] for name in names}
    assert names >= {"PSNR", "SSIM", "L1", "TCC"}
    code, page = outputs["report"]
    assert code == 0
    assert page.strip().endswith("index.html")
    for command in ASKED:
        line, _ = outputs[command]
        assert re.fullmatch(
            r"ggvs-eval: .+ is part of ggvs_eval\.[\w.]+, which is not installed; [^\n]+", line
        )


@pytest.fixture(scope="module")
def faults(tmp_path_factory) -> dict[str, str]:
    """What goes wrong in each leaf while it is the only one besides those that it builds on; empty
    if nothing does.

    And, ``without`` a matcher or sensors, in depth and the other matchers.
    """
    folder = tmp_path_factory.mktemp("leaves")
    cases = {}
    for leaf in PARTS:
        own = {module for module in MODULES if leaf_of(module) == leaf}
        hidden = {module for module in MODULES if leaf_of(module)} - own - needs_of(own)
        cases[leaf] = own, hidden
    for leaf in OF_DEPTH:
        hidden = {module for module in MODULES if leaf_of(module) == leaf}
        users = {
            part
            for part in OF_DEPTH
            if needs_of({name for name in MODULES if leaf_of(name) == part}) & hidden
        }
        remaining = {"depth", *OF_DEPTH} - {leaf} - users
        cases[f"without {leaf}"] = (
            {module for module in MODULES if leaf_of(module) in remaining},
            hidden,
        )
    for name, sets in cases.items():
        cases[name] = [[f"ggvs_eval.{module}" for module in sorted(modules)] for modules in sets]
    (folder / "cases.json").write_text(json.dumps(cases))
    return run_python(Path(str(ggvs_eval.__file__)).parents[1], LOAD, folder / "cases.json", folder)


@pytest.mark.slow
def test_a_leaf_comes_back_alone(faults):
    """With the leaves that it builds on, and no other, it is imported, and what the tables of
    built-ins name of it loads.
    """
    assert {leaf: faults[leaf] for leaf in PARTS if faults[leaf]} == {}


@pytest.mark.slow
def test_depth_does_without_each_of_its_parts(faults):
    """Depth and every matcher that does not build on the absent one are imported, and what the
    tables name of them loads.
    """
    assert {leaf: fault for leaf in OF_DEPTH if (fault := faults[f"without {leaf}"])} == {}
