(() => {
  const slider = byId("until");
  const sections = [...document.querySelectorAll("section.step")];
  const parts = [...document.querySelectorAll("[data-step]:not(section)")];
  const show = () => {
    const until = Number(slider.value);
    const at = sections.findLast((section) => Number(section.dataset.step) <= until);
    byId("at").textContent = at ? `${until} of ${slider.max}: ${at.dataset.what}` : "no steps";
    // A belief held at step k if its step <= k and its until > k.
    for (const part of parts) {
      part.classList.toggle("late", Number(part.dataset.step) > until);
      part.classList.toggle("gone", "until" in part.dataset && Number(part.dataset.until) <= until);
    }
  };
  slider.addEventListener("input", show);
  show();
})();
