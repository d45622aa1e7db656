"use strict";
// The viewer of one scan: layers that can be switched on and off. The address may preset it:
// #points,dropped@40,15 shows these layers from 40 degrees to the right and 15 above.
const canvas = document.getElementById("canvas"), boxes = document.getElementById("layers").elements;
const camera = {right: 0, up: 0, zoom: 1};
const scene = JSON.parse(document.getElementById("scene").textContent);
const view = new View(canvas, scene, camera, (layer) => boxes[layer.name].checked);

function preset() {
  const [names, angles] = decodeURIComponent(location.hash.slice(1)).split("@");
  const on = names ? names.split(",") : scene.on;
  for (const layer of scene.layers) boxes[layer.name].checked = on.includes(layer.name);
  const [right, up] = (angles || "").split(",").map(Number);
  Object.assign(camera, {right: right || 0, up: up || 0, zoom: 1});
  view.draw();
}

if (view.gl) {
  steer(canvas, camera, () => view.draw());
  document.getElementById("layers").addEventListener("change", () => view.draw());
  addEventListener("hashchange", preset);
  addEventListener("resize", () => view.draw());
  preset();
} else {
  document.getElementById("hint").textContent = "This browser has no WebGL: the pictures above show the same.";
  canvas.hidden = true;
}
