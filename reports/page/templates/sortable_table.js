/** Value of a row in a column: a number, words, or null where nothing was measured. */
function valueIn(row, column) {
  const cell = row.cells[column];
  const text = cell.dataset.value;
  if (text === undefined) return cell.textContent.trim().toLowerCase();
  return text ? Number(text.replace("inf", "Infinity")) : null;
}

/** Order of two values; what was not measured comes last either way. */
function compareValues(a, b, falls) {
  if (a === null || b === null) return (a === null) - (b === null);
  const order = a < b ? -1 : Number(a > b);
  return falls ? -order : order;
}

/**
 * Let a click on a head sort the rows below it: best first, worst first, then as they came.
 *
 * Grey rows compete with nothing; they keep their place at the end.
 */
function makeSortable(table) {
  const heads = [...table.tHead.rows[0].cells];
  const body = table.tBodies[0];
  const original = [...body.rows];
  if (original.length < 2) return;

  function sort(column, state) {
    const measured = original.filter((row) => !row.classList.contains("grey"));
    const grey = original.filter((row) => row.classList.contains("grey"));
    if (state !== "none") {
      measured.sort((a, b) => compareValues(valueIn(a, column), valueIn(b, column), state === "descending"));
    }
    body.append(...measured, ...grey);
    for (const head of heads) head.setAttribute("aria-sort", "none");
    heads[column].setAttribute("aria-sort", state);
  }

  for (const [column, head] of heads.entries()) {
    const first = head.dataset.better === "higher" ? "descending" : "ascending";
    const states = ["none", first, first === "ascending" ? "descending" : "ascending"];
    const button = made("button", "sort", ...head.childNodes);
    button.type = "button";
    head.append(button);
    head.setAttribute("aria-sort", "none");
    button.addEventListener("click", () => sort(column, states[(states.indexOf(head.getAttribute("aria-sort")) + 1) % 3]));
  }
}
