/**
 * Show one of the sheets that the links of a navigation lead to, and hide the others; without this script all of them are shown.
 *
 * Hidden sheets are still searched by the browsers that can, see `hidden=until-found`.
 */
function makeTabs(nav) {
  const sheets = new Map([...nav.querySelectorAll("a")].map((link) => [link, document.querySelector(link.hash).closest(".sheet")]));

  function choose(chosen) {
    for (const sheet of new Set(sheets.values())) sheet.hidden = sheet === sheets.get(chosen) ? false : "until-found";
    for (const link of sheets.keys()) {
      link.toggleAttribute("aria-current", false);
      if (link === chosen) link.setAttribute("aria-current", "true");
    }
    nav.closest("article")?.classList.toggle("elsewhere", chosen !== nav.querySelector("a")); // the first part alone has the whole first screen
    const { offsetLeft, offsetWidth } = chosen;
    nav.scrollLeft = offsetLeft + (offsetWidth - nav.clientWidth) / 2; // its neighbours show that there are more
  }

  /** Choose the sheet that holds an element, if one does; of several links to it the one that `isMeant`. */
  function reveal(element, isMeant = () => true) {
    const links = [...sheets.keys()].filter((link) => sheets.get(link).contains(element));
    const link = links.find(isMeant) ?? links[0];
    if (link) choose(link);
  }

  choose([...sheets.keys()][0]);
  return reveal;
}
