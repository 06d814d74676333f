// What is drawn: everything, few triangles in its place, and the nodal lines of a cloud.

import {
  BufferAttribute,
  BufferGeometry,
  DataTexture,
  DataUtils,
  DoubleSide,
  Group,
  HalfFloatType,
  LinearFilter,
  Mesh,
  NearestFilter,
  Points,
  RGBAFormat,
  ShaderMaterial,
  Vector2,
} from "three";
import { FRAGMENT, ROUGH_FRAGMENT, ROUGH_VERTEX, VERTEX } from "./shaders.js";
import { coarse } from "./speed.js";
import { Zeros } from "./zeros.js";

export class Surface extends Group {
  constructor(facts, geometry) {
    super();
    const { positions, normals, index, stars } = geometry;
    const n = positions.length / 3;
    this.values = [new Int16Array(n), new Int16Array(n)]; // exact, predicted
    this.uniforms = {
      which: { value: 0 },
      gain: { value: 1 },
      swing: { value: 1 },
      amplitude: { value: 0 },
      pixels: { value: 0 },
      size: { value: new Vector2() },
      diameter: { value: facts.diameter },
      ...palettes(facts),
      lines: { value: 0 },
      depths: { value: new Vector2(0, 1) },
    };
    const whole = buffers(positions, normals, this.values, index);
    const kind = index ? Mesh : Points;
    this.fine = new kind(whole, this.material(VERTEX, FRAGMENT, index ? {} : { CLOUD: 1, BALLS: 1 }));
    if (stars) this.fine.add(this.between(whole, stars));
    const few = coarse(positions, index ?? stars);
    // A cloud of few points stays what it is; one of many has triangles in its place.
    this.rough = this.fine;
    if (few || index) {
      this.kept = few?.kept;
      this.thinned = few && this.values.map(() => new Int16Array(few.kept.length));
      const pick = (values) => picked(values, few.kept);
      const small = few ? buffers(pick(positions), pick(normals), this.thinned, few.triangles) : whole;
      this.rough = new Mesh(small, this.material(ROUGH_VERTEX, ROUGH_FRAGMENT, index ? {} : { CLOUD: 1 }));
    }
    this.add(this.fine);
    if (this.rough !== this.fine) this.add(this.rough);
    this.zeros = stars ? this.values.map(() => new Zeros(geometry, this.uniforms)) : [];
    for (const { thing } of this.zeros) this.add(thing);
    this.traverse((thing) => (thing.frustumCulled = false));
    this.show(true);
  }

  /** Triangles behind the points of a cloud: through no gap is its far side seen. */
  between(whole, stars) {
    const geometry = new BufferGeometry();
    for (const name in whole.attributes) geometry.setAttribute(name, whole.attributes[name]);
    geometry.setIndex(new BufferAttribute(stars, 1));
    const material = this.material(VERTEX, FRAGMENT, { CLOUD: 1 });
    return new Mesh(geometry, Object.assign(material, { polygonOffset: true, polygonOffsetUnits: 1 }));
  }

  material(vertexShader, fragmentShader, defines) {
    return new ShaderMaterial({ vertexShader, fragmentShader, defines, side: DoubleSide, uniforms: this.uniforms });
  }

  /** Everything, or few triangles. */
  show(isFine) {
    this.now = isFine ? this.fine : this.rough;
    this.fine.visible = this.now === this.fine;
    this.rough.visible = this.now === this.rough;
  }

  /** `values` are those of another mode: `gain` turns them to shares of the colour limit. */
  change(gain) {
    this.gain = gain;
    for (const name of ["exact", "predicted"]) {
      this.fine.geometry.getAttribute(name).needsUpdate = true; // sent when it is drawn next
      this.rough.geometry.getAttribute(name).needsUpdate = true;
    }
    this.stale = true;
    this.lost = [true, true];
  }

  /** Before a view is drawn. */
  prepare(which, isNodal) {
    if (this.stale && this.thinned && this.now === this.rough) {
      this.thinned.forEach((out, i) => this.kept.forEach((from, to) => (out[to] = this.values[i][from])));
      this.stale = false;
    }
    this.zeros.forEach((zeros, i) => {
      zeros.thing.visible = isNodal && which === i && this.now === this.fine;
      if (!zeros.thing.visible || !this.lost[i]) return;
      zeros.update(this.values[i], this.gain / 32767);
      this.lost[i] = false;
    });
    this.traverse(({ material }) => material && (material.uniformsNeedUpdate = true));
  }
}

function buffers(positions, normals, [exact, predicted], index) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setAttribute("normal", new BufferAttribute(normals, 3));
  geometry.setAttribute("exact", new BufferAttribute(exact, 1, true));
  geometry.setAttribute("predicted", new BufferAttribute(predicted, 1, true));
  if (index) geometry.setIndex(new BufferAttribute(index, 1));
  return geometry;
}

/** Rows of three of these points. */
function picked(rows, kept) {
  const out = new Float32Array(3 * kept.length);
  kept.forEach((from, to) => out.set(rows.subarray(3 * from, 3 * from + 3), 3 * to));
  return out;
}

/** The colours in linear light, with means between them, and as they are. */
function palettes(facts) {
  const colours = Uint8Array.from(atob(facts.palette), (c) => c.charCodeAt(0));
  const table = new Uint16Array(1024);
  const bytes = new Uint8Array(1024);
  colours.forEach((byte, i) => {
    const at = 4 * Math.floor(i / 3) + (i % 3);
    bytes[at] = byte;
    table[at] = DataUtils.toHalfFloat(linear(byte / 255));
  });
  const palette = new DataTexture(table, 256, 1, RGBAFormat, HalfFloatType);
  palette.minFilter = palette.magFilter = LinearFilter;
  const swatches = new DataTexture(bytes, 256, 1, RGBAFormat);
  swatches.minFilter = swatches.magFilter = NearestFilter;
  palette.needsUpdate = swatches.needsUpdate = true;
  return { palette: { value: palette }, swatches: { value: swatches } };
}

/** From sRGB to light. */
function linear(c) {
  return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
}
