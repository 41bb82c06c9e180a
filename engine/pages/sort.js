"use strict";
// A click on a header of `table.sortable` sorts the rows by the column of the header. Numbers are sorted with the
// largest first, texts by the alphabet. A second click reverses the order.
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows].at(-1).cells;
  /** Return the sort key of a row: the first line of the row's cell, or a number in columns of numbers, or null. */
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
    // Rows without a value come last in both orders.
    rows.sort(([one], [other]) => (one === null || other === null ? (one === null) - (other === null) : sign * compare(one, other)));
    body.append(...rows.map(([, row]) => row));
  };
  for (const head of heads) {
    if (!head.textContent.trim()) continue;
    const button = Object.assign(document.createElement("button"), { type: "button", className: "sort", title: "Sort" });
    // A drawn axis below the words does not become part of the button.
    button.append(...[...head.childNodes].filter((node) => node.nodeName !== "svg"));
    button.addEventListener("click", () => sort(head));
    head.prepend(button);
  }
}
