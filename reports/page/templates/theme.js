const THEMES = { light: "not all", dark: "screen", system: "screen and (prefers-color-scheme: dark)" }; // -> where the dark colours hold
const THEME_KEY = "ggvs-eval theme";

/** What was chosen last, on any page of this kind; a browser may refuse to tell a page that was opened from disk. */
function keptTheme() {
  try {
    const kept = localStorage.getItem(THEME_KEY);
    return Object.hasOwn(THEMES, kept) ? kept : "system";
  } catch {
    return "system";
  }
}

/** Remember a choice, where the browser lets this page. */
function keepTheme(theme) {
  try {
    localStorage.setItem(THEME_KEY, theme);
  } catch {
    // The choice holds until the page is closed.
  }
}

/** Show the page light, dark or as the system is; the browser's own controls go along. */
function applyTheme(theme) {
  document.getElementById("dark").media = THEMES[theme];
  document.documentElement.style.colorScheme = theme === "system" ? "light dark" : theme;
}

/** Let radio buttons choose the theme. */
function makeThemeSwitch(root) {
  root.hidden = false;
  for (const radio of root.querySelectorAll("input")) {
    radio.checked = radio.value === keptTheme();
    radio.addEventListener("change", () => {
      applyTheme(radio.value);
      keepTheme(radio.value);
    });
  }
}

applyTheme(keptTheme());
