// Light or dark: as the system has it, until the user chooses.

const CHOSEN = "certrack-theme";

export function beginTheme() {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = localStorage.getItem(CHOSEN) ?? (dark ? "dark" : "light");
}

export function switchTheme() {
  const theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  document.documentElement.dataset.theme = theme;
  localStorage.setItem(CHOSEN, theme);
}
