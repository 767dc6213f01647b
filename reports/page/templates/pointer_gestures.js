const STILL_PX = 4;
const WHEEL_STEP = 1.0015;

/**
 * Tell clicks, drags and pinches on an element apart, for mouse, pen and fingers.
 *
 * Places are fractions of the element's box. `on.pick(at)`: clicked without moving. `on.drag(to, from, start)`: one pointer moved.
 * `on.pinch(factor, at, move)`: two fingers, or the wheel with ctrl held (what a pinch on a touch pad comes as).
 */
function listenToPointer(element, on) {
  const held = new Map();
  let start = null;
  let moved = false;

  function place(event) {
    const box = element.getBoundingClientRect();
    return { x: (event.clientX - box.left) / box.width, y: (event.clientY - box.top) / box.height, px: event.clientX, py: event.clientY };
  }

  const distance = (a, b) => Math.hypot(a.px - b.px, a.py - b.py);

  function press(event) {
    if (event.button !== 0) return;
    held.set(event.pointerId, place(event));
    element.setPointerCapture(event.pointerId);
    if (held.size === 1) {
      start = place(event);
      moved = false;
    }
  }

  function move(event) {
    if (!held.has(event.pointerId)) return;
    const before = held.get(event.pointerId);
    const now = place(event);
    if (held.size === 2) pinch(event.pointerId, now, before);
    else if (moved || distance(now, start) > STILL_PX) {
      on.drag(now, moved ? before : start, start);
      moved = true;
    }
    if (moved) held.set(event.pointerId, now);
  }

  function pinch(id, now, before) {
    const [, other] = [...held].find(([key]) => key !== id);
    const factor = Math.max(distance(now, other), 1) / Math.max(distance(before, other), 1);
    const middle = { x: (now.x + other.x) / 2, y: (now.y + other.y) / 2 };
    on.pinch(factor, middle, { x: (now.x - before.x) / 2, y: (now.y - before.y) / 2 });
    moved = true;
  }

  function release(event) {
    if (!held.delete(event.pointerId)) return;
    if (event.type === "pointerup" && !moved) on.pick(place(event));
    if (event.type === "pointercancel") moved = true;
  }

  function turn(event) {
    if (!event.ctrlKey) return; // the wheel alone scrolls the page
    event.preventDefault();
    on.pinch(WHEEL_STEP ** -event.deltaY, place(event), { x: 0, y: 0 });
  }

  element.addEventListener("pointerdown", press);
  element.addEventListener("pointermove", move);
  element.addEventListener("pointerup", release);
  element.addEventListener("pointercancel", release);
  element.addEventListener("wheel", turn, { passive: false });
}
