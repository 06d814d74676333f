// Nodal lines of a cloud: the zeros of a function that is linear on triangles between neighbours.
// spectra_kit/show/contours.py draws the same ones.

import { InstancedBufferGeometry, InstancedInterleavedBuffer, InterleavedBufferAttribute, Mesh, ShaderMaterial } from "three";
import { BufferAttribute, DoubleSide } from "three";
import { LINE_FRAGMENT, LINE_VERTEX } from "./shaders.js";

const STRIDE = 7; // start, stop, strength
const FLAT = [0.02, 0.1]; // of the limit of the colours in a side of the box: there a line fades out

/** Writes segments to `out`; returns how many. `gain` turns values to shares of the colour limit. */
export function zeros(positions, triangles, values, gain, out) {
  // A point where the function vanishes counts as above if one beside it is.
  const beside = new Uint8Array(values.length);
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = [triangles[t], triangles[t + 1], triangles[t + 2]];
    if (values[a] > 0 || values[b] > 0 || values[c] > 0) beside[a] = beside[b] = beside[c] = 1;
  }
  const upper = (i) => (values[i] > 0 || (values[i] === 0 && beside[i]) ? 1 : 0);
  let at = 0;
  for (let t = 0; t < triangles.length; t += 3) {
    let [a, b, c] = [triangles[t], triangles[t + 1], triangles[t + 2]];
    const sides = upper(a) + upper(b) + upper(c);
    if (sides % 3 === 0 || !(values[a] < 0 || values[b] < 0 || values[c] < 0)) continue;
    const lone = sides === 1 ? 1 : 0; // the side on which there is a single corner
    while (upper(a) !== lone) [a, b, c] = [b, c, a];
    const strength = smooth(slope(positions, values, a, b, c) * gain);
    if (strength === 0) continue;
    between(positions, values, a, b, lone, out, at);
    between(positions, values, a, c, lone, out, at + 3);
    out[at + 6] = strength;
    at += STRIDE;
  }
  return at / STRIDE;
}

function between(p, values, a, b, isUpper, out, at) {
  const part = values[a] === values[b] ? 1 - isUpper : values[a] / (values[a] - values[b]);
  for (let axis = 0; axis < 3; axis++)
    out[at + axis] = p[3 * a + axis] + part * (p[3 * b + axis] - p[3 * a + axis]);
}

/** Length of the gradient on a triangle. */
function slope(p, values, a, b, c) {
  const [f, g] = [values[b] - values[a], values[c] - values[a]];
  const u = [0, 1, 2].map((axis) => p[3 * b + axis] - p[3 * a + axis]);
  const v = [0, 1, 2].map((axis) => p[3 * c + axis] - p[3 * a + axis]);
  const area = Math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]);
  return Math.hypot(f * v[0] - g * u[0], f * v[1] - g * u[1], f * v[2] - g * u[2]) / (area || 1e-12);
}

function smooth(steep) {
  const x = Math.min(Math.max((steep - FLAT[0]) / (FLAT[1] - FLAT[0]), 0), 1);
  return x * x * (3 - 2 * x);
}

/** The lines of one function, to be put into the scene. */
export class Zeros {
  constructor({ positions, stars }, uniforms) {
    this.find = (values, gain) => zeros(positions, stars, values, gain, this.buffer.array);
    this.buffer = new InstancedInterleavedBuffer(new Float32Array((STRIDE * stars.length) / 3), STRIDE);
    const geometry = new InstancedBufferGeometry();
    geometry.setIndex([0, 1, 2, 2, 1, 3]);
    geometry.setAttribute("corner", new BufferAttribute(new Float32Array([0, -1, 0, 1, 1, -1, 1, 1]), 2));
    ["start", "stop", "strength"].forEach((name, i) =>
      geometry.setAttribute(name, new InterleavedBufferAttribute(this.buffer, i < 2 ? 3 : 1, 3 * i)),
    );
    const programs = { vertexShader: LINE_VERTEX, fragmentShader: LINE_FRAGMENT };
    this.thing = new Mesh(geometry, new ShaderMaterial({ ...programs, uniforms, side: DoubleSide }));
    this.thing.frustumCulled = false;
  }

  update(values, gain) {
    const count = this.find(values, gain);
    this.thing.geometry.instanceCount = count;
    this.buffer.clearUpdateRanges();
    this.buffer.addUpdateRange(0, STRIDE * count);
    this.buffer.needsUpdate = true;
  }
}
