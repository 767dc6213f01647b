const TOLD_MS = 2000;

/** Put a text on the clipboard; a browser that gives a page from disk no clipboard may still copy what is selected. */
async function copyText(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const area = made("textarea", "hidden");
    area.value = text;
    document.body.append(area);
    area.select();
    const isCopied = document.execCommand("copy");
    area.remove();
    return isCopied;
  }
}

/** A table in a format, its rows as they are seen: in their order, without those of hidden methods. */
function tableText(table, format) {
  const [head, rows, foot] = JSON.parse(table.dataset.texts)[format];
  const shown = [...table.tBodies[0].rows].filter((row) => getComputedStyle(row).display !== "none");
  return [head, ...shown.map((row) => rows[row.dataset.row]), ...(foot ? [foot] : []), ""].join("\n");
}

/** Let the buttons above each table copy it. */
function makeCopyButtons() {
  for (const line of document.querySelectorAll(".copies")) {
    const table = line.nextElementSibling.querySelector("table");
    const told = line.querySelector("output");
    line.hidden = false;
    for (const button of line.querySelectorAll("button")) {
      button.setAttribute("aria-label", `${button.textContent}: ${line.nextElementSibling.getAttribute("aria-label")}`);
      button.addEventListener("click", async () => {
        const isCopied = await copyText(tableText(table, button.dataset.copy));
        told.textContent = isCopied ? "copied" : "the browser does not let this page copy";
        setTimeout(() => { told.textContent = ""; }, TOLD_MS);
      });
    }
  }
}
