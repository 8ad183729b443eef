// Light or dark: as chosen on this device, otherwise as the system. Runs before anything is drawn.
(() => {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const chosen = () => { try { return localStorage.getItem("theme"); } catch { return null; } };
  window.applyTheme = () => {
    const theme = chosen() ?? (dark.matches ? "dark" : "light");
    document.documentElement.dataset.theme = theme;
    dispatchEvent(new CustomEvent("theme", { detail: theme }));
  };
  dark.addEventListener("change", window.applyTheme);
  window.applyTheme();
})();
