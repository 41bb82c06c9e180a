"use strict";
// Headers of `table.sortable` sort its rows: numbers with the largest first, words by the alphabet; again turns them.
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows].at(-1).cells;
  /** What a cell is sorted by: its first line, a number where the column has numbers; null where there is none. */
  const key = (row, head) => {
    const cell = row.cells[head.cellIndex];
    const text = cell.dataset.value ?? (cell.querySelector("b, a") ?? cell.firstChild)?.textContent.trim() ?? "";
    if (!head.classList.contains("num")) return text || null;
    const number = parseFloat(text.replaceAll(",", ""));
    return Number.isNaN(number) ? null : number;
  };
  const compare = (one, other) => (typeof one === "number" ? one - other : one.localeCompare(other, undefined, { numeric: true }));
  const sort = (head) => {
    const first = head.classList.contains("num") ? "descending" : "ascending";
    const second = first === "ascending" ? "descending" : "ascending";
    const order = head.ariaSort === first ? second : first;
    for (const other of heads) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", order);
    const sign = order === "ascending" ? 1 : -1;
    const body = table.tBodies[0];
    const rows = [...body.rows].map((row) => [key(row, head), row]);
    // What has no value stands last in either order.
    rows.sort(([one], [other]) => (one === null || other === null ? (one === null) - (other === null) : sign * compare(one, other)));
    body.append(...rows.map(([, row]) => row));
  };
  for (const head of heads) {
    if (!head.textContent.trim()) continue;
    const button = Object.assign(document.createElement("button"), { type: "button", className: "sort", title: "Sort" });
    // An axis below the words is no part of the button.
    button.append(...[...head.childNodes].filter((node) => node.nodeName !== "svg"));
    button.addEventListener("click", () => sort(head));
    head.prepend(button);
  }
}
