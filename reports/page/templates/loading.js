/** Until the page is put together only the first of its parts is drawn, so that nothing jumps; without scripts all are. */
document.documentElement.classList.add("loading");
