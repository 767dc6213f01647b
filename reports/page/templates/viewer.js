const BLINK_MS = 600;
const MODES = ["wipe", "blink", "two", "all"];
const NEAR_DIVIDER_PX = 24;
const ZOOM_STEP = 1.5;
const UNDONE = "/undone"; // ends the key of a method's frames with their faults undone
const isUndone = (key) => key.endsWith(UNDONE);

/**
 * One comparison: state in one object, `show` draws it, every event changes it.
 *
 * @param alongside further elements that the window and the chosen pixel are handed to.
 * Listeners are called with the view, the row of the chosen pixel (fraction of the height) and the index of the frame; `settled` is
 * called whenever something of the place may have changed.
 */
function makeViewer(root, data, alongside) {
  const part = (role) => root.querySelector(`[data-role="${role}"]`);
  const stage = root.querySelector(".stage");
  const errors = document.querySelector(`[data-errors="${root.dataset.viewer}"]`);
  const state = { frame: 0, divider: 0.5, mode: "wipe", blinking: null, pixel: { x: 0.5, y: data.row / data.size[1] } };
  const zoom = makeZoomWindow();
  const player = makePlayer(part("play"), () => step(1), data.fps);
  const all = addPictures(part("all"), data.keys, data.names);
  const maps = addPictures(errors, data.keys.filter((key) => key in data.errors[data.views[0]]), data.names);
  const crops = makeCropPicker(root, data, [stage, ...[...all, ...maps].map(([, , picture]) => picture)]);
  const showFrame = makeFullSize(data, (isThere) => { part("full").textContent = isThere ? ", frames at full size" : ""; });
  const listeners = [];
  const opened = ["left", "right"].map((role) => part(role).value).join();
  let settled = () => {};

  function show() {
    const view = part("view").value;
    const left = part("left").value;
    const right = part("right").value;
    const isGrid = state.mode === "two" || state.mode === "all";
    if (part("undone")) part("undone").checked = [left, right].some(isUndone);
    part("left-name").textContent = data.names[left];
    part("right-name").textContent = data.names[right];
    stage.hidden = isGrid;
    part("all").hidden = !isGrid;
    for (const [key, image] of maps) showPicture(image, data.errors[view][key][state.frame]);
    root.classList.toggle("blink", state.mode === "blink");
    showTime();
    settle();
    for (const heard of listeners) heard(view, state.pixel.y, state.frame);
  }

  /** Put the frames into what is seen; while they play, those that the page carries do. */
  function showFrames() {
    const [view, left, right] = ["view", "left", "right"].map((role) => part(role).value);
    const shown = stage.hidden ? all : [[left, part("under")], [right, part("over")]];
    for (const [key, image] of shown) {
      const figure = image.closest("figure");
      if (figure) figure.hidden = state.mode === "two" && key !== left && key !== right;
      if (!figure?.hidden) showFrame(image, view, key, state.frame, player.isPlaying() ? 0 : zoom.seen.zoom);
    }
    const every = data.labels.every(shownMethods.isShown) ? [] : data.labels.filter(shownMethods.isShown);
    crops.tell(view, data.frames[state.frame], state.mode === "all" ? every : [left, right]);
  }

  /** Hand divider, window and chosen pixel to the style sheet. */
  function settle() {
    stage.style.setProperty("--at", `${100 * state.divider}%`);
    for (const element of [root, errors, ...alongside]) placeIn(element);
    showFrames();
    const { x, y } = pixelIndices();
    const near = zoom.seen.zoom > 1 ? `, zoom ${zoom.seen.zoom.toFixed(1)}` : "";
    part("place").textContent = `pixel x ${x}, y ${y}${near}`;
    settled();
  }

  function placeIn(element) {
    zoom.apply(element);
    element.style.setProperty("--pixel-x", state.pixel.x);
    element.style.setProperty("--pixel-y", state.pixel.y);
  }

  function pixelIndices() {
    const index = (share, size) => Math.min(size - 1, Math.max(0, Math.floor(share * size)));
    return { x: index(state.pixel.x, data.size[0]), y: index(state.pixel.y, data.size[1]) };
  }

  function showTime() {
    const frame = data.frames[state.frame];
    part("frame").value = state.frame;
    const seconds = data.fps ? `, ${((frame - data.start) / data.fps).toFixed(2)} s` : "";
    part("clock").textContent = `frame ${frame} of ${data.frames[0]}–${data.frames.at(-1)}${seconds}`;
    part("frame").setAttribute("aria-valuetext", part("clock").textContent);
  }

  function step(by) {
    const count = data.frames.length;
    state.frame = (state.frame + by + count) % count;
    show();
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
    settle();
  }

  function markCrop() {
    crops.add(zoom.seen, state.pixel);
    showFrames();
  }

  function nextView() {
    const select = part("view");
    select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
    show();
  }

  /** Choose a pixel: its middle, in fractions of the picture. */
  function choose(x, y) {
    const middle = (index, size) => (Math.min(size - 1, Math.max(0, index)) + 0.5) / size;
    state.pixel = { x: middle(x, data.size[0]), y: middle(y, data.size[1]) };
    show();
  }

  function movePixel(dx, dy) {
    const { x, y } = pixelIndices();
    choose(x + dx, y + dy);
    zoom.follow(state.pixel);
    settle();
  }

  function zoomBy(factor, at) {
    zoom.by(factor, at);
    settle();
  }

  /** Zoom towards the chosen pixel. */
  function zoomAtPixel(factor) {
    zoom.follow(state.pixel);
    const { zoom: now, x, y } = zoom.seen;
    zoomBy(factor, { x: (state.pixel.x - x) * now, y: (state.pixel.y - y) * now });
  }

  /**
   * Show a frame of a view by its number, the nearest one that the page carries; a method, if given, beside the truth, and a pixel.
   * What does not exist or is not given stays as it is.
   */
  function open(view, frame, label, pixel) {
    if (data.views.includes(view)) part("view").value = view;
    const distances = data.frames.map((shown) => Math.abs(shown - frame));
    if (Number.isFinite(frame)) state.frame = distances.indexOf(Math.min(...distances));
    if (label && label !== "truth" && data.keys.includes(label)) {
      part("left").value = label;
      part("right").value = "truth";
    }
    if (pixel) choose(...pixel);
    else show();
  }

  /** Open a place that an address names; what it leaves out, or what does not exist, stays as it is. */
  function openPlace({ view, frame, pixel, pair, mode, seen }) {
    for (const [at, role] of ["left", "right"].entries()) if (data.keys.includes(pair?.[at])) part(role).value = pair[at];
    if (MODES.includes(mode)) setMode(mode);
    if (seen) zoom.look(...seen);
    open(view, frame, undefined, pixel);
  }

  /** What is looked at, in words that an address can hold, and nothing that is as the page opens it. */
  function place() {
    const { x, y } = pixelIndices();
    const pair = ["left", "right"].map((role) => part(role).value);
    const { zoom: by, x: left, y: top } = zoom.seen;
    return {
      view: part("view").value, frame: data.frames[state.frame], pixel: [x, y], pair: pair.join() === opened ? undefined : pair,
      mode: state.mode === MODES[0] ? undefined : state.mode, seen: by === 1 ? undefined : [by, left, top].map((one) => +one.toFixed(4)),
    };
  }

  /** Show a method with its fault undone on the side that shows it as handed in, or the other way round; the first one if neither does. */
  function undo(isOn) {
    const other = (key) => (isOn ? `${key}${UNDONE}` : key.replace(UNDONE, ""));
    const sides = ["left", "right"].filter((role) => data.keys.includes(other(part(role).value)));
    for (const role of sides) part(role).value = other(part(role).value);
    if (!sides.length) part("left").value = data.keys.find((key) => isUndone(key) && shownMethods.isShown(key)) ?? part("left").value;
    show();
  }

  /** Offer the methods that are shown alone; a side that shows another one takes the first that is left. */
  function offer() {
    for (const role of ["left", "right"]) {
      const other = part(role === "left" ? "right" : "left").value;
      const options = [...part(role).options];
      for (const option of options) option.disabled = option.hidden = !shownMethods.isShown(option.value);
      const left = options.filter((option) => !option.disabled);
      if (part(role).selectedOptions[0].disabled) part(role).value = (left.find((option) => option.value !== other) ?? left[0]).value;
    }
    show();
  }

  function press(event) {
    const far = event.shiftKey ? 10 : 1;
    const keys = {
      arrowleft: () => (event.shiftKey ? moveDivider(state.divider - 0.02) : step(-1)),
      arrowright: () => (event.shiftKey ? moveDivider(state.divider + 0.02) : step(1)),
      " ": () => { player.play(!player.isPlaying()); settle(); },
      b: () => setMode(state.mode === "blink" ? "wipe" : "blink"),
      m: () => setMode(MODES[(MODES.indexOf(state.mode) + 1) % MODES.length]),
      v: nextView,
      c: markCrop,
      w: () => movePixel(0, -far),
      s: () => movePixel(0, far),
      a: () => movePixel(-far, 0),
      d: () => movePixel(far, 0),
      "+": () => zoomAtPixel(ZOOM_STEP),
      "=": () => zoomAtPixel(ZOOM_STEP),
      "-": () => zoomAtPixel(1 / ZOOM_STEP),
      0: fit,
    };
    const action = keys[event.key.toLowerCase()];
    if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    action();
  }

  function fit() {
    zoom.reset();
    settle();
  }

  function gestures(element, isWipe) {
    listenToPointer(element, {
      pick: (at) => { const { x, y } = zoom.toPicture(at); choose(Math.floor(x * data.size[0]), Math.floor(y * data.size[1])); },
      pinch: (factor, at, move) => { zoom.pan(move.x, move.y); zoomBy(factor, at); },
      drag: (to, from, start) => {
        const isNear = Math.abs(start.x - state.grip) * element.clientWidth < NEAR_DIVIDER_PX;
        if (isWipe && state.mode === "wipe" && (zoom.seen.zoom === 1 || isNear)) return moveDivider(to.x);
        zoom.pan(to.x - from.x, to.y - from.y);
        settle();
      },
    });
    element.addEventListener("pointerdown", () => { state.grip = state.divider; });
  }

  for (const role of ["view", "left", "right"]) part(role).addEventListener("change", show);
  for (const radio of root.querySelectorAll("input[type=radio]")) radio.addEventListener("change", () => setMode(radio.value));
  part("frame").addEventListener("input", (event) => { state.frame = Number(event.target.value); show(); });
  part("undone")?.addEventListener("change", (event) => undo(event.target.checked));
  part("play").addEventListener("click", settle);
  part("play").hidden = data.frames.length === 1;
  part("closer").addEventListener("click", () => zoomAtPixel(ZOOM_STEP));
  part("farther").addEventListener("click", () => zoomAtPixel(1 / ZOOM_STEP));
  part("fit").addEventListener("click", fit);
  part("crop").addEventListener("click", markCrop);
  gestures(stage, true);
  for (const [, , picture] of [...all, ...maps]) gestures(picture, false);
  shownMethods.listen(offer);
  const onSettled = (heard) => { settled = heard; };
  return { press, open, openPlace, offer, place, onSettled, listen: (heard) => listeners.push(heard) };
}
