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
