/** A picture that lies in the page, decoded and ready to be drawn. */
async function decoded(source) {
  const image = new Image();
  image.src = source;
  await image.decode();
  return image;
}

/**
 * Cut one row out of each of several pictures and put the rows below each other on a canvas, as they are decoded.
 *
 * @param canvas is made as wide as the pictures and as high as there are pictures.
 * @param sources addresses of the pictures, all of one size.
 * @param share which row, as a fraction of their height.
 * @param isWanted asked before each picture, so that a newer cut can end this one.
 */
async function cutRow(canvas, sources, share, isWanted) {
  const context = canvas.getContext("2d");
  for (const [index, source] of sources.entries()) {
    const image = await decoded(source);
    if (!isWanted()) return;
    if (index === 0) resize(canvas, image.naturalWidth, sources.length);
    const row = Math.min(image.naturalHeight - 1, Math.floor(share * image.naturalHeight));
    context.drawImage(image, 0, row, image.naturalWidth, 1, 0, index, image.naturalWidth, 1);
  }
  canvas.dataset.share = share;
}

/** Setting a size clears a canvas; one that fits is kept, so that nothing flickers while a row is moved. */
function resize(canvas, width, height) {
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
}
