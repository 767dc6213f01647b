/** Numbers that a drawing of curves was made with, from its attributes. */
function axisOf(plot) {
  const { first, last, left, right } = plot.dataset;
  return { first: Number(first), last: Number(last), left: Number(left), right: Number(right) };
}

/** Move the cursor of a drawing of curves to a frame. */
function moveCursor(plot, frame) {
  const { first, last, left, right } = axisOf(plot);
  const cursor = plot.querySelector(".cursor");
  cursor.style.visibility = frame < first || frame > last ? "hidden" : "visible";
  const x = left + ((frame - first) / (last - first)) * (right - left);
  cursor.setAttribute("x1", x);
  cursor.setAttribute("x2", x);
}

/** Frame below a place on the screen, in a drawing of curves. */
function frameAt(plot, clientX) {
  const { first, last, left, right } = axisOf(plot);
  const box = plot.getBoundingClientRect();
  const x = ((clientX - box.left) / box.width) * plot.viewBox.baseVal.width;
  return Math.round(Math.min(last, Math.max(first, first + ((x - left) / (right - left)) * (last - first))));
}

/** Let a click into a drawing of curves open its view at that frame. */
function openOnClick(plot, open) {
  plot.classList.add("opens");
  plot.addEventListener("click", (event) => open(plot.dataset.view, frameAt(plot, event.clientX)));
}
