(() => {
  const { scene, pictured } = JSON.parse(document.getElementById("scene").textContent);
  const scrub = byId("scrub");
  const picture = byId("picture");
  const frames = scene.frames;
  const nearest = (frame) => {
    let best = 0;
    frames.forEach((own, place) => {
      if (Math.abs(own - frame) < Math.abs(frames[best] - frame)) best = place;
    });
    return best;
  };
  const overlay = (frame) => {
    const parts = [];
    const labels = [];
    const named = [];
    for (const look of scene.looks.filter((own) => own.frame === frame)) {
      for (const [x, width] of look.spans) {
        parts.push(drawn("rect", { class: "look", x: x + 4, y: 4, width: Math.max(0, width - 8), height: scene.height - 8 }));
      }
    }
    for (const own of scene.boxes.filter((box) => box.frame === frame)) {
      const [left, y, width, height] = own.box;
      // A box that crosses the seam is drawn at both ends.
      for (const x of [left - scene.width, left, left + scene.width]) {
        if (x >= scene.width || x + width <= 0) continue;
        const place = { x, y, width: Math.max(0, width), height: Math.max(0, height) };
        const group = drawn("g", { ...(own.kind.startsWith("role") && { class: own.kind }) });
        group.append(drawn("rect", { class: "edge", ...place }), drawn("rect", { class: `box ${own.kind}`, ...place }));
        group.append(drawn("title", {}, own.name));
        // If two people are side by side, one of their names is drawn below the box, so that the names do not overlap.
        // If a person has several boxes close to each other, only the first shows the name.
        if (group.classList.length && !named.some(([name, left]) => name === own.name && Math.abs(left - x) < 200)) {
          const taken = named.some(([name, left, top]) => Math.abs(left - x) < 30 * name.length && Math.abs(top - y) < 60);
          const row = taken ? y + height + 70 : y;
          named.push([own.name, x, row]);
          labels.push(drawn("g", { class: own.kind }));
          labels.at(-1).append(drawn("text", { x: Math.max(4, x), style: `--y: ${row}px` }, own.name));
        }
        parts.push(group);
      }
    }
    byId("overlay").replaceChildren(...parts, ...labels);
  };

  let at = 0;
  let playing = 0;
  const show = (place) => {
    at = Math.min(Math.max(place, 0), frames.length - 1);
    const frame = frames[at];
    scrub.value = at;
    byId("frame").textContent = `frame ${frame} · ${(frame / scene.fps).toFixed(1)} s`;
    overlay(frame);
    if (!pictured) return Promise.resolve();
    const address = `panorama?${new URLSearchParams({ sequence: scene.sequence, frame })}`;
    const loading = new Image();
    loading.src = address;
    return loading.decode().then(
      () => {
        if (frames[at] !== frame) return;
        picture.setAttribute("href", address);
        byId("lacking").textContent = "";
      },
      () => {
        if (frames[at] !== frame) return;
        picture.removeAttribute("href");
        byId("lacking").textContent = ` · no picture of frame ${frame}`;
      },
    );
  };
  const stop = () => {
    playing += 1;
    byId("play").textContent = "play";
  };
  const play = async () => {
    const mine = (playing += 1);
    byId("play").textContent = "pause";
    if (at === frames.length - 1) at = -1;
    while (playing === mine && at < frames.length - 1) {
      await Promise.all([show(at + 1), new Promise((done) => setTimeout(done, 200))]);
    }
    if (playing === mine) stop();
  };
  const toggle = () => (byId("play").textContent === "play" ? play() : stop());
  const go = (place) => {
    stop();
    show(place);
  };
  const places = [...new Set(scene.looks.map((look) => nearest(look.frame)))].sort((a, b) => a - b);
  const before = () => go(places.findLast((place) => place < at) ?? at);
  const after = () => go(places.find((place) => place > at) ?? at);

  if (!frames.length) {
    for (const control of byId("stage").querySelectorAll("button, input")) control.disabled = true;
    return;
  }
  const tick = (frame, kind) =>
    byId("ticks").append(drawn("rect", { class: kind, x: (990 * nearest(frame)) / Math.max(1, frames.length - 1), y: 0, width: 10, height: 9 }));
  for (const look of scene.looks) tick(look.frame, "look");
  for (const box of scene.boxes.filter((own) => own.kind === "given")) tick(box.frame, "given");
  byId("before").disabled = byId("after").disabled = !places.length;
  scrub.addEventListener("input", () => go(Number(scrub.value)));
  byId("play").addEventListener("click", toggle);
  byId("before").addEventListener("click", before);
  byId("after").addEventListener("click", after);
  for (const button of document.querySelectorAll("button.jump")) {
    button.addEventListener("click", () => go(nearest(Number(button.dataset.frame))));
  }
  const keys = { ArrowLeft: () => go(at - 1), ArrowRight: () => go(at + 1), n: after, p: before, " ": toggle };
  document.addEventListener("keydown", (event) => {
    if (!isShortcut(event) || !keys[event.key]) return;
    // The space bar presses the focused button, and arrow keys scroll the focused element. Neither is a shortcut then.
    if (event.target.closest(event.key === " " ? "button, summary, a, pre" : ".scroll[tabindex], pre")) return;
    event.preventDefault();
    keys[event.key]();
  });
  show(nearest(scene.start));
})();
