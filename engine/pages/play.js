(() => {
  const WIDTH = 3760;
  const CROP = 480;
  const THOUSAND = 1000;
  const made = (name, values, text = "") => Object.assign(document.createElement(name), values, { textContent: text });
  const frameId = (frame) => String(frame).padStart(6, "0");

  let play = null;
  let angle = 180;
  let at = 0;
  let box = null;
  let busy = false;

  // -- the next look ---------------------------------------------------------------------------------------------------

  const left = () => (Math.round((angle / 360) * WIDTH) - CROP / 2 + WIDTH) % WIDTH;
  const copies = (x) => [x - WIDTH, x].filter((own) => own < WIDTH && own + CROP > 0);
  const picture = (number) => `look?${new URLSearchParams({ question: play.question_id, number })}`;

  const aim = () => {
    const frame = play.frames[at];
    byId("scrub").value = at;
    byId("goto").value = frame;
    byId("place").textContent = `${(frame / play.fps).toFixed(1)} s · ${angle.toFixed(0)}°`;
    byId("strip").setAttribute("aria-valuenow", angle.toFixed(0));
    byId("window").replaceChildren(
      ...copies(left()).map((x) => drawn("rect", { class: "window", x: x + 5, y: 5, width: CROP - 10, height: CROP - 10 })),
    );
    const seen = play.looks.flatMap((look, number) =>
      Number(look.frame_id) === frame
        ? copies(look.left).map((x) => drawn("image", { href: picture(number), x, y: 0, width: CROP, height: CROP }))
        : [],
    );
    byId("sofar").replaceChildren(...seen);
  };
  const turn = (degrees) => {
    angle = (((angle + degrees) % 360) + 360) % 360;
    aim();
  };
  const go = (place) => {
    at = Math.min(Math.max(place, 0), play.frames.length - 1);
    aim();
  };

  let dragged = null;
  const strip = byId("strip");
  const pointed = (event) => ((event.clientX - strip.getBoundingClientRect().left) / strip.clientWidth) * 360;
  strip.addEventListener("pointerdown", (event) => {
    strip.setPointerCapture(event.pointerId);
    const start = pointed(event);
    const off = Math.abs(((start - angle + 540) % 360) - 180);
    // A drag that begins inside the window moves the window. A drag that begins outside first centres the window there.
    if (off > (CROP / WIDTH) * 180) angle = ((start % 360) + 360) % 360;
    dragged = { start, angle };
    aim();
  });
  strip.addEventListener("pointermove", (event) => {
    if (!dragged) return;
    angle = (((dragged.angle + pointed(event) - dragged.start) % 360) + 360) % 360;
    aim();
  });
  strip.addEventListener("pointerup", () => (dragged = null));
  strip.addEventListener("pointercancel", () => (dragged = null));
  for (const [degrees, word] of [[0, "behind"], [90, "left"], [180, "ahead"], [270, "right"]]) {
    const x = (degrees / 360) * WIDTH;
    byId("compass").append(drawn("line", { x1: x, x2: x, y1: 0, y2: 480 }), drawn("text", { x: x + 14, y: 466 }, `${degrees}° ${word}`));
  }

  // -- the box in the newest picture -----------------------------------------------------------------------------------

  const view = byId("view");
  const spot = (event) => {
    const area = view.getBoundingClientRect();
    return [(event.clientX - area.left) / area.width, (event.clientY - area.top) / area.height].map((part) =>
      Math.round(THOUSAND * Math.min(Math.max(part, 0), 1)),
    );
  };
  let corner = null;
  const outline = () => {
    const parts = [];
    if (box) {
      const [x1, y1, x2, y2] = box.map((value) => (value * CROP) / THOUSAND);
      const place = { x: x1, y: y1, width: x2 - x1, height: y2 - y1 };
      parts.push(drawn("rect", place), drawn("rect", { class: "drawn", ...place }));
    }
    byId("box").replaceChildren(...parts);
    ready();
  };
  view.addEventListener("pointerdown", (event) => {
    if (!play?.looks.length || play.over) return;
    view.setPointerCapture(event.pointerId);
    corner = spot(event);
    box = null;
    outline();
  });
  view.addEventListener("pointermove", (event) => {
    if (!corner) return;
    const [x, y] = spot(event);
    const sides = [Math.min(x, corner[0]), Math.min(y, corner[1]), Math.max(x, corner[0]), Math.max(y, corner[1])];
    box = sides[0] < sides[2] && sides[1] < sides[3] ? sides : null;
    outline();
  });
  view.addEventListener("pointerup", () => (corner = null));
  view.addEventListener("pointercancel", () => (corner = null));

  // -- the answer ------------------------------------------------------------------------------------------------------

  /** Return the parts of the answer that are typed. A choice is not typed but selected. */
  const typed = () => play.fields.filter((part) => part.kind !== "choice");
  const field = (key) => byId("fields").querySelector(`[name="${key}"]`);
  const fields = () => {
    const parts = play.choices.map((text, place) => {
      const label = made("label", {});
      label.append(made("input", { type: "radio", name: "choice", value: String(place + 1) }), ` ${place + 1}. ${text}`);
      return label;
    });
    for (const { key, kind, label: word } of typed()) {
      const label = made("label", {}, `${word} `);
      label.append(made("input", { type: "text", inputMode: "decimal", name: key, autocomplete: "off" }));
      if (kind !== "decimal") {
        const use = made("button", { type: "button" }, kind === "angle" ? "direction of the strip" : "frame of the slider");
        use.addEventListener("click", () => {
          field(key).value = kind === "angle" ? angle.toFixed(1) : play.frames[at];
          ready();
        });
        label.append(" ", use);
      }
      parts.push(label);
    }
    byId("fields").replaceChildren(...parts);
  };
  /** Return the answer in the form that the server takes, or null if a part is missing or is not a number. */
  const answer = () => {
    if (!typed().length) {
      const chosen = byId("fields").querySelector("input:checked");
      return chosen && Number(chosen.value);
    }
    const found = {};
    for (const { key, kind } of typed()) {
      const text = field(key).value.trim();
      const whole = kind === "frame";
      if (!(whole ? /^\d{1,6}$/ : /^-?\d+(\.\d+)?$/).test(text)) return null;
      found[key] = whole ? frameId(text) : kind === "decimal" ? text : Number(text);
    }
    return found;
  };
  const ready = () => {
    if (!play) return;
    const lacking = [
      ...(play.looks.length ? [] : ["a look"]),
      ...(box ? [] : ["a box around the person, drawn in the newest picture"]),
      ...(answer() === null ? ["the answer"] : []),
    ];
    byId("need").textContent = lacking.length ? `Still needed: ${lacking.join("; ")}.` : "";
    byId("submit").disabled = busy || play.over || lacking.length > 0;
    byId("look").disabled = busy || play.over || !play.left.looks;
  };

  // -- the server ------------------------------------------------------------------------------------------------------

  const show = (state) => {
    const before = play;
    play = state.play ?? null;
    const fresh = play && play.question_id !== before?.question_id;
    byId("progress").textContent = `${state.questions - state.due} of ${state.questions} questions answered`;
    byId("done").hidden = play !== null;
    byId("playing").hidden = play === null || play.over;
    byId("over").hidden = !play?.over;
    byId("error").textContent = state.error;
    if (!play) return;
    byId("how").textContent = play.answered ? "The answer was accepted." : "The question is over. Parts of your answers that could be read still count.";
    byId("next").textContent = state.due ? "next question" : "finish";
    if (fresh) {
      byId("question").textContent = play.question;
      byId("rule").textContent = `The answer: ${play.rule}`;
      byId("advice").textContent = play.advice;
      byId("scrub").max = play.frames.length - 1;
      fields();
      const last = play.looks.at(-1);
      angle = last ? last.angle_deg : 180;
      at = last ? Math.max(0, play.frames.indexOf(Number(last.frame_id))) : 0;
    }
    if (fresh || play.looks.length !== before.looks.length) {
      box = null;
      const newest = play.looks.length - 1;
      if (newest < 0) byId("newest").removeAttribute("href");
      else byId("newest").setAttribute("href", picture(newest));
      const look = play.looks[newest];
      byId("caption").textContent = look
        ? `Newest picture: frame ${Number(look.frame_id)}, ${look.angle_deg.toFixed(0)}°. Draw the box of the person in it.`
        : "No look yet: the first turn must look.";
      byId("taken").replaceChildren(
        ...play.looks.map((own) => {
          const item = made("li", {});
          const button = made("button", { type: "button" }, `frame ${Number(own.frame_id)}, ${own.angle_deg.toFixed(0)}°`);
          button.addEventListener("click", () => {
            angle = own.angle_deg;
            go(play.frames.indexOf(Number(own.frame_id)));
          });
          item.append(button);
          return item;
        }),
      );
    }
    byId("left").textContent = `${play.left.looks} looks, ${play.left.moves} turns left`;
    aim();
    outline();
  };
  const send = async (path, body = {}) => {
    if (busy) return;
    busy = true;
    ready();
    try {
      const response = await fetch(path, { method: "POST", body: JSON.stringify(body) });
      busy = false;
      if (response.ok) show(await response.json());
      else byId("error").textContent = await response.text();
    } catch {
      byId("error").textContent = "The server does not respond. Is the command still running?";
    }
    busy = false;
    ready();
  };
  const move = (own) => send("move", { question_id: play.question_id, move: own });
  const look = () => {
    const frame_id = frameId(play.frames[at]);
    const angle_deg = Math.round(angle * 10) / 10;
    const near = (own) => Math.abs(((own.angle_deg - angle_deg + 540) % 360) - 180) <= 1;
    if (play.looks.some((own) => own.frame_id === frame_id && near(own)))
      byId("error").textContent = "You have this picture already (within 1 degree). The repeated look cost nothing.";
    else move({ action: "observe", frame_id, angle_deg });
  };

  byId("look").addEventListener("click", look);
  byId("scrub").addEventListener("input", () => go(Number(byId("scrub").value)));
  byId("goto").addEventListener("change", () => {
    const asked = Number(byId("goto").value);
    const off = (place) => Math.abs(play.frames[place] - asked);
    if (asked >= 0) go(play.frames.reduce((best, _, place) => (off(place) < off(best) ? place : best), 0));
  });
  byId("next").addEventListener("click", () => send("next"));
  byId("answer").addEventListener("input", ready);
  byId("answer").addEventListener("submit", (event) => {
    event.preventDefault();
    const bbox = box;
    const frame_id = play.looks.at(-1).frame_id;
    move({ action: "answer", answer: answer(), evidence_bboxes: [{ frame_id, bbox }] });
  });
  document.addEventListener("keydown", (event) => {
    const degrees = { ArrowLeft: -5, ArrowRight: 5 }[event.key];
    // In the slider and among choices, the arrow keys keep their meaning.
    if (!degrees || !play || !isShortcut(event) || event.target.closest("input")) return;
    event.preventDefault();
    turn(degrees);
  });
  document.addEventListener("keydown", (event) => {
    if (event.key !== "l" || !isShortcut(event)) return;
    if (byId("look").disabled || byId("playing").hidden) return;
    look();
  });
  send("state");
})();
