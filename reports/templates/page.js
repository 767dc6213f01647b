"use strict";

const BLINK_MS = 600;
const DEFAULT_FPS = 10;

/** One comparison: state in one object, `show` draws it, every event changes it. */
function makeViewer(root) {
  const part = (role) => root.querySelector(`[data-role="${role}"]`);
  const data = JSON.parse(part("data").textContent);
  const stage = root.querySelector(".stage");
  const errors = document.querySelector(`[data-errors="${root.dataset.viewer}"]`);
  const plots = document.querySelectorAll(`[data-run="${root.dataset.viewer}"] svg`);
  const state = { frame: 0, divider: 0.5, mode: "wipe", playing: null, blinking: null };
  const all = addFigures(part("all"), data.keys, data.names);
  const maps = addFigures(errors, data.keys.filter((key) => key !== "truth"), data.names);

  function show() {
    const view = part("view").value;
    const left = part("left").value;
    const right = part("right").value;
    part("under").src = data.images[view][left][state.frame];
    part("over").src = data.images[view][right][state.frame];
    part("left-name").textContent = data.names[left];
    part("right-name").textContent = data.names[right];
    for (const [key, image] of all) image.src = data.images[view][key][state.frame];
    for (const [key, image] of maps) image.src = data.errors[view][key][state.frame];
    stage.style.setProperty("--at", `${100 * state.divider}%`);
    stage.hidden = state.mode === "all";
    part("all").hidden = state.mode !== "all";
    root.classList.toggle("blink", state.mode === "blink");
    showTime();
  }

  function showTime() {
    const frame = data.frames[state.frame];
    part("frame").value = state.frame;
    const seconds = data.fps ? `, ${((frame - data.start) / data.fps).toFixed(2)} s` : "";
    part("clock").textContent = `frame ${frame} of ${data.frames[0]}–${data.frames.at(-1)}${seconds}`;
    for (const plot of plots) moveCursor(plot, frame);
  }

  function step(by) {
    const count = data.frames.length;
    state.frame = (state.frame + by + count) % count;
    show();
  }

  function play(on) {
    clearInterval(state.playing);
    state.playing = on && data.frames.length > 1 ? setInterval(() => step(1), 1000 / Math.min(data.fps || DEFAULT_FPS, 15)) : null;
    part("play").textContent = state.playing ? "❚❚" : "▶";
    part("play").setAttribute("aria-pressed", String(Boolean(state.playing)));
    part("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
  }

  function setMode(mode) {
    state.mode = mode;
    clearInterval(state.blinking);
    state.blinking = mode === "blink" ? setInterval(() => stage.classList.toggle("second"), BLINK_MS) : null;
    root.querySelector(`input[value="${mode}"]`).checked = true;
    show();
  }

  function moveDivider(to) {
    state.divider = Math.min(1, Math.max(0, to));
    show();
  }

  function nextView() {
    const select = part("view");
    select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
    show();
  }

  function press(event) {
    const keys = {
      ArrowLeft: () => (event.shiftKey ? moveDivider(state.divider - 0.02) : step(-1)),
      ArrowRight: () => (event.shiftKey ? moveDivider(state.divider + 0.02) : step(1)),
      " ": () => play(!state.playing),
      b: () => setMode(state.mode === "blink" ? "wipe" : "blink"),
      v: nextView,
    };
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
  }

  function drag(event) {
    if (event.type === "pointermove" && event.buttons === 0) return;
    const box = stage.getBoundingClientRect();
    moveDivider((event.clientX - box.left) / box.width);
  }

  for (const role of ["view", "left", "right"]) part(role).addEventListener("change", show);
  for (const radio of root.querySelectorAll("input[type=radio]")) radio.addEventListener("change", () => setMode(radio.value));
  part("frame").addEventListener("input", (event) => { state.frame = Number(event.target.value); show(); });
  part("play").addEventListener("click", () => play(!state.playing));
  stage.addEventListener("pointerdown", drag);
  stage.addEventListener("pointermove", drag);
  show();
  return press;
}

/** Put one captioned picture per key into a grid; gives back [key, image] pairs. */
function addFigures(grid, keys, names) {
  return keys.map((key) => {
    const figure = document.createElement("figure");
    const image = document.createElement("img");
    const caption = document.createElement("figcaption");
    image.alt = names[key];
    caption.textContent = names[key];
    figure.append(image, caption);
    grid.append(figure);
    return [key, image];
  });
}

/** Move the cursor of a curve to a frame. */
function moveCursor(plot, frame) {
  const { first, last, left, right } = Object.fromEntries(Object.entries(plot.dataset).map(([key, value]) => [key, Number(value)]));
  const cursor = plot.querySelector(".cursor");
  cursor.style.visibility = frame < first || frame > last ? "hidden" : "visible";
  const x = left + ((frame - first) / (last - first)) * (right - left);
  cursor.setAttribute("x1", x);
  cursor.setAttribute("x2", x);
}

/** Keys go to the viewer that was touched last, unless the focused control has a use for them itself. */
function start() {
  const roots = [...document.querySelectorAll(".viewer")];
  const presses = new Map(roots.map((root) => [root, makeViewer(root)]));
  let current = roots[0];
  for (const root of roots) {
    root.addEventListener("pointerdown", () => { current = root; });
    root.addEventListener("focusin", () => { current = root; });
  }
  document.addEventListener("keydown", (event) => {
    const onStage = event.target.closest(".stage");
    const free = event.target === document.body || onStage;
    if (!free || (event.key === " " && !onStage)) return;
    presses.get(current)?.(event);
  });
}

start();
