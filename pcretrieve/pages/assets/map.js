// The shape under the pointer or the focus: thumbnail, name and class. A class of the key: the others fade.
"use strict";
const inlined = document.getElementById("pictures");
const pictures = inlined && JSON.parse(inlined.textContent);
const map = document.querySelector(".map") || document.createElement("div");
const tip = document.querySelector(".tip");

function show(shape) {
  const inline = pictures && pictures[Number(shape.dataset.number)];
  const picture = inline ? "data:image/png;base64," + inline : shape.dataset.picture;
  const image = tip.querySelector("img");
  image.hidden = !picture;
  if (picture) image.src = picture;
  tip.querySelector("b").textContent = shape.dataset.id;
  tip.querySelector("span").textContent = shape.dataset.label;
  tip.hidden = false;
  // Beside the shape, on the side with more room.
  const at = shape.getBoundingClientRect();
  const right = at.right + 8 + tip.offsetWidth < innerWidth;
  tip.style.left = Math.max(4, right ? at.right + 8 : at.left - 8 - tip.offsetWidth) + "px";
  tip.style.top = Math.max(4, Math.min(at.top, innerHeight - tip.offsetHeight - 4)) + "px";
}

for (const shape of map.querySelectorAll("path[data-number]")) {
  // Where this script runs, the box takes the place of the title.
  shape.querySelector("title").remove();
  const link = shape.closest("a") || shape;
  link.setAttribute("aria-label", shape.dataset.id + " " + shape.dataset.label);
  for (const event of ["pointerenter", "focus"]) link.addEventListener(event, () => show(shape));
  for (const event of ["pointerleave", "blur"]) link.addEventListener(event, () => { tip.hidden = true; });
}

for (const entry of map.querySelectorAll(".key li")) {
  const group = map.querySelector(`g[data-group="${entry.dataset.group}"]`);
  const choose = (on) => { map.classList.toggle("chosen", on); group.classList.toggle("on", on); };
  entry.addEventListener("pointerenter", () => choose(true));
  entry.addEventListener("pointerleave", () => choose(false));
}

// A map that a server still computes.
if (document.getElementById("waiting")) setTimeout(() => location.reload(), 1000);
