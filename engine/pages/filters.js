// `select[data-filter=NAME]` hides what has another value in its attribute `data-NAME`, and in `data-NAME-too` of a pair.
const filters = [...document.querySelectorAll("select[data-filter]")];

/** Hide what does not fit, and show the rest. */
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
