"""The command line: what a user can mend is one line and exit code 1, and names the mend."""

import re
import shlex
import shutil
import subprocess
import sys
import warnings
from functools import wraps
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
import tyro

import ggvs_eval
from ggvs_eval.built_in import VERBS
from ggvs_eval.errors import GgvsWarning
from ggvs_eval.pipelines.commands import main
from ggvs_eval.pipelines.commands.main import COMMANDS, run_command
from ggvs_eval.protocol import load_protocol
from helpers.captures import write_dynerf
from helpers.command_line import refusal


@pytest.fixture
def rig(tmp_path) -> Path:
    return write_dynerf(tmp_path / "rig")


def lose_a_video(rig: Path) -> None:
    min(rig.glob("*.mp4")).unlink()


def cut_a_video(rig: Path) -> None:
    video = sorted(rig.glob("*.mp4"))[1]
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])


def spoil_a_pose(rig: Path) -> None:
    poses = np.load(rig / "poses_bounds.npy")
    poses[2, 3] = np.nan
    np.save(rig / "poses_bounds.npy", poses)


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (lose_a_video, "poses_bounds.npy"),
        (cut_a_video, "cam01.mp4"),
        (spoil_a_pose, "row 2"),
        (shutil.rmtree, "rig"),
    ],
)
def test_a_damaged_capture_is_named(damage, named, rig, tmp_path):
    """Before anything is computed: the file or the row, and where it is gone, the folder."""
    damage(rig)

    assert named in refusal("run", tmp_path / "run", "--capture", rig)


def test_an_unknown_protocol_key_names_the_nearest(rig, tmp_path):
    """A mistyped key of a protocol file names the right one."""
    (tmp_path / "mine.toml").write_text('nmae = "x"\n')

    message = refusal(
        "run", tmp_path / "run", "--capture", rig, "--protocol", tmp_path / "mine.toml"
    )

    assert "unknown key nmae; did you mean name?" in message


def test_a_folder_that_is_no_run_says_how_to_make_one(tmp_path):
    """Scoring or rendering something else than a run folder names the command that makes one;
    nothing is to be deleted.
    """
    assert "ggvs-eval run" in refusal("score", tmp_path)
    assert "wanted a run folder" in refusal("render", tmp_path, "--methods", "no-blending")


def helped(capsys, *words: str) -> str:
    """What `ggvs-eval WORDS --help` prints, spaces and frames taken out."""
    with pytest.raises(SystemExit) as caught:
        run_command([*words, "--help"])
    assert caught.value.code == 0
    return " ".join(capsys.readouterr().out.replace("│", " ").split())


def all_commands():
    """The words that call each command, and the function that they call."""
    for name, command in COMMANDS.built_in().items():
        if isinstance(command, dict):
            yield from (((name, inner), function) for inner, function in command.items())
        else:
            yield (name,), command


@pytest.mark.parametrize(("words", "command"), list(all_commands()))
def test_every_command_explains_itself(words, command, capsys, monkeypatch):
    """Its help says what it does, each box by a name of its own, and shows an example, which can be
    typed as it stands.
    """
    called, example = (
        " ".join(("ggvs-eval", *words)),
        VERBS[words[0]].example.replace("NETWORK", words[-1]),
    )
    told = helped(capsys, *words)
    assert f"usage: {called} " in told
    assert command.__doc__.partition("\n")[0] in told
    assert "options options" not in told
    assert f"Example: {called} {example}" in told
    assert "None}" not in told  # which no user types

    taken = []
    recorded = wraps(command)(lambda *arguments, **options: taken.append((arguments, options)))
    table = COMMANDS.shipped if len(words) == 1 else COMMANDS[words[0]]
    monkeypatch.setitem(table, words[-1], recorded)
    run_command([*words, *shlex.split(example)])
    assert len(taken) == 1


def test_the_overview_names_every_command(capsys):
    """`ggvs-eval --help` and `ggvs-eval train --help`: a line for each command and each network."""
    overview = helped(capsys)
    assert [name for name in COMMANDS if f" {name} " not in overview] == []
    networks = helped(capsys, "train")
    assert all(f" {name} Train " in networks for name in ("blend", "stereo", "ibrnet", "all"))


def test_the_overview_says_what_the_commands_say():
    """Its lines are the first of the commands' own help, which it does not load."""
    said = {
        name: (command.__doc__ or "").partition("\n")[0]
        for name, command in COMMANDS.items()
        if callable(command)
    }
    assert {name: VERBS[name].about for name in said} == said


@pytest.mark.slow
def test_the_overview_loads_no_command():
    """No torch, no scipy, no numpy and no verb, neither for help nor for the version; by the
    installed program too.
    """
    code = (
        "import sys\nfrom ggvs_eval.pipelines.commands.main import run_command\n"
        "for word in ('--help', '--version'):\n"
        "    try: run_command([word])\n"
        "    except SystemExit: pass\n"
        "heavy = {'torch', 'scipy', 'numpy', 'tyro', 'ggvs_eval.capture', "
        "'ggvs_eval.pipelines.commands.runs'}\n"
        "print(sorted(heavy & sys.modules.keys()), file=sys.stderr)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stderr.strip() == "[]"
    overview = subprocess.run(
        [sys.executable, "-m", "ggvs_eval", "--help"], capture_output=True, text=True, check=True
    ).stdout
    assert ended.stdout.startswith(overview)


def test_a_verb_of_a_package_that_is_not_there_is_one_line(monkeypatch):
    """The overview leaves it out, and who asks for it is told what lacks."""
    monkeypatch.setitem(COMMANDS.shipped, "fly", "ggvs_eval.contrib.wings.flight:fly")
    assert "fly" not in list(COMMANDS)
    wanted = (
        "fly is part of ggvs_eval.contrib.wings, which is not installed; reinstall ggvs-eval "
        "or omit it"
    )
    assert refusal("fly") == f"ggvs-eval: {wanted}"


def test_a_mistyped_option_names_the_nearest_of_its_command(capsys):
    """`demo --quik` is told of `--quick`, `run --protcol` of `--protocol`, once and not of that of
    every other command.
    """
    with pytest.raises(SystemExit, match="2"):
        run_command(["demo", "out", "--quik"])
    assert "--quick" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        run_command(["run", "out", "--protcol", "dynerf"])
    told = capsys.readouterr().err

    assert "Perhaps you meant" in told
    assert told.count("--protocol") == 1


def test_options_are_those_of_the_network(capsys, tmp_path):
    """A network's training offers its own options, and refuses those of another network."""
    assert "--guidance" in helped(capsys, "train", "blend")
    for network in ("stereo", "ibrnet", "all"):
        assert "--guidance" not in helped(capsys, "train", network)
    with pytest.raises(SystemExit, match="2"):
        run_command(["train", "stereo", str(tmp_path), "--captures", str(tmp_path)])
    assert "Unrecognized options: --captures" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "ends"),
    [
        (("trian",), "no command 'trian'; commands are demo, .*; did you mean train?"),
        (
            ("train", "blnd", "out"),
            "no command 'train blnd'; commands are blend, .*; did you mean blend?",
        ),
        (
            ("explain", "run", "ssmi", "0.9"),
            "wanted a metric with known conventions, got 'ssmi'; known are psnr, .*; did you mean "
            "ssim?",
        ),
    ],
)
def test_a_mistyped_name_suggests_the_nearest(arguments, ends):
    """Commands, networks and metrics: the line lists what there is and ends with what was probably
    meant.
    """
    assert re.search(ends.replace("?", r"\?") + "$", refusal(*arguments))


@pytest.mark.parametrize(
    "verb", [("film", "out"), ("check", "room"), ("score", "out"), ("play", "room", "out.mp4")]
)
def test_no_process_at_all_is_one_line(verb):
    """Each verb that starts processes wants at least one, also where it would find nothing
    to do.
    """
    assert refusal(*verb, "--jobs", "0").endswith("--jobs 0: wanted at least 1")


@pytest.mark.parametrize(
    "words",
    [
        ("run", "RUN", "--capture", "NOWHERE"),
        ("score", "RUN", "--capture", "NOWHERE"),
        ("sweep", "k", "RUN", "--capture", "NOWHERE"),
    ],
)
def test_a_mistyped_metric_of_a_protocol_is_named_before_anything_is_read(words, tmp_path):
    """The file, the wrong name and the nearest one, though the capture is not there."""
    file = tmp_path / "typo.toml"
    file.write_text(load_protocol("rooms").to_toml().replace('"PSNR"', '"PSRN"'))
    message = refusal(
        *(tmp_path / word if word.isupper() else word for word in words), "--protocol", file
    )
    assert f"{file}: measurement.metrics: no metric 'PSRN'; did you mean PSNR?" in message


@pytest.mark.parametrize("words", [("render", "RUN"), ("run", "RUN", "--capture", "NOWHERE")])
def test_a_mistyped_method_is_named_before_anything_is_read(words, tmp_path):
    """Though there is no such run and no such capture."""
    message = refusal(
        *(tmp_path / word if word.isupper() else word for word in words), "--methods", "oars"
    )
    assert "unknown method 'oars'; did you mean ours?" in message


def test_our_warnings_are_written_as_our_errors_are(monkeypatch, capsys):
    """Without the place in the code; those of libraries keep theirs."""

    def warn(folder: Annotated[Path, tyro.conf.Positional]) -> None:
        warnings.warn("depth is doubtful", GgvsWarning, stacklevel=1)
        warnings.warn("of a library", UserWarning, stacklevel=1)

    monkeypatch.setattr(main, "COMMANDS", {"status": warn})
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    warnings.simplefilter("always")
    run_command(["status", "nowhere"])
    ours, *others = capsys.readouterr().err.splitlines()
    assert ours == "ggvs-eval: depth is doubtful"
    assert "test_cli.py" in others[0]


def test_the_version_is_that_of_the_distribution(capsys):
    """On the command line and as an attribute."""
    run_command(["--version"])
    assert capsys.readouterr().out == f"ggvs-eval {version('ggvs-eval')}\n"
    assert ggvs_eval.__version__ == version("ggvs-eval")
