const VIEW_SECONDS = 1.5; // how long each view of a single instant is shown

/**
 * The moving comparison of the first screen: each view from its first to its last frame, one view after the other.
 *
 * It plays by itself while it is in sight, unless the reader asked for less motion. `open(view, frame, label, pixel)` is called
 * where a picture is clicked, and by the link beside the button.
 */
function makeOpening(root, data, open) {
  const part = (role) => root.querySelector(`[data-role="${role}"]`);
  const count = data.views.length * data.frames.length;
  const isStill = matchMedia("(prefers-reduced-motion: reduce)").matches;
  const player = makePlayer(part("run"), () => show(at + 1), data.frames.length > 1 ? data.fps : 1 / VIEW_SECONDS);
  const insets = JSON.parse(root.dataset.insets); // view -> place of the enlarged square, in its sides
  let at = Math.max(0, data.views.indexOf(root.dataset.view)) * data.frames.length; // the view in which most moves
  let resumes = !isStill && count > 1; // whether it plays when it comes into sight

  const view = () => data.views[Math.floor(at / data.frames.length)];
  const frame = () => at % data.frames.length;

  function show(next) {
    at = next % count;
    for (const figure of root.querySelectorAll("figure")) {
      for (const image of figure.querySelectorAll("img")) showPicture(image, data.images[view()][figure.dataset.key][frame()]);
    }
    for (const [name, value] of Object.entries(insets[view()] ?? {})) root.style.setProperty(`--${name}`, value);
    part("moment").textContent = `${view()}, frame ${data.frames[frame()]}`;
  }

  for (const figure of root.querySelectorAll("figure")) {
    const image = figure.querySelector("img");
    image.classList.add("opens");
    image.addEventListener("click", (event) => {
      const box = image.getBoundingClientRect();
      const pixel = [(event.clientX - box.left) / box.width * data.size[0], (event.clientY - box.top) / box.height * data.size[1]];
      open(view(), data.frames[frame()], figure.dataset.key, pixel.map(Math.floor));
    });
  }
  part("closer-look").addEventListener("click", (event) => {
    event.preventDefault();
    open(view(), data.frames[frame()]);
  });
  part("run").hidden = count === 1;
  part("run").closest("p").hidden = false;
  show(at);
  new IntersectionObserver((entries) => {
    const isSeen = entries.at(-1).isIntersecting;
    if (!isSeen) resumes = player.isPlaying();
    player.play(isSeen ? resumes : false);
  }).observe(root);
}
