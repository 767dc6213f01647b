const WRITE_AFTER_MS = 250; // browsers refuse to change the address more than some ten times a second

/**
 * A place of the page as an address that can be shared: `#room/view/frame/x,y/left,right/mode/zoom,x,y/hidden,methods`.
 *
 * What is as the page opens it is left out, and with it the end of the address.
 */
function formatPlace(room, { view, frame, pixel, pair, mode, seen, hidden }) {
  const list = (words) => (words ?? []).map(encodeURIComponent).join(",");
  const parts = [...[room, view, frame].map(encodeURIComponent), pixel.join(","), list(pair), mode ?? "", (seen ?? []).join(","), list(hidden)];
  while (parts.at(-1) === "") parts.pop();
  return `#${parts.join("/")}`;
}

/** What an address names; parts that it leaves out or that are no numbers are undefined. Null where it cannot be read. */
function parsePlace(hash) {
  try {
    const [room, view, frame, pixel, pair, mode, seen, hidden] = hash.slice(1).split("/");
    const word = (text) => (text === undefined ? undefined : decodeURIComponent(text));
    const words = (text) => (text ? text.split(",").map(decodeURIComponent) : undefined);
    const numbers = (text, count, kind = "\\d+") => (new RegExp(`^${kind}(,${kind}){${count - 1}}$`).test(text) ? text.split(",").map(Number) : undefined);
    return {
      room: word(room), view: word(view), frame: numbers(frame, 1)?.[0], pixel: numbers(pixel, 2),
      pair: words(pair), mode: word(mode), seen: numbers(seen, 3, "\\d+(?:\\.\\d+)?"), hidden: words(hidden),
    };
  } catch {
    return null;
  }
}

/** Keep the address at the place that is looked at; what changes quickly is written when it rests. */
function makeAddressWriter() {
  let timer = null;
  return (hash) => {
    clearTimeout(timer);
    timer = setTimeout(() => { if (location.hash !== hash) history.replaceState(null, "", hash); }, WRITE_AFTER_MS);
  };
}
