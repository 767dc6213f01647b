/**
 * The methods that are shown, chosen by check boxes, the same in all groups of the page.
 *
 * What is of a method carries its name (`data-method`), also what is made later; one style sheet hides all of it. Listeners are called
 * after each change.
 */
const shownMethods = (() => {
  const off = new Map(); // label -> name
  const listeners = [];
  let style = null;
  let panels = [];
  let boxes = [];

  function start() {
    style = document.head.appendChild(document.createElement("style"));
    panels = [...document.querySelectorAll("details.methods")];
    boxes = panels.flatMap((panel) => [...panel.querySelectorAll("input")]);
    for (const panel of panels) {
      panel.hidden = panel.querySelectorAll("input").length < 2;
      panel.querySelector("button").addEventListener("click", () => hide([]));
      for (const box of panel.querySelectorAll("input")) box.addEventListener("change", () => change(box));
      document.addEventListener("click", (event) => { if (!panel.contains(event.target)) panel.open = false; });
      panel.addEventListener("keydown", (event) => { if (event.key === "Escape") panel.open = false; });
    }
    draw();
  }

  function change(box) {
    if (box.checked) off.delete(box.value);
    else off.set(box.value, box.dataset.name);
    const isLast = [...box.closest("fieldset").querySelectorAll("input:not([value=grey])")].every((one) => off.has(one.value));
    if (isLast) off.delete(box.value); // a page without any method says nothing
    draw();
  }

  /** Hide these labels and no others; labels that the page does not have are left out. */
  function hide(labels) {
    off.clear();
    for (const box of boxes) if (labels.includes(box.value)) off.set(box.value, box.dataset.name);
    draw();
  }

  function draw() {
    for (const box of boxes) box.checked = !off.has(box.value);
    for (const panel of panels) {
      const own = [...panel.querySelectorAll("input:not([value=grey])")];
      const count = own.filter((box) => box.checked).length;
      panel.querySelector('[data-role="count"]').textContent = count === own.length ? `all ${count}` : `${count} of ${own.length}`;
      panel.classList.toggle("some", off.size > 0);
    }
    const rows = [...off.values()].flatMap((name) => [name, `${name}, on the screen`]);
    const names = rows.map((name) => `[data-method="${CSS.escape(name)}"]`);
    style.textContent = names.length ? `${names.join(", ")} { display: none !important; }` : "";
    for (const heard of listeners) heard();
  }

  return {
    start, hide,
    isShown: (label) => !off.has(label.split("/")[0]),
    hidden: () => [...off.keys()],
    listen: (heard) => listeners.push(heard),
  };
})();
