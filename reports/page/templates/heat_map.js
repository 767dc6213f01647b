const HEAT_ROW_PX = 20;

/**
 * One map per method: views downwards, frames to the right, all methods of a metric on one scale, bright where it is worse.
 *
 * A click opens that frame; with the keyboard, arrow keys choose a cell and the enter key opens it.
 */
function makeHeatMaps(root, data, open) {
  const part = (role) => root.querySelector(`[data-role="${role}"]`);
  const maps = data.labels.map((label) => addMap(part("maps"), label));
  const at = { view: 0, frame: 0 };

  function addMap(grid, label) {
    const canvas = made("canvas");
    canvas.width = data.count;
    canvas.height = data.views.length;
    const cells = made("div", "cells", canvas, made("span", "cell"));
    cells.style.height = `${HEAT_ROW_PX * data.views.length}px`;
    cells.tabIndex = 0;
    cells.setAttribute("role", "group");
    cells.setAttribute("aria-label", `${data.names[label]}: views by frames; arrow keys choose, enter opens`);
    const views = made("div", "view-names", ...data.views.map((view) => made("span", "", view)));
    canvas.setAttribute("role", "img");
    const figure = made("figure", "heat", made("figcaption", "", data.names[label]), views, cells);
    figure.dataset.method = data.names[label];
    grid.append(figure);
    for (const kind of ["pointermove", "click"]) cells.addEventListener(kind, (event) => point(cells, label, event));
    cells.addEventListener("focus", () => tell(label, at));
    cells.addEventListener("keydown", (event) => press(label, event));
    return { label, canvas };
  }

  function point(cells, label, event) {
    const box = cells.getBoundingClientRect();
    const share = (from, size, count) => Math.min(count - 1, Math.max(0, Math.floor((from / size) * count)));
    const cell = {
      view: share(event.clientY - box.top, box.height, data.views.length),
      frame: share(event.clientX - box.left, box.width, data.count),
    };
    tell(label, cell);
    if (event.type === "click") enter(label, cell);
  }

  function press(label, event) {
    const steps = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] };
    if (!steps[event.key] && event.key !== "Enter") return;
    event.preventDefault();
    event.stopPropagation();
    if (event.key === "Enter") return enter(label, at);
    const [down, right] = steps[event.key];
    at.view = (at.view + down + data.views.length) % data.views.length;
    at.frame = (at.frame + right + data.count) % data.count;
    mark();
    tell(label, at);
  }

  function enter(label, { view, frame }) {
    open(data.views[view], data.start + frame, label);
  }

  /** Say what a cell holds, and ring it in every map. */
  function tell(label, { view, frame }) {
    const metric = part("metric").value;
    const value = data.heat[metric].values[label]?.[data.views[view]]?.[frame];
    const text = value == null ? "no finite value" : `${value} ${data.heat[metric].unit}`;
    part("cell").textContent = `${data.names[label]}, ${data.views[view]}, frame ${data.start + frame}: ${metric} ${text}`;
  }

  function mark() {
    root.style.setProperty("--cell-x", at.frame / data.count);
    root.style.setProperty("--cell-y", at.view / data.views.length);
  }

  /** Ring the cell of the frame that the viewer shows. */
  function follow(view, frame) {
    Object.assign(at, { view: data.views.indexOf(view), frame: frame - data.start });
    mark();
  }

  function draw() {
    const { low, high, higher_is_better: rises, unit, values } = data.heat[part("metric").value];
    const worse = (value) => (high === low ? 0 : rises ? (high - value) / (high - low) : (value - low) / (high - low));
    for (const { label, canvas } of maps) {
      const own = Object.values(values[label] ?? {}).flat().filter((value) => value != null);
      const span = own.length ? `${Math.min(...own)} to ${Math.max(...own)} ${unit}` : "no finite value";
      canvas.setAttribute("aria-label", `${part("metric").value} of ${data.names[label]} in ${data.views.length} views and ${data.count} frames: ${span}`);
      const context = canvas.getContext("2d");
      context.clearRect(0, 0, canvas.width, canvas.height);
      for (const [row, view] of data.views.entries()) {
        for (const [column, value] of (values[label]?.[view] ?? []).entries()) {
          if (value == null) continue;
          context.fillStyle = data.colours[Math.round(worse(value) * (data.colours.length - 1))];
          context.fillRect(column, row, 1, 1);
        }
      }
    }
    part("best").textContent = `${rises ? high : low} ${unit}`;
    part("worst").textContent = `${rises ? low : high} ${unit}`;
  }

  root.style.setProperty("--columns", data.count);
  root.style.setProperty("--rows", data.views.length);
  part("metric").addEventListener("change", draw);
  draw();
  return follow;
}
