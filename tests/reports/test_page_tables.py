"""Tables, sections that open, and videos of the page in a real browser."""

from helpers.browser import PHONE
from helpers.painted_page import show_part
from helpers.run_folders import LABELS


def names(browser, table: int = 0) -> list[str]:
    """First column of a table of results as it stands."""
    rows = (
        "[...document.querySelectorAll('#results "
        "table:not(.leaders)')[arguments[0]].tBodies[0].rows]"
    )
    return browser.run(f"{rows}.map(row => row.cells[0].textContent)", table)


def test_tables_sort_best_first(shown):
    """A click on a head puts the best first, a second the worst, a third the old order; published
    rows stay last.
    """
    show_part(shown, "results")
    original = names(shown)
    grey = original[len(LABELS) :]
    assert grey
    column = "#results table:not(.leaders) thead th:nth-child(2)"
    for sorts, state in (
        (original[:3][::-1], "descending"),
        (original[:3], "ascending"),
        (original[:3], "none"),
    ):
        shown.click(f"{column} .sort")
        assert names(shown) == [*sorts, *grey]
        assert (
            shown.run("document.querySelector(arguments[0]).getAttribute('aria-sort')", column)
            == state
        )


SORTED = """(tables => tables.flatMap(table => [...table.tHead.rows[0].cells].map((head, column) => {
    const rows = [...table.tBodies[0].rows].filter(row => !row.classList.contains('grey'));
    const read = () => rows.map(row => row.cells[column]).map(cell => [cell.textContent.trim(), cell.dataset.value ?? null]);
    const before = read();
    head.querySelector('.sort').click();
    rows.sort((a, b) => a.rowIndex - b.rowIndex);
    return [`${table.parentElement.ariaLabel}: ${head.textContent}`, before, read(), head.ariaSort];
})))([...document.querySelectorAll('table:not(.leaders, .standings)')].filter(table => table.tBodies[0].rows.length > 1))"""  # noqa: E501


def test_every_column_of_every_table_sorts(shown):
    """Each head of each table but the summary puts the rows in order: numbers, words, and last what
    is absent.
    """
    columns = shown.run(SORTED)
    assert len(columns) > 30
    for name, before, after, state in columns:
        assert state in {"ascending", "descending"}, name
        assert after == in_order(before, state == "descending"), name
    assert any(before != after for _, before, after, _ in columns)


def test_tables_sort_by_keyboard(shown):
    """The enter key on a focused head does what a click does."""
    show_part(shown, "results")
    before = names(shown)
    shown.focus("#results table:not(.leaders) thead th:nth-child(2) .sort")
    shown.press("\ue007")
    assert names(shown)[: len(LABELS)] == before[: len(LABELS)][::-1]


def in_order(cells: list[list[str | None]], falls: bool) -> list[list[str | None]]:
    """Text and value of cells in the order that a table should have: stable, what has no value at
    the end.
    """
    if all(value is None for _, value in cells):
        return sorted(cells, key=lambda cell: cell[0].lower(), reverse=falls)
    known = [cell for cell in cells if cell[1]]
    return sorted(known, key=lambda cell: float(cell[1]), reverse=falls) + [
        cell for cell in cells if not cell[1]
    ]


def test_wide_tables_scroll_by_keyboard_on_a_phone(started, painted):
    """On a phone a wider table is moved by arrow keys, the method's name in sight; who is best is
    read without scrolling.
    """
    started.visit(painted, PHONE, place="#views")
    wide = "#views .scroll"
    assert started.run(
        "(box => box.scrollWidth > box.clientWidth)(document.querySelector(arguments[0]))", wide
    )
    started.focus(wide)
    started.press(*["\ue014"] * 4)
    started.wait("document.querySelector(arguments[0]).scrollLeft > 40", wide)
    assert (
        started.run("document.querySelector('#views tbody th').getBoundingClientRect().left") >= 0
    )
    assert started.complaints() == []
    started.visit(painted, PHONE, place="#results")
    assert started.run(
        "(box => box.scrollWidth <= "
        "box.clientWidth)(document.querySelector('.leaders').parentElement)"
    )


def test_videos_play(shown):
    """The page carries a video of the truth and of each method that this browser can decode and
    play.
    """
    show_part(shown, "videos")
    videos = "[...document.querySelectorAll('#videos video')]"
    assert shown.run(f"{videos}.length") == 1 + len(LABELS)
    assert shown.run(f"{videos}.every(video => video.poster.startsWith('data:image/webp'))")
    shown.wait(f"{videos}.every(video => video.readyState >= 1 && video.videoWidth === 160)")
    shown.run(f"{videos}[1].play()")
    shown.wait(f"{videos}[1].currentTime > 0 && !{videos}[1].error")
