// What the theme leaves without a name: the arrows that open parts of the sidebar, and equations and drawings that scroll.
document.addEventListener("DOMContentLoaded", () => {
  for (const arrow of document.querySelectorAll("summary:has(.toctree-toggle)")) {
    const name = arrow.closest("li")?.querySelector("a")?.textContent.trim();
    arrow.setAttribute("aria-label", name ? `Pages of ${name}` : "More pages");
  }
  for (const one of document.querySelectorAll("div.math, .bd-article p:has(> img[src$='.svg'])")) one.tabIndex = 0;
});
