"use strict";
// Two shapes that turn together: one camera for both canvases.
const camera = {right: 0, up: 0, zoom: 1}, views = [];
const drawn = () => views.forEach((view) => view.draw());

async function load(canvas) {
  const answer = await fetch(canvas.dataset.scene);
  const view = answer.ok && new View(canvas, await answer.json(), camera);
  if (!view || !view.gl) {
    const words = document.createElement("p");
    words.textContent = view ? "This browser has no WebGL." : (await answer.json()).message;
    canvas.replaceWith(words);
    return;
  }
  views.push(view);
  steer(canvas, camera, drawn);
  view.draw();
  canvas.dataset.drawn = "yes";
}

addEventListener("resize", drawn);
document.querySelectorAll("canvas[data-scene]").forEach(load);
