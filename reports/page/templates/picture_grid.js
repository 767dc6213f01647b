/** An element with a class, holding others. */
function made(tag, className, ...children) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children);
  return element;
}

/** What marks the chosen pixel on a picture: a line through its row and a ring around it. */
function pixelMarks() {
  const marks = [made("span", "mark-row"), made("span", "mark-pixel")];
  for (const mark of marks) mark.setAttribute("aria-hidden", "true");
  return marks;
}

/** Put one captioned picture per key into a grid; gives back [key, image, its window] of each. */
function addPictures(grid, keys, names) {
  return keys.map((key) => {
    const image = made("img", "placed");
    image.alt = names[key];
    const picture = made("div", "picture", image, ...pixelMarks());
    const figure = made("figure", "", picture, made("figcaption", "", names[key]));
    figure.dataset.key = key;
    figure.dataset.method = names[key.split("/")[0]];
    grid.append(figure);
    return [key, image, picture];
  });
}

/** Give an image another picture; setting the one that it has would decode it again. */
function showPicture(image, source) {
  if (image.getAttribute("src") !== source) image.src = source;
}
