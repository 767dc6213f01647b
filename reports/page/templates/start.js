/** Put together everything that shows one run; `reveal` brings an element into sight, `write` keeps the address at its viewer's place while it `isCurrent`. */
function startRun(id, reveal, write, isCurrent) {
  const root = document.querySelector(`[data-viewer="${id}"]`);
  const data = JSON.parse(root.querySelector('[data-role="data"]').textContent);
  const linked = document.querySelector(`[data-linked="${id}"]`);
  const viewer = makeViewer(root, data, linked ? [linked] : []);
  const heat = document.querySelector(`[data-heat="${id}"]`);
  const plots = document.querySelectorAll(`[data-run="${id}"] svg`);
  const showSlices = linked ? makeLinkedSlices(linked, data, viewer.open) : () => {};
  const ring = heat ? makeHeatMaps(heat, data, openFromAfar) : () => {};

  /** Open a place in the viewer and bring the viewer into sight. */
  function openFromAfar(view, frame, label, pixel) {
    viewer.open(view, frame, label, pixel);
    reveal(root);
    root.scrollIntoView({ block: "nearest" });
    root.querySelector(".stage:not([hidden]), [data-role=frame]").focus({ preventScroll: true });
  }

  /** Open a place that an address names and bring the viewer into sight. */
  function openPlace(place) {
    viewer.openPlace(place);
    reveal(root);
    root.scrollIntoView({ block: "nearest" });
  }

  viewer.listen((view, row, frame) => {
    showSlices(view, row, frame);
    ring(view, data.frames[frame]);
    for (const plot of plots) moveCursor(plot, data.frames[frame]);
  });
  for (const plot of plots) openOnClick(plot, openFromAfar);
  for (const video of document.querySelectorAll(`[data-videos="${id}"] video`)) showBeginning(video, data);
  viewer.offer();
  makeOpening(document.querySelector(`[data-opening][data-of="${id}"]`), data, openFromAfar);
  viewer.onSettled(() => isCurrent(id) && write(formatPlace(root.dataset.address, { ...viewer.place(), hidden: shownMethods.hidden() })));
  return { root, press: viewer.press, openPlace };
}

/** Until a video is played it shows the frame that it begins with; browsers leave it black where they only read its length. */
function showBeginning(video, data) {
  const key = data.keys.find((one) => data.names[one] === video.dataset.name);
  if (key) video.poster = data.images[data.views[0]][key][0];
}

/** Tabs, and one run at a time, which is put together when it is first shown; addresses and links lead to all of them. */
function start() {
  document.documentElement.classList.remove("loading");
  for (const name of document.querySelectorAll(".group-name")) name.classList.add("hidden"); // tabs say it
  const runs = new Map();
  const navs = [...document.querySelectorAll(".tabs")].map(makeTabs);
  const write = makeAddressWriter();
  let current = null;

  /** Show a run, and hide the others of its group. */
  function showRun(id) {
    for (const part of document.querySelector(`[data-viewer="${id}"]`).closest("article").querySelectorAll("[data-of]")) {
      part.hidden = part.dataset.of !== id;
    }
    if (!runs.has(id)) runs.set(id, startRun(id, reveal, write, (one) => current?.root.dataset.viewer === one));
    current = runs.get(id);
  }

  /** Show the run and the sheets that an element belongs to. */
  function reveal(element) {
    const article = element.closest("article");
    const shown = article?.querySelector(element === article ? "[data-of]" : "[data-of]:not([hidden])"); // its first run, or its last shown
    const part = element.closest("[data-of]") ?? shown;
    if (part) showRun(part.dataset.of);
    for (const show of navs) show(element, (link) => !link.dataset.room || link.dataset.room === current?.root.dataset.viewer);
  }

  /** Go where the address leads: to a part of the page by its name, or to a place in a room. */
  function go() {
    const element = document.getElementById(location.hash.slice(1));
    const place = parsePlace(location.hash);
    const room = place && [...document.querySelectorAll(".viewer")].find((one) => one.dataset.address === place.room);
    if (element) {
      reveal(element);
      element.scrollIntoView();
    } else if (room) {
      reveal(room);
      if (place.hidden) shownMethods.hide(place.hidden);
      if (place.view !== undefined) current.openPlace(place);
    }
  }

  for (const table of document.querySelectorAll("table:not(.leaders, .standings)")) makeSortable(table);
  makeCopyButtons();
  shownMethods.start();
  makeThemeSwitch(document.querySelector(".theme"));
  reveal(document.querySelector(".sheet"));
  go();
  addEventListener("hashchange", go);
  document.addEventListener("beforematch", (event) => reveal(event.target.firstElementChild));
  document.addEventListener("keydown", (event) => {
    const onStage = event.target.closest(".stage");
    const isFree = event.target === document.body || onStage;
    if (!isFree || (event.key === " " && !onStage) || !current?.root.checkVisibility()) return;
    current.press(event);
  });
}

start();
