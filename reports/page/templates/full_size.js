/**
 * Frames at full size, which lie in the run folder beside the page (`data.full`, empty where they do not).
 *
 * The page's own pictures stand in until the file is there, and for good where the page was carried off without its run.
 * `told(isThere)` is called when that is found out.
 */
function makeFullSize(data, told) {
  let isThere = data.full !== "";
  const last = new WeakMap(); // image -> what was wanted in it last

  function address(view, key, index) {
    const folders = [...(key === "truth" ? ["truth"] : ["renders", key]), view].map(encodeURIComponent).join("/");
    return `${data.full}/${folders}/${String(data.frames[index]).padStart(4, "0")}.png`;
  }

  /** Show a frame in an image: the file on disk where the screen has more pixels for it than the page's own picture has. */
  return function show(image, view, key, index, zoom) {
    const own = data.images[view][key][index];
    const isEnlarged = image.clientWidth * zoom * devicePixelRatio > data.width;
    const wanted = isThere && isEnlarged && !key.includes("/") ? address(view, key, index) : own;
    const before = last.get(image);
    if (before?.wanted === wanted) return;
    last.set(image, { wanted, own });
    if (wanted === own || before?.own !== own) showPicture(image, own);
    if (wanted === own) return;
    decoded(wanted).then(
      () => { if (last.get(image).wanted === wanted) { showPicture(image, wanted); told(true); } },
      () => { isThere = false; told(false); },
    );
  };
}
