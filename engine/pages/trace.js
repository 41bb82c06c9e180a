(() => {
  const slider = byId("until");
  const sections = [...document.querySelectorAll("section.step")];
  const parts = [...document.querySelectorAll("[data-step]:not(section)")];
  const show = () => {
    const until = Number(slider.value);
    const at = sections.findLast((section) => Number(section.dataset.step) <= until);
    byId("at").textContent = at ? `${until} of ${slider.max}: ${at.dataset.what}` : "no steps";
    for (const part of parts) part.classList.toggle("late", Number(part.dataset.step) > until);
  };
  slider.addEventListener("input", show);
  show();
})();
