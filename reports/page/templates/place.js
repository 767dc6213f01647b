const WRITE_AFTER_MS = 250; // browsers refuse to change the address more than some ten times a second

/** A place of the page as an address that can be shared: `#room/view/frame/x,y`. */
function formatPlace(room, { view, frame, pixel }) {
  return `#${[room, view, frame].map(encodeURIComponent).join("/")}/${pixel.join(",")}`;
}

/** What an address names; parts that it leaves out or that are no numbers are undefined. Null where it cannot be read. */
function parsePlace(hash) {
  try {
    const [room, view, frame, pixel] = hash.slice(1).split("/").map(decodeURIComponent);
    const numbers = (text, count) => (new RegExp(`^\\d+(,\\d+){${count - 1}}$`).test(text) ? text.split(",").map(Number) : []);
    const [x, y] = numbers(pixel, 2);
    return { room, view, frame: numbers(frame, 1)[0], pixel: x === undefined ? undefined : [x, y] };
  } catch {
    return null;
  }
}

/** Keep the address at the place that is looked at; what changes quickly is written when it rests. */
function makeAddressWriter() {
  let timer = null;
  return (hash) => {
    clearTimeout(timer);
    timer = setTimeout(() => history.replaceState(null, "", hash), WRITE_AFTER_MS);
  };
}
