"use strict";
// A map of pictures: wheel, two fingers and buttons zoom, Shift and drag moves, and a line round shapes, or a class,
// chooses. Of many classes, which are grey, that of the shape under the pointer lights up.
const map = document.querySelector(".map");
if (map) {
  const MOST_PICTURES = 300;  // in view at a time, of more there are dots
  const [svg, line, grid, told] = ["svg", ".line", ".chosen", "output"].map((name) => map.querySelector(name));
  const shapes = [...svg.querySelectorAll("a")].map((link) => {
    const {e: x, f: y} = link.transform.baseVal.consolidate().matrix;
    return {link, x, y};
  });
  const whole = {x: 0, y: svg.viewBox.baseVal.y, w: svg.viewBox.baseVal.width, h: svg.viewBox.baseVal.height};
  const view = {...whole};
  const inView = ({x, y}) => x >= view.x && x <= view.x + view.w && y >= view.y && y <= view.y + view.h;

  function look() {
    svg.setAttribute("viewBox", `${view.x} ${view.y} ${view.w} ${view.h}`);
    const near = shapes.filter(inView), pictured = near.length <= MOST_PICTURES;
    // Pictures grow with the square root of the zoom, so that crowds come apart; few, and on phones, are larger.
    const larger = Math.max(1, Math.min(1.7, Math.sqrt(60 / shapes.length)), Math.min(2, 640 / svg.clientWidth));
    svg.style.setProperty("--size", Math.sqrt(view.w / whole.w) * larger);
    svg.classList.toggle("pictured", pictured);
    for (const {link} of pictured ? near : []) {
      const image = link.querySelector("image:not([href])");
      if (image) image.setAttribute("href", link.dataset.picture);
    }
  }

  function zoom(by, at) {
    const factor = by && Math.max(1 / 30, Math.min(1, view.w / whole.w / by)) * whole.w / view.w;
    if (by) Object.assign(view, {
      x: at.x - factor * (at.x - view.x), y: at.y - factor * (at.y - view.y), w: factor * view.w, h: factor * view.h,
    });
    if (!by || view.w >= whole.w) Object.assign(view, whole);
    look();
  }

  function choose(chosen) {
    const all = new Set(chosen.map(({link}) => link));
    for (const {link} of shapes) link.classList.toggle("left", all.size > 0 && !all.has(link));
    told.textContent = all.size ? all.size + (all.size === 1 ? " shape is chosen." : " shapes are chosen.") : "";
    grid.replaceChildren(...[...all].map((link) => {
      const [item, card] = ["li", "a"].map((name) => document.createElement(name));
      const address = link.getAttribute("href");
      if (address) card.href = address;
      if (link.dataset.picture) {
        const picture = card.appendChild(document.createElement("img"));
        [picture.src, picture.alt] = [link.dataset.picture, ""];
      }
      card.append(link.dataset.id);
      item.append(card);
      return item;
    }));
  }

  const light = (lit) => { for (const {link} of shapes) link.classList.toggle("lit", lit(link)); };
  function tell(link) {
    const group = shapes.filter((shape) => shape.link.dataset.group === link.dataset.group);
    told.textContent = link.getAttribute("aria-label") + (map.classList.contains("many") ? ` (${group.length})` : "");
    light((each) => each.dataset.group === link.dataset.group);
    line.before(link);  // in front of the other pictures
  }
  const field = map.querySelector("input");
  if (field) field.addEventListener("input", () => {
    const asked = field.value.trim().toLowerCase();
    const found = asked ? shapes.filter(({link}) => link.ariaLabel.toLowerCase().includes(asked)) : [];
    choose(found.length > MOST_PICTURES ? [] : found);
    light((link) => found.some((shape) => shape.link === link));
    if (asked) told.textContent = found.length + (found.length === 1 ? " shape" : " shapes");
  });

  const at = (event) => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  let places = [], before = null, moves = false, tapped = null, over = null;
  const fingers = new Map();
  svg.addEventListener("pointerdown", (event) => {
    [before, places, moves] = [event, [at(event)], false];
    fingers.set(event.pointerId, event);
    if (fingers.size > 1) { before = null; moves = true; line.removeAttribute("points"); }
  });
  for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, (event) => fingers.delete(event.pointerId));
  svg.addEventListener("pointermove", (event) => {
    if (fingers.size === 2 && fingers.has(event.pointerId)) {
      const [other] = [...fingers].filter(([id]) => id !== event.pointerId).map(([, finger]) => finger);
      const last = fingers.get(event.pointerId), apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
      const [here, there] = [at(event), at(last)];
      Object.assign(view, {x: view.x + (there.x - here.x) / 2, y: view.y + (there.y - here.y) / 2});
      fingers.set(event.pointerId, event);
      zoom(apart(event) / (apart(last) || 1), at(other));
      return;
    }
    const under = event.target.closest("a");
    if (under && !before && under !== over) tell(over = under);
    if (!before || !moves && Math.hypot(event.clientX - before.clientX, event.clientY - before.clientY) < 6) return;
    if (!moves) svg.setPointerCapture(event.pointerId);
    moves = true;
    const [here, there] = [at(event), places[places.length - 1]];
    if (event.shiftKey) {
      Object.assign(view, {x: view.x + there.x - here.x, y: view.y + there.y - here.y});
      look();
    } else {
      places.push(here);
      line.setAttribute("points", places.map(({x, y}) => x + "," + y).join(" "));
    }
  });
  svg.addEventListener("pointerup", (event) => {
    if (before && moves && !event.shiftKey) choose(shapes.filter(({x, y}) => line.isPointInFill(new DOMPoint(x, y))));
    line.removeAttribute("points");
    before = null;
  });
  svg.addEventListener("click", (event) => {
    const link = event.target.closest("a"), isTouch = event.pointerType === "touch";
    // A finger has no way to point without a click: the first tap names a shape, the second opens it.
    if (moves || isTouch && link && link !== tapped) event.preventDefault();
    if (isTouch && link && !moves) tell(tapped = link);
  }, true);
  svg.addEventListener("mousedown", (event) => event.preventDefault());  // nothing is selected or dragged away
  svg.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-0.002 * event.deltaY), at(event));
  }, {passive: false});
  svg.addEventListener("focusin", (event) => tell(event.target));
  map.addEventListener("click", ({target}) => {
    const {group, zoom: by} = (target.closest("button") || target).dataset;
    if (by) zoom(Number(by), {x: view.x + view.w / 2, y: view.y + view.h / 2});
    if (group) choose(shapes.filter(({link}) => link.dataset.group === group));
  });
  look();
}

// A map that a server still computes, which waits for it for a second before it answers.
if (document.getElementById("waiting")) setTimeout(() => location.reload(), 100);
