"""The section of a sweep in a real browser: its table and its curves over K."""

import pytest

from ggvs_eval.files.atomic import write_text
from ggvs_eval.reports.model.measured import sweep_runs
from ggvs_eval.reports.page.page import render_page
from ggvs_eval.reports.run_groups import read_groups
from ggvs_eval.reports.section import Report, with_sections
from helpers.browser import DESKTOP, PHONE
from helpers.sweep_folders import KS, LINES, write_sweep


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The page of a sweep of three K, with a group for each."""
    sweep = write_sweep(tmp_path_factory.mktemp("sweeps") / "by-k")
    page = sweep / "index.html"
    write_text(
        page, render_page(with_sections(Report(read_groups(sweep_runs(sweep)), sweeps=(sweep,))))
    )
    return page


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_section_of_a_sweep_fits_and_complains_of_nothing(started, page, size, dark):
    """On a desktop and on a phone, light and dark: nothing is broken or too wide, no complaint."""
    started.visit(page, size, dark)
    assert started.run("document.documentElement.scrollWidth") <= size[0]
    assert started.wait(
        "[...document.querySelectorAll('img[src]')].every(image => image.complete && "
        "image.naturalWidth > 0)"
    )
    assert started.run(
        "(box => box.width > 250 && box.height > 100)(document.querySelector('#sweep0 "
        "svg[role=img]').getBoundingClientRect())"
    )
    assert started.complaints() == []


DOTS = """[...document.querySelectorAll('#sweep0 .plot:nth-child(1) circle')].map(dot => {
    const { x, y } = dot.getBoundingClientRect();
    return [x, y, getComputedStyle(dot).stroke, dot.textContent];
})"""


def test_curves_over_k_are_seen(started, page):
    """Each K is a dot per method, coloured as in the legend, further right where K is larger,
    higher where it is better.
    """
    started.visit(page)
    found = started.run(DOTS)
    assert len(found) == len(LINES)
    ours, other = found[: len(KS)], found[len(KS) :]
    for line in (ours, other):
        assert [x for x, *_ in line] == sorted({x for x, *_ in line})
        assert [y for _, y, *_ in line] == sorted({y for _, y, *_ in line}, reverse=True)
    assert max(y for _, y, *_ in ours) < min(y for _, y, *_ in other)
    assert ours[-1][3] == "GGVS (online), K = 5: 30.5 dB"
    legend = started.run(
        "[...document.querySelectorAll('#sweep0 .legend line')].map(line => "
        "getComputedStyle(line).stroke)"
    )
    assert legend == [ours[0][2], other[0][2]]
    assert started.complaints() == []


def test_table_of_a_sweep_sorts(started, page):
    """A head of its table sorts the lines best first, by quality and by time."""
    started.visit(page)
    rows = "[...document.querySelectorAll('#sweep0 tbody tr')].map(row => row.cells[0].textContent)"
    by_quality = [
        f"{method}, K = {variant[1:]}"
        for variant, method, *_ in sorted(LINES, key=lambda line: -line[2])
    ]
    started.click("#sweep0 thead th:nth-child(2) .sort")
    assert started.run(rows) == by_quality
    started.click("#sweep0 thead th:nth-child(3) .sort")
    assert started.run(rows)[:2] == ["GGVS (online), K = 2", "No Blending, K = 2"]
    assert started.complaints() == []


def test_contents_lead_to_the_sweep_and_to_each_k(started, page):
    """The links at the top lead to the sweep's section and to the group of each K."""
    started.visit(page)
    for address in (*(f"#group{at}" for at in range(len(KS))), "#sweep0"):
        started.click(f"a[href='{address}']")
        assert started.run("location.hash") == address
        shown = (
            "[...document.querySelectorAll('main > .sheet')].filter(sheet => "
            "!sheet.hidden).map(sheet => '#' + sheet.id)"
        )
        started.wait(f"({shown}).join() === arguments[0]", address)
    assert started.complaints() == []
