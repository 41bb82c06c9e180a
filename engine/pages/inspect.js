"use strict";
(() => {
  const about = JSON.parse(document.getElementById("about").textContent);
  const articles = [...document.querySelectorAll("article")];
  const decided = new Map();
  const done = [];
  const dialog = document.getElementById("why");
  const reason = document.getElementById("reason");
  let current = 0;
  let unsaved = false;

  // What was decided outlives a page that is closed by mistake; a browser that keeps nothing for files only warns.
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
    document.getElementById("saved").textContent = saved ? "This browser keeps them until you start anew." : "";
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
      // Nothing is stored, or nothing that can be read.
    }
  };
  const changed = () => {
    unsaved = decided.size > 0;
    keep();
  };

  const show = () => {
    const count = (what) => [...decided.values()].filter((d) => d.decision === what).length;
    document.getElementById("count").textContent =
      `${decided.size} of ${articles.length} decided: ${count("accept")} accepted, ${count("reject")} rejected`;
    for (const [place, article] of articles.entries()) {
      const own = decided.get(article.dataset.id);
      article.classList.toggle("current", place === current);
      article.toggleAttribute("aria-current", place === current);
      article.dataset.decision = own ? own.decision : "";
      article.querySelector(".state").textContent = own ? `· ${own.decision}ed` : "";
      article.querySelector(".reason").textContent = own ? own.reason : "";
    }
  };
  const go = (place) => {
    current = Math.max(0, Math.min(articles.length - 1, place));
    // The keyboard goes along: what Tab reaches next are this question's own buttons.
    articles[current].focus({ preventScroll: true });
    articles[current].scrollIntoView({ block: "start" });
    show();
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
    const button = event.target.closest("button[data-do]");
    if (button) act[button.dataset.do](articles.indexOf(button.closest("article")));
  });
  const keys = { a: () => act.accept(current), r: () => ask(current), u: undo, j: () => go(current + 1), k: () => go(current - 1) };
  document.addEventListener("keydown", (event) => {
    if (dialog.open || event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
    const key = keys[event.key];
    if (key) {
      event.preventDefault();
      key();
    }
  });
  document.getElementById("download").addEventListener("click", () => {
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
  document.getElementById("anew").addEventListener("click", () => {
    if (decided.size && !confirm("Forget every decision on this page?")) return;
    decided.clear();
    done.length = 0;
    changed();
    go(0);
  });
  remember();
  keep();
  show();
})();
