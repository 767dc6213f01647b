"""The blocks of README and of the guide, followed literally: what they print is what the pages
show.
"""

import contextlib
import io
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.protocol import Protocol, load_protocol
from ggvs_eval.synthetic import shipped
from helpers.places import ROOT
from helpers.small_runs import leave_out_figures
from helpers.walks import commands_of, follow

FRAMES = 4  # of the eight that the pages take
QUOTED = "31.86"  # PSNR of all eight, which README shows too
WHOLE = shipped.quick_protocol
PAGE, GUIDE = ROOT / "README.md", ROOT / "docs" / "guide.md"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PAGE.is_file(), reason="no README beside an installed wheel"),
]


def blocks(language):
    """The code of README in a language."""
    return re.findall(
        rf"^```{language}\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )


def short_protocol() -> Protocol:
    """README's protocol by those of its metrics that need no network."""
    whole = WHOLE()
    measurement = replace(whole.measurement, metrics=("PSNR", "SSIM", "L1", "TCC"), ceilings=False)
    return replace(whole, measurement=measurement)


@pytest.fixture(scope="module", params=["short", pytest.param("whole", marks=pytest.mark.proof)])
def walk(request, tmp_path_factory):
    """The folder in which the blocks were followed, the steps of commands, and what the lines of
    Python printed.
    """
    folder = tmp_path_factory.mktemp("readme")
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        if request.param == "short":
            patch.setattr(shipped, "quick_protocol", short_protocol)
            leave_out_figures(patch)
        steps = [follow(line) for line in commands_of(PAGE)]
        with contextlib.redirect_stdout(printed):
            exec(compile(blocks("python")[0], "README.md", "exec"), {})
    return folder, steps, printed.getvalue(), request.param == "whole"


def test_every_command_ends_as_the_page_says(walk):
    """One after the other from the demo to the page."""
    _, steps, *_ = walk
    assert [shlex.split(each.command)[1] for each in steps] == ["demo", "doctor", "score", "report"]
    for each in steps:
        assert each.exit_code == int("# ends with 1" in each.command), each.command


def values_of(method: str, text: str) -> list[str]:
    """The numbers of a method's first row, without intervals and marks."""
    row = re.search(rf"\b{method} +(\d[\d. ±*†]+)", text)[1]
    return re.sub(r"± [\d.]+|[*†]", "", row).split()


def test_what_is_printed_is_what_the_page_shows(walk):
    """The planted fault in all three views, the digits of the table, and the page at its path."""
    folder, steps, _, is_whole = walk
    _, examined, scored, reported = (" ".join(each.output.split()) for each in steps)
    shown = re.findall(
        r"^```\n(frame .*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )[0]
    assert "shows instant t-1" in shown
    for camera in ("cam00", "cam03", "cam07"):
        assert re.search(rf"certain {camera} frame t shows instant t-1", examined)
    numbers, printed = (values_of("mine", text) for text in (shown, scored))
    assert f"{float(numbers[0]):.2f}" == QUOTED
    assert len(numbers) == 5
    for text in (shown, scored):
        assert "Only mine is ranked; late shows every frame one instant late" in text
    for number, own in zip(
        numbers if is_whole else [*numbers[:3], numbers[4]], printed, strict=False
    ):
        assert abs(float(number) - float(own)) <= 0.002 * abs(float(own)) + 0.002
    assert (folder / reported).is_file()
    assert reported == "scores/room/report/index.html"


def test_the_same_in_python_is_the_same(walk):
    """The lines of Python print the table of the same renders."""
    _, _, printed, _ = walk
    assert QUOTED in printed


def test_the_metric_is_a_plug_in():
    """The example of a metric is one; of equal images it is 0, of a constant error that error."""
    _, metric = blocks("python")
    made = {}
    exec(compile(metric, "mine.py", "exec"), made)
    black = np.zeros((4, 5, 3), np.uint8)
    assert made["METRICS"]["P99"].function(black, black) == 0
    assert made["METRICS"]["P99"].function(black, black + np.uint8(7)) == 7


@pytest.fixture(scope="module")
def first_evaluation(walk):
    """The guide's first evaluation, on few views, frames and sources of what README's block made,
    by three metrics; its steps.
    """
    folder, *_ = walk
    quick = folder / "quick"
    protocol = load_protocol(str(quick / "quick.toml"))
    cheap = replace(protocol.measurement, metrics=("PSNR", "SSIM", "TCC"), ceilings=False)
    few = {
        "frames": replace(protocol.frames, count=FRAMES),
        "synthesis": replace(protocol.synthesis, k=2),
    }
    few["views"] = replace(protocol.views, test=protocol.views.test[:2])
    short = replace(protocol, measurement=cheap, **few)
    (quick / "quick.toml").write_text(short.to_toml(), encoding="utf-8")
    for file in (quick / "fixed").glob("*/*.png"):
        if int(file.stem) not in short.frames.numbers or file.parent.name not in short.views.test:
            file.unlink()
    steps = []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in commands_of(GUIDE)[1:]:
            steps.append(
                follow(
                    line.replace(QUOTED, f"{psnr_db(steps[-1].output):.2f}")
                    if QUOTED in line
                    else line
                )
            )
    return folder, steps


def psnr_db(printed: str) -> float:
    """PSNR of `mine` in the table that `score` prints."""
    return float(re.findall(r"^mine\s+(\d+\.\d+)", printed, re.MULTILINE)[0])


@pytest.mark.proof
def test_the_guide_goes_from_a_capture_to_its_page(first_evaluation):
    """Nothing stumbles; a method of ours and imported frames are in one table, and their difference
    has its interval.
    """
    folder, steps = first_evaluation
    assert [each.exit_code for each in steps] == [0] * 7
    _, _, scored, explained, compared, reported, table = (
        " ".join(each.output.split()) for each in steps
    )
    assert "mine" in scored
    assert f"PSNR {psnr_db(steps[2].output):.2f}" in explained
    assert "Distance-based Blending" in compared
    assert "first better" in compared
    assert (folder / reported.split()[-1]).is_file()
    assert r"\begin{tabular}{lccc}" in table
