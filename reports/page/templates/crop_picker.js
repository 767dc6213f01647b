const CROPS_AT_MOST = 4;
const CROP_SHARE = 0.16; // of the width, where the whole picture is seen

/**
 * Squares that somebody marks on the pictures, and the command that cuts them out for a paper.
 *
 * @param pictures elements that the squares are drawn on.
 */
function makeCropPicker(root, data, pictures) {
  const part = (role) => root.querySelector(`[data-role="${role}"]`);
  const [width, height] = data.size;
  let squares = [];

  /** Mark what is seen where the picture is zoomed, else a square around the chosen pixel. */
  function add(seen, pixel) {
    const side = Math.max(4, Math.round(seen.zoom > 1 ? Math.min(width, height) / seen.zoom : Math.min(height, CROP_SHARE * width)));
    const middle = seen.zoom > 1 ? { x: seen.x + 0.5 / seen.zoom, y: seen.y + 0.5 / seen.zoom } : pixel;
    const first = (share, size) => Math.min(size - side, Math.max(0, Math.round(share * size - side / 2)));
    squares = [...squares, { left: first(middle.x, width), top: first(middle.y, height), side }].slice(-CROPS_AT_MOST);
    draw();
  }

  function draw() {
    for (const picture of pictures) {
      for (const box of picture.querySelectorAll(".crop")) box.remove();
      picture.append(...squares.map(boxOf));
    }
    part("crops").hidden = squares.length === 0;
  }

  function boxOf({ left, top, side }, number) {
    const box = made("span", `crop crop${number}`);
    const places = { "--left": left / width, "--top": top / height, "--across": side / width, "--down": side / height };
    for (const [name, value] of Object.entries(places)) box.style.setProperty(name, value);
    return box;
  }

  /** Write the command for the view, frame and methods that are shown. */
  function tell(view, frame, keys) {
    const quoted = (text) => (/^[\w.,+=:\/-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);
    const labels = keys.filter((key) => data.labels.includes(key));
    const methods = labels.length ? ["--methods", ...labels] : [];
    const cut = squares.map(({ left, top, side }) => `${left},${top},${side}`);
    const words = ["ggvs-eval", "figure", "crops", data.run, "crops", "--view", view, "--frame", frame, "--squares", ...cut, ...methods];
    part("command").textContent = words.map(String).map(quoted).join(" ");
  }

  part("no-crops").addEventListener("click", () => { squares = []; draw(); });
  return { add, tell };
}
