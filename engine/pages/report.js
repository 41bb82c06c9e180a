(() => {
  const runs = [...document.querySelectorAll(".runs tbody tr")];
  const filter = () => {
    applyFilters();
    const left = runs.filter((row) => !row.hidden).length;
    byId("found").textContent = left < runs.length ? `${left} of ${runs.length} runs` : "";
  };
  for (const select of filters) select.addEventListener("change", filter);
  // When the user goes back to the page, the browser restores the selected filters.
  filter();
})();
