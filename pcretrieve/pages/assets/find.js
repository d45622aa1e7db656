"use strict";
// Fields that search what the page has: of a list, the rows remain that have all words.
for (const field of document.querySelectorAll("[data-find]")) {
  const rows = [...document.querySelectorAll(field.dataset.find)];
  const words = new Map(rows.map((row) => [row, (row.dataset.findIn || row.textContent).toLowerCase()]));
  field.hidden = field.parentNode.hidden = false;
  field.addEventListener("input", () => {
    const asked = field.value.toLowerCase().split(/\s+/);
    for (const row of rows) row.hidden = !asked.every((word) => words.get(row).includes(word));
  });
}
// Classes of an exported site: the shapes of the one that is pressed remain, until a name is searched.
const classes = [...document.querySelectorAll("[data-class]")];
const press = (chosen) => {
  for (const one of classes) one.setAttribute("aria-pressed", String(one.dataset.class === chosen));
};
for (const button of classes) {
  button.addEventListener("click", () => {
    const chosen = button.getAttribute("aria-pressed") === "false" ? button.dataset.class : null;
    press(chosen);
    for (const row of document.querySelectorAll("[data-of]")) row.hidden = chosen !== null && row.dataset.of !== chosen;
  });
}
document.querySelector(".finding > [data-find]")?.addEventListener("input", () => press(null));
