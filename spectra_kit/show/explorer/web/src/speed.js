// What is drawn while something moves on a machine without a fast graphics card.

const FEW = 6000; // triangles that any machine can draw
const LEAST = 0.5; // pixels of the canvas for one of the page, along a side: fewer would be seen
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

/** A coarse stand-in: which points it keeps, the first of each cell of a grid, and its triangles. */
export function coarse(positions, index) {
  const n = positions.length / 3;
  if (!index || index.length / 3 <= 1.5 * FEW) return null;
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
  const kept = Uint32Array.from(first.values());
  const rank = new Uint32Array(n);
  kept.forEach((i, j) => (rank[i] = j));
  const triangles = [];
  for (let t = 0; t < index.length; t += 3) {
    const [a, b, c] = [stand[index[t]], stand[index[t + 1]], stand[index[t + 2]]];
    if (a !== b && b !== c && c !== a) triangles.push(rank[a], rank[b], rank[c]);
  }
  return { kept, triangles: Uint32Array.from(triangles) };
}

/** Pixels for each of the page's, so that a frame takes `quick` ms: `whole` at one, `half` at 1/2. */
export function ratioFor(quick, whole, half) {
  const fill = (whole - half) / 0.75; // the rest does not depend on the pixels
  const ratio = fill > 0 ? Math.sqrt(Math.max(quick - whole + fill, 0) / fill) : 1;
  return whole <= quick ? 1 : Math.min(Math.max(ratio, LEAST), 1);
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
