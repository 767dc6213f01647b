"""Write the files of a release that follow from others: ``python tools/release/release_files.py
[--lock]``.

conda/recipe.yaml follows from setup.cfg and pyproject.toml; croissant.json (MLCommons' description
of a data set) from the demo capture that ships. ``--lock`` also resolves requirements.lock anew by
uv, which asks the package index. tests/test_release.py fails where a file is older than its
sources.
"""

import configparser
import hashlib
import json
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
RECIPE, CROISSANT, LOCK = (
    ROOT / "conda" / "recipe.yaml",
    ROOT / "croissant.json",
    ROOT / "requirements.lock",
)
DEMO = Path("ggvs_eval/synthetic/shipped_demo")
# Names that conda-forge gives to packages of PyPI, where they differ.
CONDA_NAMES = {
    "matplotlib": "matplotlib-base",
    "open3d": "open3d",
    "opencv-python-headless": "py-opencv",
    "torch": "pytorch",
}
CONDA_LEFT_OUT = ("open3d-cpu",)  # a name of PyPI alone for one platform
MEDIA_TYPES = {
    ".mp4": "video/mp4",
    ".mkv": "video/x-matroska",
    ".npy": "application/x-npy",
    ".json": "application/json",
}
LOCK_COMMAND = (
    *(
        "uv",
        "pip",
        "compile",
        "setup.cfg",
        "--extra",
        "dev",
        "--universal",
        "--python-version",
        "3.11",
    ),
    *("--no-annotate", "--no-header", "--default-index", "https://pypi.org/simple"),
)
LOCK_HEAD = """# Versions that contributors share: `uv venv && uv pip sync requirements.lock && uv pip install --no-deps -e .`
# Written by `python tools/release/release_files.py --lock` from setup.cfg; names no index.
"""  # noqa: E501
# Croissant 1.0's own context: each of its words, and those that come from elsewhere.
CROISSANT_WORDS = (
    *(
        "citeAs",
        "column",
        "equivalentProperty",
        "extract",
        "field",
        "fileProperty",
        "fileObject",
        "fileSet",
        "format",
    ),
    *(
        "includes",
        "isLiveDataset",
        "jsonPath",
        "key",
        "md5",
        "parentField",
        "path",
        "recordSet",
        "references",
        "regex",
    ),
    *("repeated", "replace", "samplingRate", "separator", "source", "subField", "transform"),
)
CROISSANT_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
    **{word: f"cr:{word}" for word in CROISSANT_WORDS},
}


def main() -> None:
    """Write all of them."""
    RECIPE.write_text(recipe_text(), encoding="utf-8")
    CROISSANT.write_text(croissant_text(), encoding="utf-8")
    if "--lock" in sys.argv[1:]:
        LOCK.write_text(LOCK_HEAD + resolve_lock(), encoding="utf-8")


def setup_options() -> configparser.ConfigParser:
    """Return setup.cfg."""
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg", encoding="utf-8")
    return config


def requirement_lines(text: str) -> list[str]:
    """Return the requirements of a value of setup.cfg, without comments."""
    lines = [line.strip() for line in text.splitlines()]
    return [line for line in lines if line and not line.startswith("#")]


def conda_requirements(lines: list[str]) -> list[str]:
    """Return requirements of PyPI as conda-forge names them."""
    requirements = []
    for line in lines:
        plain, _, _marker = line.partition(";")
        name = plain.strip()
        for at, character in enumerate(name):
            if not (character.isalnum() or character in "-_."):
                name, bounds = name[:at], name[at:].strip()
                break
        else:
            bounds = ""
        if name not in CONDA_LEFT_OUT:
            requirements.append(f"{CONDA_NAMES.get(name, name)} {bounds}".strip())
    return requirements


def recipe_text() -> str:
    """Return the recipe of conda-build's successor (rattler-build), as conda-forge takes it."""
    config = setup_options()
    metadata, options = config["metadata"], config["options"]
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"][
        "requires"
    ]
    python = f"python {options['python_requires']}"
    (script,) = requirement_lines(config["options.entry_points"]["console_scripts"])
    command, _, place = (part.strip() for part in script.partition("="))
    host = [python, "pip", *conda_requirements(build)]
    run = [python, *conda_requirements(requirement_lines(options["install_requires"]))]
    lines = [
        "# Written by tools/release/release_files.py from setup.cfg; do not edit.",
        "# rattler-build build --recipe conda/recipe.yaml -c conda-forge",
        "schema_version: 1",
        "package:",
        f"  name: {metadata['name']}",
        f"  version: {metadata['version']}",
        "source:",
        "  path: ..",
        "build:",
        "  number: 0",
        "  script: ${{ PYTHON }} -m pip install . --no-deps --no-build-isolation -vv",
        "  python:",
        "    entry_points:",
        f"      - {command} = {place}",
        "requirements:",
        "  build:",
        "    - ${{ compiler('cxx') }}",
        "  host:",
        *(f"    - {requirement}" for requirement in host),
        "  run:",
        *(f"    - {requirement}" for requirement in run),
        "tests:",
        "  - python:",
        "      imports:",
        "        - ggvs_eval",
        "        - ggvs_eval.kernels._core",
        "      pip_check: false  # the names of PyPI and conda-forge differ",
        "  - script:",
        f"      - {command} --version",
        "about:",
        f"  summary: {metadata['description']}",
        f"  license: {metadata['license']}",
        f"  license_file: {metadata['license_files']}",
    ]
    return "\n".join(lines) + "\n"


def croissant_text() -> str:
    """Return the demo capture as Croissant 1.0: each file with its type, size and SHA-256."""
    config = setup_options()["metadata"]
    files = sorted(file for file in (ROOT / DEMO).rglob("*") if file.is_file())
    videos = [file for file in files if file.parent == ROOT / DEMO and file.suffix == ".mp4"]
    description = {
        "@context": CROISSANT_CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": "ggvs-eval-demo",
        "description": (
            f"A procedural dynamic room in the layout of Neural 3D Video: {len(videos)} "
            "synchronised cameras, their poses, and the exact images of a camera path at one "
            "instant. Made by ggvs-eval; nobody is in it."
        ),
        "version": config["version"],
        "license": "https://spdx.org/licenses/MIT.html",
        "url": DEMO.as_posix(),
        "datePublished": "2026-01-01",
        "citeAs": (ROOT / "CITATION.bib").read_text(encoding="utf-8").partition("\n\n")[2].strip(),
        "keywords": ["multi-view video", "view synthesis", "synthetic"],
        "distribution": [file_object(file) for file in files],
    }
    return json.dumps(description, indent=1) + "\n"


def file_object(file: Path) -> dict[str, Any]:
    """Return a file of the data set, by its path from the root of the checkout."""
    place = file.relative_to(ROOT).as_posix()
    return {
        "@type": "cr:FileObject",
        "@id": file.relative_to(ROOT / DEMO).as_posix(),
        "name": file.relative_to(ROOT / DEMO).as_posix(),
        "contentUrl": place,
        "contentSize": f"{file.stat().st_size} B",
        "encodingFormat": MEDIA_TYPES[file.suffix],
        "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
    }


def resolve_lock() -> str:
    """Return the newest versions that fit together, for all platforms and Pythons.

    Asks the package index.
    """
    resolved = subprocess.run(LOCK_COMMAND, cwd=ROOT, capture_output=True, text=True, check=True)
    return resolved.stdout


if __name__ == "__main__":
    main()
