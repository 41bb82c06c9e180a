// `select[data-filter=NAME]` hides each element that has another value in `data-NAME`. A row about two runs has a
// second value in `data-NAME-too`. Such a row is hidden only if both values differ from the selected value.
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
