// The report without a server: queries are searched and sorted, and tables are sorted by their columns.
{
  "use strict";
  const panels = document.getElementById("panels");
  const tools = document.querySelector(".tools");
  const compare = (a, b) => a.localeCompare(b, undefined, { numeric: true });

  if (panels) {
    const articles = [...panels.children];
    const [find, order, errors, count] = ["find", "order", "errors", "count"].map((id) => document.getElementById(id));
    const words = new Map(articles.map((a) => [a, a.querySelector(".query").textContent.toLowerCase()]));
    const score = (article) => Number(article.dataset.score || 2);  // queries without a score are the last
    const orders = {
      score: (a, b) => score(a) - score(b),
      "-score": (a, b) => (score(b) % 2) - (score(a) % 2),
      name: (a, b) => compare(a.dataset.name, b.dataset.name),
      label: (a, b) => compare(a.dataset.label, b.dataset.label) || score(a) - score(b),
    };
    const filter = () => {
      const asked = find.value.toLowerCase().split(/\s+/);
      let found = 0;
      for (const article of panels.children) {
        const wrong = !errors || !errors.checked || article.querySelector(".wrong");
        const fits = wrong && asked.every((word) => words.get(article).includes(word));
        found += fits;
        article.hidden = !fits || found > most;
      }
      count.textContent = found + " of " + articles.length;
      all.hidden = found <= most;
      all.textContent = "Show all " + found;
    };
    const sort = () => { panels.append(...[...articles].sort(orders[order.value])); filter(); };
    // The first are enough to see what goes wrong.
    let most = Number(panels.dataset.most);
    const all = document.createElement("button");
    all.type = "button";
    all.addEventListener("click", () => { most = Infinity; filter(); });
    panels.after(all);
    // A link leads to a query that the search has hidden: the search ends.
    const reveal = () => {
      const target = articles.find((article) => "#" + article.id === location.hash);
      if (!target || !target.hidden) return;
      find.value = "";
      if (errors) errors.checked = false;
      most = Infinity;
      filter();
      target.scrollIntoView();
    };
    tools.hidden = false;
    tools.addEventListener("submit", (event) => event.preventDefault());
    find.addEventListener("input", filter);
    if (errors) errors.addEventListener("change", filter);
    order.addEventListener("change", sort);
    addEventListener("hashchange", reveal);
    // A browser may have kept the fields of an earlier visit.
    sort();
    reveal();
  }

  for (const table of document.querySelectorAll("table.sortable")) {
    const body = table.tBodies[0], most = Number(table.dataset.most || Infinity);
    if (body.rows.length > most) {
      const all = document.createElement("button"), fold = (isFolded) => [...body.rows].forEach((row, place) => { row.hidden = isFolded && place >= most; });
      all.type = "button";
      all.textContent = "Show all " + body.rows.length;
      all.addEventListener("click", () => { fold(false); all.remove(); });
      table.after(all);
      fold(true);
    }
    table.querySelectorAll("thead th").forEach((head, column) => {
      const button = document.createElement("button");
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const down = head.getAttribute("aria-sort") === "ascending";
        for (const other of table.querySelectorAll("thead th")) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const text = (row) => row.cells[column].textContent;
        const rows = [...body.rows].sort((a, b) => compare(text(a), text(b)));
        // Rows that are folded stay so by their places.
        const hidden = [...body.rows].map((row) => row.hidden);
        body.append(...(down ? rows.reverse() : rows));
        [...body.rows].forEach((row, place) => { row.hidden = hidden[place]; });
      });
    });
  }
}
