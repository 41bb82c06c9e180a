// `select[data-filter=NAME]` hides each element that has another value in `data-NAME`. Rows of pairs have a second
// value, `data-NAME-too`, and are hidden only if both differ.
const filters = [...document.querySelectorAll("select[data-filter]")];

/** Hide the elements that do not match all filters, and show the others. */
const applyFilters = () => {
  if (!filters.length) return;
  const wanted = filters.filter((select) => select.value).map((select) => [select.dataset.filter, select.value]);
  for (const element of document.querySelectorAll(filters.map((select) => `[data-${select.dataset.filter}]`).join())) {
    element.toggleAttribute(
      "hidden",
      wanted.some(([name, value]) => name in element.dataset && ![element.dataset[name], element.dataset[`${name}Too`]].includes(value)),
    );
  }
};
