"""Heat maps over views and frames in a real browser."""

import re

from helpers.painted_page import clock, show_part
from helpers.run_folders import LABELS


def test_heat_map_opens_the_frame_of_a_cell(shown):
    """A click into the second row, third column of the first method's map shows cam03, frame 4,
    that method beside the truth.
    """
    show_part(shown, "heat")
    shown.click(".cells", 0.6, 0.75)
    assert shown.run("[...document.querySelectorAll('.viewer select')].map(s => s.value)") == [
        "cam03",
        LABELS[0],
        "truth",
    ]
    assert clock(shown).startswith("frame 4 of")
    assert shown.run("document.activeElement.className").startswith("stage")
    assert re.fullmatch(
        r"No Blending, cam03, frame 4: PSNR [\d.]+ dB", shown.text("[data-role=cell]")
    )


def test_heat_map_by_keyboard(shown):
    """Arrow keys choose a cell of a focused map and say what it holds, enter opens it; a pointer
    says it and opens nothing.
    """
    show_part(shown, "heat")
    shown.run("document.querySelectorAll('.cells')[1].focus()")
    shown.press("\ue015", "\ue014")
    assert shown.text("[data-role=cell]").startswith(
        "GGVS (online), geometric weights, cam03, frame 3: PSNR"
    )
    shown.press("\ue013", "\ue012", "\ue012")
    assert shown.text("[data-role=cell]").startswith(
        "GGVS (online), geometric weights, cam00, frame 5: PSNR"
    )
    shown.press("\ue015", "\ue014", "\ue014")
    shown.press("\ue007")
    assert clock(shown).startswith("frame 3 of")
    show_part(shown, "heat")
    shown.point(".heat:nth-child(3) .cells", 0.9, 0.75)
    assert re.fullmatch(
        r"GGVS \(online\), no temporal filtering, cam03, frame 5: PSNR [\d.]+ dB",
        shown.text("[data-role=cell]"),
    )
    assert clock(shown).startswith("frame 3 of")


def test_heat_map_is_brighter_where_it_is_worse(shown):
    """In both directions of metrics the worst cells are brighter than the best ones; a cell without
    a value is empty.
    """
    show_part(shown, "heat")
    for metric in ("PSNR", "L1"):
        shown.choose(".heats [data-role=metric]", metric)
        worst, best = (
            sum(shown.canvas_colour(f".heat:nth-child({number}) canvas", 1, 0)) for number in (1, 3)
        )
        assert worst > best + 100
    shown.choose(".heats [data-role=metric]", "TCC")
    alpha = (
        "document.querySelector('.cells canvas').getContext('2d').getImageData(arguments[0], "
        "0, 1, 1).data[3]"
    )
    assert [shown.run(alpha, frame) for frame in (0, 1)] == [0, 255]
