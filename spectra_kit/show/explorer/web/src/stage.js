// The views: one canvas, one camera, one geometry; each view is a rectangle of the canvas.

import { PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { isSoftware, ratioFor } from "./speed.js";
import { Surface } from "./surface.js";

const ANGLE = 28; // degrees, from the lower to the upper edge of a view
const MARGIN = 1.08;
const SWING = 0.06; // of the box: how far a mode moves the surface
const PERIOD = 2400; // milliseconds
const SLOW = 40; // milliseconds of a frame, above which moving things are drawn coarsely
const QUICK = 20; // milliseconds that a coarse frame may take
const REST = 160; // milliseconds without a change, after which everything is drawn
const PATIENCE = 600; // the same, where a frame of everything takes longer than that

export class Stage {
  constructor(canvas, facts, geometry) {
    this.canvas = canvas;
    this.facts = facts;
    this.positions = geometry.positions;
    this.views = []; // {card, pane, which, gain}
    this.wave = false;
    this.playing = false;
    this.phase = 0;
    this.nodal = Boolean(geometry.index ?? geometry.stars);
    this.software = isSoftware();
    this.slow = undefined; // not known yet
    this.cost = undefined; // milliseconds of a sharp frame
    this.fine = true;
    this.ratio = 1; // of a picture that moves, where drawing is slow
    this.renderer = new WebGLRenderer({ canvas, antialias: !this.software, alpha: true });
    this.renderer.setClearColor(0, 0);
    this.renderer.setScissorTest(true);
    this.renderer.autoClear = false; // once for all views
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(ANGLE, 1, 0.01, 100);
    this.surface = new Surface(facts, geometry);
    this.scene.add(this.surface);
    this.radius = 0;
    for (let i = 0; i < this.positions.length; i += 3)
      this.radius = Math.max(this.radius, Math.hypot(...this.positions.subarray(i, i + 3)));
    this.radius ||= 1;
    this.steer();
    this.centre();
    this.fitted = 0;
  }

  steer() {
    this.camera.up.fromArray(this.facts.vertical);
    this.camera.position.fromArray(this.facts.towards).multiplyScalar(4);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.canvas.style.touchAction = ""; // the style sheet knows whether the page scrolls
    this.controls.enableDamping = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.controls.dampingFactor = 0.12;
    this.controls.addEventListener("change", () => this.invalidate());
    this.controls.update();
    this.canvas.addEventListener("dblclick", () => this.reset());
  }

  /** Stand in this direction, at the first distance. */
  look(towards) {
    const glide = this.controls.enableDamping;
    this.controls.enableDamping = false; // what is left of a drag must not turn the new view
    this.controls.update();
    this.camera.position.fromArray(towards).normalize().multiplyScalar(this.fitted || 4).add(this.middle);
    this.controls.target.copy(this.middle);
    this.controls.update();
    this.controls.enableDamping = glide;
    this.invalidate();
  }

  /** Back to the first view. */
  reset() {
    this.look(this.facts.towards);
  }

  /** The axes of the first view, and the middle of what it shows. */
  centre() {
    const towards = new Vector3().fromArray(this.facts.towards).normalize();
    const right = new Vector3().fromArray(this.facts.vertical).cross(towards).normalize();
    this.axes = [right, towards.clone().cross(right), towards];
    const point = new Vector3();
    this.middle = new Vector3();
    for (const axis of this.axes.slice(0, 2)) {
      let [low, high] = [Infinity, -Infinity];
      for (let i = 0; i < this.positions.length; i += 3) {
        const along = point.fromArray(this.positions, i).dot(axis);
        low = Math.min(low, along);
        high = Math.max(high, along);
      }
      this.middle.addScaledVector(axis, (low + high) / 2);
    }
    this.controls.target.copy(this.middle);
    this.camera.position.add(this.middle);
  }

  /** Distance from which everything is seen in a pane of this aspect, from the first direction. */
  fit(aspect) {
    const [right, above, towards] = this.axes;
    const vertical = Math.tan((ANGLE * Math.PI) / 360);
    const ball = this.facts.diameter / 2; // also the balls of a cloud
    const point = new Vector3();
    let distance = 0;
    for (let i = 0; i < this.positions.length; i += 3) {
      point.fromArray(this.positions, i).sub(this.middle);
      const out = Math.max(
        (Math.abs(point.dot(right)) + ball) / (vertical * aspect),
        (Math.abs(point.dot(above)) + ball) / vertical,
      );
      distance = Math.max(distance, MARGIN * out + point.dot(towards));
    }
    return distance || 4;
  }

  /** Sizes have changed. */
  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height || !this.views.length) return;
    const pane = this.views[0].pane.getBoundingClientRect();
    const sizes = [width, height, pane.width, pane.height, this.views.length, devicePixelRatio].join();
    if (sizes === this.sizes) return;
    this.sizes = sizes;
    this.sharpness();
    this.camera.aspect = pane.width / pane.height;
    this.camera.updateProjectionMatrix();
    const fitted = this.fit(this.camera.aspect);
    const away = this.camera.position.clone().sub(this.controls.target);
    away.multiplyScalar(this.fitted ? fitted / this.fitted : fitted / away.length());
    this.camera.position.copy(this.controls.target).add(away);
    this.fitted = fitted;
    this.controls.minDistance = 0.15 * fitted;
    this.controls.maxDistance = 6 * fitted;
    // The controls measure a drag by the canvas; a hand measures it by the view.
    this.controls.rotateSpeed = this.controls.panSpeed = height / pane.height;
    this.controls.update();
    this.measure();
    this.frame();
    if (this.playing) return;
    cancelAnimationFrame(this.asked); // it is drawn
    this.asked = undefined;
  }

  /** Pixels of the canvas for those of the page. */
  sharpness() {
    const most = Math.max(Math.min(devicePixelRatio, 2), this.software ? 2 : 1);
    this.renderer.setPixelRatio(this.fine ? most : this.ratio);
    this.renderer.setSize(this.canvas.clientWidth, this.canvas.clientHeight, false);
  }

  /** How long a frame takes here, once: then how coarsely to draw what moves. */
  measure() {
    if (this.slow !== undefined) return;
    const coarsely = (ratio) => {
      this.ratio = ratio;
      this.detail(false);
      this.sharpness();
      this.timed(); // the first frame makes its program and its buffers: better now than at a step
      return this.timed();
    };
    const [whole, half] = [coarsely(1), coarsely(0.5)];
    this.ratio = this.software ? ratioFor(QUICK, whole, half) : 1; // a graphics card need not save
    this.slow = this.software; // until a sharp frame tells, after the first moment of rest
    if (!this.slow) this.sharp();
  }

  /** Milliseconds that a frame takes. */
  timed() {
    const gl = this.renderer.getContext();
    const start = performance.now();
    this.paint();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits for the drawing
    return performance.now() - start;
  }

  /** Draw everything; the first time, find out whether that is slow here. */
  sharp() {
    this.detail(true);
    if (this.cost !== undefined) return this.paint();
    this.cost = this.timed();
    if (this.cost > SLOW && this.cost < 5 * SLOW) this.cost = this.timed(); // without what is made once
    this.slow = this.cost > SLOW;
  }

  /** Everything and sharp, or few triangles and fewer pixels. */
  detail(fine) {
    if (fine === this.fine) return;
    this.fine = fine;
    this.surface.show(fine);
    this.sharpness();
  }

  /** Draw at the next frame. */
  invalidate() {
    clearTimeout(this.resting);
    this.asked ??= requestAnimationFrame((time) => {
      this.asked = undefined;
      this.draw(time);
    });
  }

  draw(time) {
    if (this.wave && this.playing) {
      this.phase += ((time - (this.last ?? time)) / PERIOD) * 2 * Math.PI;
      this.invalidate();
    }
    this.last = this.wave && this.playing ? time : undefined;
    this.controls.update(); // asks for another frame while the camera glides
    this.frame();
  }

  /** Where drawing is slow, coarsely now, and everything after a rest. */
  frame() {
    clearTimeout(this.resting);
    if (this.slow) {
      this.detail(false);
      const rest = Math.min(Math.max(REST, this.cost ?? 0), PATIENCE); // what would hold up more waits longer
      this.resting = setTimeout(() => this.sharp(), rest);
    }
    this.paint();
  }

  paint() {
    const { uniforms } = this.surface;
    const ratio = this.renderer.getPixelRatio();
    const box = this.canvas.getBoundingClientRect();
    const distance = this.camera.position.length(); // from the middle of the box
    this.camera.near = Math.max(distance - 1.6 * this.radius, 0.002 * distance);
    this.camera.far = distance + 1.6 * this.radius;
    uniforms.depths.value.set(distance - this.radius, distance + this.radius);
    uniforms.swing.value = this.wave ? Math.cos(this.phase) : 1;
    this.renderer.setScissor(0, 0, box.width, box.height);
    this.renderer.clear();
    for (const { card, pane, which, gain } of this.views) {
      // The camera is aimed at the pane; what reaches beyond it is drawn on the rest of the card.
      const inner = pane.getBoundingClientRect();
      const { left, top, bottom, width, height } = card.getBoundingClientRect();
      if (!inner.width) continue;
      this.camera.setViewOffset(inner.width, inner.height, left - inner.left, top - inner.top, width, height);
      this.renderer.setViewport(left - box.left, box.bottom - bottom, width, height);
      this.renderer.setScissor(left - box.left, box.bottom - bottom, width, height);
      uniforms.which.value = which;
      uniforms.gain.value = gain;
      uniforms.amplitude.value = this.wave && which < 2 ? SWING : 0;
      uniforms.lines.value = this.nodal && which < 2 ? 0.8 * ratio : 0;
      uniforms.size.value.set(width * ratio, height * ratio);
      uniforms.pixels.value = (inner.height * ratio) / (2 * Math.tan((ANGLE * Math.PI) / 360));
      this.surface.prepare(which, this.nodal);
      this.renderer.render(this.scene, this.camera);
    }
  }
}
