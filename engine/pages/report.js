(() => {
  const runs = [...document.querySelectorAll(".runs tbody tr")];
  const filter = () => {
    applyFilters();
    const left = runs.filter((row) => !row.hidden).length;
    byId("found").textContent = left < runs.length ? `${left} of ${runs.length} runs` : "";
  };
  for (const select of filters) select.addEventListener("change", filter);
  // A browser that goes back restores what was chosen.
  filter();
})();
