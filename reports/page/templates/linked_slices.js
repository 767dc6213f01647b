const NO_TRUTH = "no truth on a virtual path";
const NOT_ALONG = "not rendered along the path";

/**
 * The row of the chosen pixel over viewpoints and over time, for the truth and every method, with the curves of its view.
 *
 * Slices are cut here from the compressed pictures that the page carries. `viewer.open(view, frame)` is called where somebody clicks
 * into a slice over time or into the curves.
 */
function makeLinkedSlices(root, data, open) {
  const part = (role) => root.querySelector(`[data-role="${role}"]`);
  const strips = data.keys.map((key) => addStrips(part("strips"), key));
  let asked = null; // what was asked for last, drawn when it can be seen
  let begun = ""; // which row of which view the slices were last cut through, and which is there to be seen
  let finished = "";
  let turn = 0;
  let isSeen = false;

  function addStrips(table, key) {
    const path = data.path && key in data.path.images ? made("canvas") : null;
    const time = data.frames.length > 1 ? made("canvas", "placed") : null;
    const over = made("div", "cut", path ?? made("p", "absent", key === "truth" ? NO_TRUTH : NOT_ALONG));
    const along = made("div", "cut along", ...(time ? [time, made("span", "mark-frame"), made("span", "mark-column")] : []));
    along.addEventListener("click", (event) => jump(along, event));
    const cells = [made("p", "strip-name", data.names[key]), ...(data.path ? [over] : []), ...(time ? [along] : [])];
    for (const cell of cells) cell.dataset.method = data.names[key.split("/")[0]];
    table.append(...cells);
    for (const [canvas, kind] of [[path, "Epipolar plane image"], [time, "x-t slice"]]) label(canvas, `${kind} of ${data.names[key]}`);
    return { key, path, time };
  }

  function label(canvas, text) {
    canvas?.setAttribute("role", "img");
    canvas?.setAttribute("aria-label", text);
  }

  function jump(along, event) {
    const box = along.getBoundingClientRect();
    const index = Math.floor(((event.clientY - box.top) / box.height) * data.frames.length);
    open(asked.view, data.frames[Math.min(data.frames.length - 1, Math.max(0, index))]);
  }

  /** Show the slices through a row (fraction of the height) of a view, and what holds at a frame (index into the frames shown). */
  function show(view, row, frame) {
    asked = { view, row, frame };
    tellBusy();
    if (isSeen) draw();
  }

  function place() {
    return `${asked.view} ${asked.row}`;
  }

  /** Say whether the slices are still others than those that were asked for, also while nobody sees them. */
  function tellBusy() {
    root.setAttribute("aria-busy", String(finished !== place()));
  }

  async function draw() {
    const { view, row, frame } = asked;
    root.style.setProperty("--at-frame", (frame + 0.5) / data.frames.length);
    const second = (index) => (data.fps ? ` (${((data.frames[index] - data.start) / data.fps).toFixed(2)} s)` : "");
    const ends = `frames ${data.frames[0]}${second(0)} to ${data.frames.at(-1)}${second(data.frames.length - 1)}`;
    part("row").textContent = `Row ${Math.floor(row * data.size[1])} of ${data.size[1]} in ${view}`;
    if (part("ends")) part("ends").textContent = ends;
    showCurve(view, frame);
    if (begun === place()) return;
    begun = place();
    const mine = ++turn;
    const isWanted = () => mine === turn;
    await Promise.all(strips.flatMap(({ key, path, time }) => [
      time && cutRow(time, data.images[view][key], row, isWanted),
      path && cutRow(path, data.path.images[key], row, isWanted),
    ]));
    if (!isWanted()) return;
    finished = begun;
    tellBusy();
  }

  /** The chosen metric's curves of this view, as drawn further down the page, and its values at the frame. */
  function showCurve(view, frame) {
    const metric = part("metric").value;
    const plots = [...document.querySelectorAll(`[data-run="${root.dataset.linked}"] svg`)];
    const plot = plots.find((one) => one.dataset.metric === metric && one.dataset.view === view);
    const shown = plot?.cloneNode(true);
    if (shown) {
      moveCursor(shown, data.frames[frame]);
      openOnClick(shown, open);
    }
    part("curve").replaceChildren(...(shown ? [shown] : []));
    part("values").replaceChildren(...data.labels.map((label, number) => valueOf(metric, view, frame, label, number)));
  }

  function valueOf(metric, view, frame, label, number) {
    const { values, unit } = data.heat[metric] ?? { values: {}, unit: "" };
    const value = values[label]?.[view]?.[data.frames[frame] - data.start];
    const text = value == null ? "–" : `${value} ${unit}`;
    const line = document.querySelector(`[data-legend="${root.dataset.linked}"] li:nth-child(${number + 1}) svg`)?.cloneNode(true);
    const item = made("li", "", ...(line ? [line] : []), `${data.names[label]} `, made("b", "", text));
    item.dataset.method = data.names[label];
    return item;
  }

  part("metric").addEventListener("change", () => asked && draw());
  new IntersectionObserver((entries) => {
    isSeen = entries.at(-1).isIntersecting;
    if (isSeen && asked) draw();
  }, { rootMargin: "300px" }).observe(root);
  return show;
}
