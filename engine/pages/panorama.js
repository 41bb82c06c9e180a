// Wheel, keys and buttons zoom every `.zoomable > svg`. The buttons are in the element `.zoom` beside the picture.
// Dragging turns the panorama, which has no ends.
// The picture becomes higher when it is zoomed. `--unit` is the length of a screen pixel in units of the picture.
(() => {
  const MOST = 10;
  const LEAST_HEIGHT = 110;
  const shows = [];
  for (const [place, frame] of document.querySelectorAll(".zoomable").entries()) {
    const svg = frame.querySelector("svg");
    const { width: full, height } = svg.viewBox.baseVal;
    let left = 0;
    let top = 0;
    let wide = full;
    // A narrow screen begins with a part of the panorama around the first box, not with a strip of a few pixels.
    const whole = () => Math.min(full, (height * svg.clientWidth) / LEAST_HEIGHT);
    const tall = () => Math.min(height, (wide * 0.6 * innerHeight) / svg.clientWidth);

    // To the right of its end, the panorama begins again.
    const scene = svg.querySelector(".scene");
    scene.id = `scene${place}`;
    const again = drawn("use", { href: `#${scene.id}`, x: full });

    const show = () => {
      if (!svg.clientWidth) return;
      left = ((left % full) + full) % full;
      top = Math.min(Math.max(top, 0), height - tall());
      svg.setAttribute("viewBox", `${left} ${top} ${wide} ${tall()}`);
      svg.style.setProperty("--unit", wide / svg.clientWidth);
      if (left + wide > full) svg.append(again);
      else again.remove();
    };
    const firstBox = () => svg.querySelector("rect.target, rect.box, rect.look")?.getBBox();
    /** Return the column that keys zoom around, in shares of the width: the first box if visible, else the middle. */
    const aim = () => {
      const box = firstBox();
      const share = box ? ((box.x + box.width / 2 - left + 2 * full) % full) / wide : 1;
      return share < 1 ? share : 0.5;
    };
    /** Zoom around a point of the picture. x and y are shares of the width and of the height. */
    const zoom = (factor, x = aim(), y = 0.5) => {
      const [column, row] = [left + x * wide, top + y * tall()];
      wide = Math.min(full, Math.max(full / MOST, wide / factor));
      left = wide === full && factor < 1 ? 0 : column - x * wide;
      top = row - y * tall();
      show();
    };
    const reset = () => {
      wide = whole();
      const box = firstBox();
      left = wide < full && box ? box.x + box.width / 2 - wide / 2 : 0;
      top = 0;
      show();
    };
    const move = (x, y) => {
      left += x;
      top += y;
      show();
    };

    const buttons = frame.closest("figure, .stage").querySelector(".zoom");
    for (const [text, label, act] of [["+", "Zoom in", () => zoom(1.5)], ["−", "Zoom out", () => zoom(1 / 1.5)], ["⟲", "Whole panorama", reset]]) {
      const button = Object.assign(document.createElement("button"), { type: "button", textContent: text, title: label });
      button.setAttribute("aria-label", label);
      button.addEventListener("click", act);
      buttons.append(button);
    }

    svg.tabIndex = 0;
    // The wheel zooms only after a click on the panorama. Before, it scrolls the page.
    const wheel = (event) => {
      if (!event.ctrlKey && document.activeElement !== svg) return;
      event.preventDefault();
      const area = svg.getBoundingClientRect();
      const notches = event.deltaY / (event.deltaMode ? 3 : 100);
      zoom(1.25 ** -notches, (event.clientX - area.left) / area.width, (event.clientY - area.top) / area.height);
    };
    svg.addEventListener("wheel", wheel, { passive: false });
    let held = null;
    svg.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      svg.setPointerCapture(event.pointerId);
      held = event;
    });
    svg.addEventListener("pointermove", (event) => {
      if (!held) return;
      const scale = wide / svg.clientWidth;
      move((held.clientX - event.clientX) * scale, (held.clientY - event.clientY) * scale);
      held = event;
    });
    for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, () => (held = null));
    const keys = { "+": () => zoom(1.5), "=": () => zoom(1.5), "-": () => zoom(1 / 1.5), 0: reset };
    const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    svg.addEventListener("keydown", (event) => {
      const step = wide < full && steps[event.key];
      if (!isShortcut(event) || !(step || keys[event.key])) return;
      event.preventDefault();
      event.stopPropagation();
      if (step) move(step[0] * wide, step[1] * tall());
      else keys[event.key]();
    });

    // Called with the first size and with each later size. The panorama may be hidden at first.
    let known = 0;
    new ResizeObserver(() => {
      if (svg.clientWidth === known) return;
      if (known) show();
      else reset();
      known = svg.clientWidth;
    }).observe(svg);
    shows.push([svg, show, `0 0 ${full} ${height}`]);
  }
  addEventListener("resize", () => shows.forEach(([, show]) => show()));
  addEventListener("beforeprint", () => {
    for (const [svg, , whole] of shows) svg.setAttribute("viewBox", whole);
  });
  addEventListener("afterprint", () => shows.forEach(([, show]) => show()));
})();
