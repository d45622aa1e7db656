"use strict";
// Layers of points and faces, drawn by WebGL as seen from far away; and how pointers, wheel and keys turn them.
const VERTEX = `
attribute vec3 at; attribute vec3 normal; attribute vec3 tint;
uniform mat3 turn; uniform vec2 scale; uniform float width; uniform float lit; uniform float over;
uniform vec3 colour; uniform vec3 back; uniform float tinted;
varying vec3 shown;
void main() {
  vec3 seen = turn * (2.0 * at - 1.0);
  gl_Position = vec4(seen.xy * scale, over > 0.5 ? -0.99 : -0.5 * seen.z, 1.0);
  gl_PointSize = width;
  float facing = lit > 0.5 ? dot(turn * normal, vec3(0, 0, 1)) : 1.0;
  shown = (facing < 0.0 ? back : tinted > 0.5 ? tint : colour) * (0.35 + 0.65 * abs(facing));
  if (lit < 0.5 && over < 0.5) shown *= 0.7 + 0.3 * seen.z;
}`;
const FRAGMENT = `
precision mediump float;
varying vec3 shown;
uniform float round;
void main() {
  if (round > 0.5 && length(gl_PointCoord - 0.5) > 0.5) discard;
  gl_FragColor = vec4(shown, 1.0);
}`;

function decode(text, Kind) {
  const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  return new Kind(bytes.buffer);
}

// Each face with corners of its own, so that it is flat; its normal at each of them.
function faceted(at, corners) {
  const places = new Uint16Array(3 * corners.length), normals = new Int8Array(3 * corners.length);
  for (let face = 0; face < corners.length; face += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => at.subarray(3 * corners[face + k], 3 * corners[face + k] + 3));
    const u = [0, 1, 2].map((k) => b[k] - a[k]), v = [0, 1, 2].map((k) => c[k] - a[k]);
    const n = [0, 1, 2].map((k) => u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]);
    const length = Math.hypot(...n) || 1;
    [a, b, c].forEach((corner, k) => {
      places.set(corner, 3 * (face + k));
      normals.set(n.map((part) => Math.round(127 * part / length)), 3 * (face + k));
    });
  }
  return [places, normals];
}

function shader(gl, program, type, source) {
  const part = gl.createShader(type);
  gl.shaderSource(part, source);
  gl.compileShader(part);
  if (!gl.getShaderParameter(part, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(part));
  gl.attachShader(program, part);
}

// A canvas with the layers of a scene. Several canvases may share a camera: {right, up} in degrees, and zoom.
class View {
  constructor(canvas, scene, camera, isOn = () => true) {
    Object.assign(this, {canvas, scene, camera, isOn});
    this.gl = canvas.getContext("webgl", {antialias: true});
    if (!this.gl) return;
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => { this.prepare(); this.draw(); });
    this.prepare();
  }

  buffer(values) {
    const made = this.gl.createBuffer();
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, made);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, values, this.gl.STATIC_DRAW);
    return made;
  }

  // Rows right, up and towards the viewer, turned by two angles; as WebGL wants it, column by column.
  turned() {
    const [a, e] = [this.camera.right, this.camera.up].map((degrees) => degrees * Math.PI / 180);
    const [x, y, z] = this.scene.axes;
    const mix = (p, u, q, v) => u.map((part, k) => p * part + q * v[k]);
    const right = mix(Math.cos(a), x, -Math.sin(a), z), ahead = mix(Math.sin(a), x, Math.cos(a), z);
    const up = mix(Math.cos(e), y, -Math.sin(e), ahead), towards = mix(Math.sin(e), y, Math.cos(e), ahead);
    return [0, 1, 2].flatMap((k) => [right[k], up[k], towards[k]]);
  }

  prepare() {
    const gl = this.gl;
    this.program = gl.createProgram();
    shader(gl, this.program, gl.VERTEX_SHADER, VERTEX);
    shader(gl, this.program, gl.FRAGMENT_SHADER, FRAGMENT);
    gl.bindAttribLocation(this.program, 0, "at");
    gl.linkProgram(this.program);
    gl.useProgram(this.program);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    for (const layer of this.scene.layers) {
      let at = decode(layer.at, Uint16Array), normals = layer.normal && decode(layer.normal, Int8Array);
      if (layer.faces !== undefined) [at, normals] = faceted(at, decode(layer.faces, Uint32Array));
      layer.count = at.length / 3;
      layer.places = this.buffer(at);
      layer.normals = normals && this.buffer(normals);
      // The colour of a face, at each of its corners.
      const tints = layer.tints && decode(layer.tints, Uint8Array);
      layer.colours = tints && this.buffer(tints.constructor.from({length: 3 * tints.length}, (_, k) => tints[3 * Math.floor(k / 9) + k % 3]));
    }
  }

  draw() {
    const {gl, canvas, camera, scene} = this, place = (name) => gl.getUniformLocation(this.program, name);
    const [w, h] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.round(side * devicePixelRatio));
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    gl.viewport(0, 0, w, h);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const side = Math.min(w, h), scale = scene.zoom * camera.zoom;
    gl.uniformMatrix3fv(place("turn"), false, this.turned());
    gl.uniform2f(place("scale"), scale * side / w, scale * side / h);
    for (const layer of scene.layers) {
      if (!this.isOn(layer) || !layer.count) continue;
      const points = layer.faces === undefined;
      gl.bindBuffer(gl.ARRAY_BUFFER, layer.places);
      gl.enableVertexAttribArray(0);
      gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, true, 0, 0);
      for (const [name, buffer, kind] of [["normal", layer.normals, gl.BYTE], ["tint", layer.colours, gl.UNSIGNED_BYTE]]) {
        const part = gl.getAttribLocation(this.program, name);
        gl.disableVertexAttribArray(part);
        if (!buffer) continue;
        gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
        gl.enableVertexAttribArray(part);
        gl.vertexAttribPointer(part, 3, kind, true, 0, 0);
      }
      gl.uniform1f(place("tinted"), layer.colours ? 1 : 0);
      gl.uniform1f(place("lit"), layer.normals ? 1 : 0);
      gl.uniform1f(place("over"), layer.over ? 1 : 0);
      gl.uniform1f(place("round"), points ? 1 : 0);
      gl.uniform1f(place("width"), Math.max(layer.width * scale * side / 2, 1.5));
      gl.uniform3fv(place("colour"), layer.colour);
      gl.uniform3fv(place("back"), layer.back || layer.colour.map((part) => 0.5 * part));
      gl.drawArrays(points ? gl.POINTS : gl.TRIANGLES, 0, layer.count);
    }
  }
}

// Turn and zoom the camera by what is done on a canvas, and tell of each change.
function steer(canvas, camera, changed) {
  const start = {right: 0, up: 0, zoom: 1};
  const turn = (across, down) => {
    camera.right += across;
    camera.up = Math.max(-105, Math.min(75, camera.up + down));
    changed();
  };
  const zoom = (by) => {
    camera.zoom = Math.max(0.3, Math.min(40, camera.zoom * by));
    changed();
  };
  const fingers = new Map();
  const apart = () => {
    const [a, b] = [...fingers.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, {x: event.clientX, y: event.clientY});
  });
  canvas.addEventListener("pointermove", (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) return;
    const before = fingers.size === 2 ? apart() : 0;
    const [across, down] = [event.clientX - finger.x, event.clientY - finger.y];
    [finger.x, finger.y] = [event.clientX, event.clientY];
    if (fingers.size === 2) zoom(apart() / before);
    else turn(-0.4 * across, 0.4 * down);
  });
  for (const end of ["pointerup", "pointercancel"])
    canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-0.001 * event.deltaY));
  }, {passive: false});
  canvas.addEventListener("dblclick", () => { Object.assign(camera, start); changed(); });
  canvas.addEventListener("keydown", (event) => {
    const step = {ArrowLeft: [10, 0], ArrowRight: [-10, 0], ArrowUp: [0, 10], ArrowDown: [0, -10]}[event.key];
    if (step) { event.preventDefault(); turn(...step); }
    if (event.key === "+" || event.key === "-") zoom(event.key === "+" ? 1.2 : 1 / 1.2);
  });
}
