// What is drawn while something moves on a machine without a fast graphics card.

const FEW = 6000; // triangles or points that any machine can draw
const MOST = 127; // cells along a side: three digits of that base make one key

/** Whether WebGL runs on the processor: its smoothing of edges would cost more than all the rest. */
export function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return false;
  let name = String(gl.getParameter(gl.RENDERER));
  const info = name.startsWith("WebKit") && gl.getExtension("WEBGL_debug_renderer_info");
  if (info) name = String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL));
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

/** Indices of a coarse stand-in among the same points: the first of each cell of a grid. */
export function coarse(positions, index) {
  const n = positions.length / 3;
  if ((index ? index.length / 3 : n) <= 1.5 * FEW) return null;
  if (!index) {
    const step = Math.ceil(n / FEW);
    return Uint32Array.from({ length: Math.floor(n / step) }, (_, i) => i * step);
  }
  // A surface meets about 3/2 area / cell^2 cells, and each of them makes two triangles.
  const cells = Math.min(Math.sqrt(FEW / (3 * area(positions, index))), MOST);
  const first = new Map();
  const stand = new Uint32Array(n);
  for (let i = 0; i < n; i++) {
    let key = 0;
    for (let axis = 0; axis < 3; axis++) key = key * (MOST + 1) + Math.floor((positions[3 * i + axis] + 0.5) * cells);
    if (!first.has(key)) first.set(key, i);
    stand[i] = first.get(key);
  }
  const kept = [];
  for (let t = 0; t < index.length; t += 3) {
    const [a, b, c] = [stand[index[t]], stand[index[t + 1]], stand[index[t + 2]]];
    if (a !== b && b !== c && c !== a) kept.push(a, b, c);
  }
  return Uint32Array.from(kept);
}

function area(p, index) {
  let sum = 0;
  for (let t = 0; t < index.length; t += 3) {
    const [a, b, c] = [3 * index[t], 3 * index[t + 1], 3 * index[t + 2]];
    const [ux, uy, uz] = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
    const [vx, vy, vz] = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
    sum += Math.hypot(uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx) / 2;
  }
  return sum;
}
