/** A leaderboard has tables that can be sorted, and nothing else that moves. */
for (const table of document.querySelectorAll("table")) makeSortable(table);
makeCopyButtons();
makeThemeSwitch(document.querySelector(".theme"));
