const CLOSEST = 32;

/**
 * The part of a picture that is looked at: `zoom` >= 1, and (x, y), where its upper left corner lies in the picture, as fractions
 * of the picture's width and height. One window is shared by every picture of a viewer, so that all zoom and move together.
 */
function makeZoomWindow() {
  const seen = { zoom: 1, x: 0, y: 0 };

  function settle() {
    const free = 1 - 1 / seen.zoom;
    seen.x = Math.min(free, Math.max(0, seen.x));
    seen.y = Math.min(free, Math.max(0, seen.y));
  }

  /** Zoom by a factor; the point of the picture at `at` (fractions of the window) stays where it is. */
  function by(factor, at = { x: 0.5, y: 0.5 }) {
    const fixed = toPicture(at);
    seen.zoom = Math.min(CLOSEST, Math.max(1, seen.zoom * factor));
    seen.x = fixed.x - at.x / seen.zoom;
    seen.y = fixed.y - at.y / seen.zoom;
    settle();
  }

  /** Move the picture by fractions of the window. */
  function pan(dx, dy) {
    seen.x -= dx / seen.zoom;
    seen.y -= dy / seen.zoom;
    settle();
  }

  /** Look so that a point of the picture can be seen; it moves no further than it must. */
  function follow(point) {
    const margin = 0.1 / seen.zoom;
    for (const axis of ["x", "y"]) {
      const most = point[axis] - margin;
      const least = point[axis] - 1 / seen.zoom + margin;
      seen[axis] = Math.min(most, Math.max(least, seen[axis]));
    }
    settle();
  }

  /** Look at a part of the picture: its zoom and upper left corner. */
  function look(zoom, x, y) {
    Object.assign(seen, { zoom: Math.min(CLOSEST, Math.max(1, zoom)), x, y });
    settle();
  }

  function reset() {
    Object.assign(seen, { zoom: 1, x: 0, y: 0 });
  }

  /** Fractions of the window -> fractions of the picture. */
  function toPicture(at) {
    return { x: seen.x + at.x / seen.zoom, y: seen.y + at.y / seen.zoom };
  }

  /** Hand the window to the style sheet, which places the pictures by it. */
  function apply(element) {
    element.style.setProperty("--zoom", seen.zoom);
    element.style.setProperty("--x", seen.x);
    element.style.setProperty("--y", seen.y);
    element.classList.toggle("zoomed", seen.zoom > 1);
    element.classList.toggle("near", seen.zoom >= 4);
  }

  return { seen, by, pan, follow, look, reset, toPicture, apply };
}
