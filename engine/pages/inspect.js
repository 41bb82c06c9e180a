(() => {
  const about = JSON.parse(byId("about").textContent);
  const articles = [...document.querySelectorAll("article")];
  const decided = new Map();
  const done = [];
  const dialog = byId("why");
  const reason = byId("reason");
  let current = 0;
  let unsaved = false;

  // Decisions are stored in the browser, so that they survive if the page is closed by mistake. If the browser stores
  // nothing for local files, it only warns before the page closes.
  const shelf = `jrdb-avr inspect ${about.questions_sha256} ${articles.map((a) => a.dataset.id).join()}`;
  let saved = false;
  const keep = () => {
    try {
      if (decided.size) localStorage.setItem(shelf, JSON.stringify([...decided.values()]));
      else localStorage.removeItem(shelf);
      saved = true;
    } catch {
      saved = false;
    }
    byId("saved").textContent = saved ? "This browser keeps the decisions until you start anew." : "";
  };
  const remember = () => {
    try {
      const known = new Set(articles.map((a) => a.dataset.id));
      for (const own of JSON.parse(localStorage.getItem(shelf) || "[]")) {
        const fits = known.has(own.question_id) && ["accept", "reject"].includes(own.decision);
        if (fits && typeof own.reason === "string")
          decided.set(own.question_id, { question_id: own.question_id, decision: own.decision, reason: own.reason });
      }
    } catch {
      // Nothing is stored, or the stored text cannot be read.
    }
  };
  const changed = () => {
    unsaved = decided.size > 0;
    keep();
    show();
  };

  /** Return the index of the nearest visible question from `place` on. A step of 1 searches forwards, -1 backwards. */
  const visible = (place, step) => {
    while (articles[place]?.hidden) place += step;
    return articles[place] ? place : undefined;
  };
  const show = () => {
    const count = (what) => [...decided.values()].filter((d) => d.decision === what).length;
    byId("count").textContent =
      `${decided.size} of ${articles.length} decided: ${count("accept")} accepted, ${count("reject")} rejected`;
    byId("progress").value = decided.size;
    for (const [place, article] of articles.entries()) {
      const own = decided.get(article.dataset.id);
      article.dataset.decision = own ? own.decision : "none";
      article.querySelector(".state").textContent = own ? `· ${own.decision}ed` : "";
      article.querySelector(".reason").textContent = own ? own.reason : "";
    }
    applyFilters();
    current = visible(current, 1) ?? visible(current, -1) ?? current;
    for (const [place, article] of articles.entries()) {
      article.classList.toggle("current", place === current);
      article.toggleAttribute("aria-current", place === current);
    }
    const left = articles.filter((article) => !article.hidden).length;
    byId("found").textContent = left < articles.length ? `${left} of ${articles.length} shown` : "";
  };
  /** Make a question the current one. If filters hide the question, take the next visible one, if there is one. */
  const go = (place, step = 1) => {
    const next = visible(place, step);
    if (next === undefined) return;
    current = next;
    // The focus moves too, so that the next press of Tab reaches the buttons of this question.
    articles[current].focus({ preventScroll: true });
    articles[current].scrollIntoView({ block: "start" });
    show();
  };
  /** Show the panoramas of a question one second earlier or later, if the page has them. */
  const turn = (figure, seconds) => {
    for (const part of figure.querySelectorAll("[data-seconds]")) part.toggleAttribute("hidden", part.dataset.seconds !== seconds);
    for (const button of figure.querySelectorAll("[data-show]")) button.setAttribute("aria-pressed", button.dataset.show === seconds);
  };
  const step = (by) => {
    for (const figure of articles[current].querySelectorAll("figure:has([data-show])")) {
      const buttons = [...figure.querySelectorAll("[data-show]")];
      const to = buttons.findIndex((button) => button.ariaPressed === "true") + by;
      if (buttons[to]) turn(figure, buttons[to].dataset.show);
    }
  };
  const decide = (place, decision, why) => {
    const id = articles[place].dataset.id;
    done.push([place, decided.get(id)]);
    decided.set(id, { question_id: id, decision, reason: why });
    changed();
    go(place + 1);
  };
  const undo = () => {
    const last = done.pop();
    if (!last) return;
    const id = articles[last[0]].dataset.id;
    if (last[1]) decided.set(id, last[1]);
    else decided.delete(id);
    changed();
    go(last[0]);
  };
  const ask = (place) => {
    current = place;
    show();
    reason.value = decided.get(articles[place].dataset.id)?.reason ?? "";
    dialog.returnValue = "";
    dialog.showModal();
    reason.focus();
  };
  dialog.addEventListener("close", () => {
    if (dialog.returnValue === "reject") decide(current, "reject", reason.value.trim());
  });
  reason.addEventListener("keydown", (event) => {
    if (event.key === "Enter" && !event.shiftKey) {
      event.preventDefault();
      dialog.close("reject");
    }
  });
  const act = { accept: (place) => decide(place, "accept", ""), reject: ask, undo };
  document.addEventListener("click", (event) => {
    const button = event.target.closest("button[data-do], button[data-show]");
    if (!button) return;
    if (button.dataset.show) turn(button.closest("figure"), button.dataset.show);
    else act[button.dataset.do](articles.indexOf(button.closest("article")));
  });
  const keys = { a: () => act.accept(current), r: () => ask(current), u: undo, j: () => go(current + 1), k: () => go(current - 1, -1), ",": () => step(-1), ".": () => step(1) };
  document.addEventListener("keydown", (event) => {
    if (dialog.open || event.repeat || !isShortcut(event)) return;
    const key = keys[event.key];
    if (key && articles[current]?.hidden === false) {
      event.preventDefault();
      key();
    }
  });
  byId("download").addEventListener("click", () => {
    const file = { ...about, decisions: articles.map((a) => decided.get(a.dataset.id)).filter(Boolean) };
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([JSON.stringify(file, null, 1)], { type: "application/json" }));
    link.download = "decisions.json";
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    unsaved = false;
  });
  window.addEventListener("beforeunload", (event) => {
    if (unsaved && !saved) event.preventDefault();
  });
  byId("anew").addEventListener("click", () => {
    if (decided.size && !confirm("Forget every decision on this page?")) return;
    decided.clear();
    done.length = 0;
    changed();
    go(0);
  });
  for (const select of filters) select.addEventListener("change", show);
  remember();
  keep();
  show();
})();
