"""The files of a release follow from the package: conda recipe, Croissant description, lock file,
paper.
"""

import re
import sys

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.version import Version

from ggvs_eval.protocol import packaged_protocols
from ggvs_eval.sweep import packaged_sweeps
from helpers.places import ROOT

if not (ROOT / "setup.cfg").exists():
    pytest.skip("these tests read the checkout", allow_module_level=True)

sys.path.insert(0, str(ROOT / "tools" / "release"))
import release_files

PAPER = ROOT / "paper" / "paper.md"
WORDS = (250, 1750)  # of the Journal of Open Source Software


def required() -> list[Requirement]:
    """Requirements of the package and of its contributors, by setup.cfg."""
    config = release_files.setup_options()
    texts = config["options"]["install_requires"], config["options.extras_require"]["dev"]
    return [Requirement(line) for text in texts for line in release_files.requirement_lines(text)]


def test_recipe_and_data_set_are_those_of_the_sources():
    """`python tools/release/release_files.py` writes both; a changed requirement or demo file makes
    them old.
    """
    assert release_files.RECIPE.read_text("utf-8") == release_files.recipe_text()
    assert release_files.CROISSANT.read_text("utf-8") == release_files.croissant_text()


def test_the_recipe_is_a_recipe():
    """YAML of rattler-build's schema, with a bound for each package that setup.cfg bounds."""
    recipe = yaml.safe_load(release_files.RECIPE.read_text("utf-8"))
    run = dict(line.partition(" ")[::2] for line in recipe["requirements"]["run"])

    assert recipe["schema_version"] == 1
    assert run["pytorch"] == "==2.13.0"
    assert run["python"] == release_files.setup_options()["options"]["python_requires"]
    assert all(run.values())


def test_the_lock_has_a_fitting_version_of_each_requirement():
    """Every requirement is locked within its bounds, for platforms alike; no index is named."""
    lines = release_files.LOCK.read_text("utf-8").splitlines()
    locked = [Requirement(line) for line in lines if line and not line.startswith("#")]
    for wanted in required():
        versions = [
            next(iter(line.specifier)).version
            for line in locked
            if line.name == wanted.name.lower()
        ]
        assert versions, (
            f"{wanted} is not in requirements.lock; run `python tools/release/release_files.py "
            f"--lock`"
        )
        assert all(Version(version) in wanted.specifier for version in versions)
    assert "://" not in "".join(lines)


def test_the_paper_names_what_there_is():
    """Commands, protocols and sweeps exist, every citation has an entry and each entry a citation,
    and its length fits.
    """
    from ggvs_eval.pipelines.commands.main import COMMANDS

    text = PAPER.read_text("utf-8")
    entries = set(
        re.findall(r"^@\w+\{(\w+),", (PAPER.parent / "paper.bib").read_text("utf-8"), re.MULTILINE)
    )
    commands = re.findall(r"`ggvs-eval ([\w-]+)", text)

    assert set(re.findall(r"@(\w+)[\];]", text)) == entries
    assert set(commands) <= set(COMMANDS)
    assert set(re.findall(r"--protocol (\w+)", text)) <= set(packaged_protocols())
    assert set(re.findall(r"ggvs-eval sweep (\w+)", text)) <= set(packaged_sweeps())
    assert WORDS[0] <= len(text.partition("# Summary")[2].split()) <= WORDS[1]
