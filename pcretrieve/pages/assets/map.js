"use strict";
// A map of pictures: wheel and buttons zoom, Shift and drag moves, and a line round shapes, or a class, chooses.
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

  const at = (event) => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  let places = [], before = null, moves = false;
  svg.addEventListener("pointerdown", (event) => { [before, places, moves] = [event, [at(event)], false]; });
  svg.addEventListener("pointermove", (event) => {
    const over = event.target.closest("a");
    if (over && !before && told.textContent !== over.ariaLabel) {
      told.textContent = over.ariaLabel;
      line.before(over);  // in front of the other pictures
    }
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
    if (moves && !event.shiftKey) choose(shapes.filter(({x, y}) => line.isPointInFill(new DOMPoint(x, y))));
    line.removeAttribute("points");
    before = null;
  });
  svg.addEventListener("click", (event) => { if (moves) event.preventDefault(); }, true);
  svg.addEventListener("mousedown", (event) => event.preventDefault());  // nothing is selected or dragged away
  svg.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-0.002 * event.deltaY), at(event));
  }, {passive: false});
  svg.addEventListener("focusin", (event) => { told.textContent = event.target.getAttribute("aria-label"); });
  map.addEventListener("click", ({target}) => {
    const {group, zoom: by} = (target.closest("button") || target).dataset;
    if (by) zoom(Number(by), {x: view.x + view.w / 2, y: view.y + view.h / 2});
    if (group) choose(shapes.filter(({link}) => link.dataset.group === group));
  });
  map.querySelector(".steer").hidden = false;
  look();
}

// A map that a server still computes, which waits for it for a second before it answers.
if (document.getElementById("waiting")) setTimeout(() => location.reload(), 100);
