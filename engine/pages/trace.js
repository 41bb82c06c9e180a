"use strict";
(() => {
  const slider = document.getElementById("until");
  const parts = [...document.querySelectorAll("[data-step]")].filter((part) => !part.classList.contains("step"));
  const show = () => {
    const until = Number(slider.value);
    document.getElementById("at").textContent = `${until} of ${slider.max}`;
    for (const part of parts) part.classList.toggle("late", Number(part.dataset.step) > until);
  };
  slider.addEventListener("input", show);
  show();
})();
