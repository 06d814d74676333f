// Reads the data blocks of the page: base64, gzip, then planes of bytes of wrapped steps.
// spectra_kit/show/explorer/payload.py writes them and says why.

/** The bytes of one data block. */
export async function bytesOf(id) {
  const text = document.getElementById(id).textContent;
  const binary = atob(text);
  const packed = new Uint8Array(binary.length);
  for (let i = 0; i < packed.length; i++) packed[i] = binary.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Column number `column` of n values of 16 bits, written to `out` (an Int16Array or Uint16Array). */
export function column16(bytes, start, n, column, out) {
  const high = start + 2 * n * column;
  const low = high + n;
  let value = 0;
  for (let i = 0; i < n; i++) {
    const zigzag = (bytes[high + i] << 8) | bytes[low + i];
    value += (zigzag >>> 1) ^ -(zigzag & 1);
    out[i] = value; // wraps to 16 bits, as it was written
  }
  return out;
}

/** n values of 32 bits. */
export function column32(bytes, start, n) {
  const out = new Int32Array(n);
  let value = 0;
  for (let i = 0; i < n; i++) {
    const at = start + i;
    const zigzag =
      ((bytes[at] << 24) | (bytes[at + n] << 16) | (bytes[at + 2 * n] << 8) | bytes[at + 3 * n]) >>> 0;
    value += (zigzag >>> 1) ^ -(zigzag & 1);
    out[i] = value;
  }
  return out;
}

/** Positions (centred, longest side 1), faces, normals; of a cloud the triangles beside its points. */
export function readGeometry(bytes, facts) {
  const n = facts.shown;
  const positions = new Float32Array(3 * n);
  const steps = new Uint16Array(n);
  for (let axis = 0; axis < 3; axis++) {
    column16(bytes, 0, n, axis, steps);
    const middle = facts.box[axis] / 2;
    for (let i = 0; i < n; i++) positions[3 * i + axis] = steps[i] / 65535 - middle;
  }
  const start = 6 * n;
  if (facts.faces) {
    const index = readTriangles(bytes, start, facts.faces);
    return { positions, index, stars: null, normals: faceNormals(positions, index) };
  }
  const stars = facts.stars ? readTriangles(bytes, start + 6 * n, facts.stars) : null;
  return { positions, index: null, stars, normals: readNormals(bytes, start, n) };
}

function readTriangles(bytes, start, f) {
  const corners = [0, 1, 2].map((corner) => column32(bytes, start + 4 * f * corner, f));
  const index = new Uint32Array(3 * f);
  for (let i = 0; i < f; i++) {
    const first = corners[0][i];
    index[3 * i] = first;
    index[3 * i + 1] = first + corners[1][i];
    index[3 * i + 2] = first + corners[2][i];
  }
  return index;
}

function readNormals(bytes, start, n) {
  const normals = new Float32Array(3 * n);
  const steps = new Int16Array(n);
  for (let axis = 0; axis < 3; axis++) {
    column16(bytes, start, n, axis, steps);
    for (let i = 0; i < n; i++) normals[3 * i + axis] = steps[i] / 127;
  }
  return normals;
}

/** At each vertex the sum of the area vectors around it, as a unit vector. */
function faceNormals(p, index) {
  const normals = new Float32Array(p.length);
  for (let t = 0; t < index.length; t += 3) {
    const [a, b, c] = [3 * index[t], 3 * index[t + 1], 3 * index[t + 2]];
    const [ux, uy, uz] = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
    const [vx, vy, vz] = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
    const area = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    for (const corner of [a, b, c])
      for (let axis = 0; axis < 3; axis++) normals[corner + axis] += area[axis];
  }
  for (let i = 0; i < normals.length; i += 3) {
    const length = Math.hypot(normals[i], normals[i + 1], normals[i + 2]);
    if (length > 0) for (let axis = 0; axis < 3; axis++) normals[i + axis] /= length;
  }
  return normals;
}
