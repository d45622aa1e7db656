"use strict";
// Shapes in 3-D in the place of their pictures, which remain where there is no surface or no WebGL. Several turn
// together: one camera for all canvases.
const camera = {right: 0, up: 0, zoom: 1}, views = [];
const drawn = () => views.forEach((view) => view.draw());

async function load(canvas) {
  const answer = await fetch(canvas.dataset.scene);
  const view = answer.ok && new View(canvas, await answer.json(), camera);
  if (!view || !view.gl) return;
  canvas.parentNode.classList.add("seen");
  views.push(view);
  steer(canvas, camera, drawn);
  view.draw();
  canvas.dataset.drawn = "yes";
}

addEventListener("resize", drawn);
document.querySelectorAll("canvas[data-scene]").forEach(load);
