const DEFAULT_FPS = 10;
const FPS_AT_MOST = 15;

/** A button that plays and pauses: while it plays, `step` is called `fps` times a second. */
function makePlayer(button, step, fps) {
  let timer = null;

  function play(on) {
    clearInterval(timer);
    timer = on ? setInterval(step, 1000 / Math.min(fps || DEFAULT_FPS, FPS_AT_MOST)) : null;
    button.textContent = timer ? "❚❚" : "▶";
    button.setAttribute("aria-pressed", String(Boolean(timer)));
    button.setAttribute("aria-label", timer ? "Pause" : "Play");
  }

  button.addEventListener("click", () => play(!timer));
  return { play, isPlaying: () => Boolean(timer) };
}
