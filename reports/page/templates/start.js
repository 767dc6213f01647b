/** Put together everything that shows one run; gives back who obeys its keys. */
function startRun(root) {
  const id = root.dataset.viewer;
  const data = JSON.parse(root.querySelector('[data-role="data"]').textContent);
  const linked = document.querySelector(`[data-linked="${id}"]`);
  const viewer = makeViewer(root, data, [linked]);
  const heat = document.querySelector(`[data-heat="${id}"]`);
  const plots = document.querySelectorAll(`[data-run="${id}"] svg`);
  const showSlices = makeLinkedSlices(linked, data, viewer.open);
  const ring = heat ? makeHeatMaps(heat, data, openFromAbove) : () => {};

  /** Open a frame in the viewer and bring the viewer into sight. */
  function openFromAbove(view, frame, label) {
    viewer.open(view, frame, label);
    root.scrollIntoView({ block: "nearest" });
    root.querySelector(".stage:not([hidden]), [data-role=frame]").focus({ preventScroll: true });
  }

  viewer.listen((view, row, frame) => {
    showSlices(view, row, frame);
    ring(view, data.frames[frame]);
    for (const plot of plots) moveCursor(plot, data.frames[frame]);
  });
  for (const plot of plots) openOnClick(plot, openFromAbove);
  for (const video of document.querySelectorAll(`[data-videos="${id}"] video`)) showBeginning(video, data);
  viewer.show();
  return viewer.press;
}

/** Until a video is played it shows the frame that it begins with; browsers leave it black where they only read its length. */
function showBeginning(video, data) {
  const key = data.keys.find((one) => data.names[one] === video.dataset.name);
  if (key) video.poster = data.images[data.views[0]][key][0];
}

/** Keys go to the viewer that was touched last, unless the focused control has a use for them itself. */
function start() {
  const roots = [...document.querySelectorAll(".viewer")];
  const presses = new Map(roots.map((root) => [root, startRun(root)]));
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
  for (const table of document.querySelectorAll("table:not(.leaders, .contents)")) makeSortable(table);
  makeThemeSwitch(document.querySelector(".theme"));
}

start();
