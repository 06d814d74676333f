// Eigenvalues against their number, and below them how far the two spectra are apart.

import { change, count, short, tick as axis } from "./format.js";

const NS = "http://www.w3.org/2000/svg";
const LEFT = 52;
const RIGHT = 14;
const TOP = 12;
const BOTTOM = 30;
const GAP = 28;

export class Plot {
  /** `choose` is called with the mode that was clicked. */
  constructor(host, facts, choose) {
    this.host = host;
    this.facts = facts;
    this.k = facts.exact.eigenvalues.length;
    const { exact, predicted } = facts;
    const all = [...exact.eigenvalues, ...(predicted?.eigenvalues ?? [])];
    if (this.k > 1) all.push(weyl(facts, this.k - 1));
    const top = 1.04 * Math.max(...all);
    this.top = top > 1e-9 * weyl(facts, 1) ? top : 0; // zero alone has no scale
    this.svg = element("svg", { role: "img", "aria-label": "Eigenvalues against the number of the mode" });
    // Apart and moved as they are, so that a step of the slider paints nothing of the plot again.
    this.marks = Object.fromEntries(
      ["cursor", "predicted", "exact", "change"].map((kind) => {
        const mark = document.createElement("i");
        mark.className = `mark ${kind}`;
        return [kind, mark];
      }),
    );
    this.tip = document.createElement("div");
    this.tip.className = "tip";
    this.tip.hidden = true;
    host.append(this.svg, ...Object.values(this.marks), this.tip);
    this.mode = 0;
    new ResizeObserver(() => this.layout()).observe(host);
    let held = false;
    this.svg.addEventListener("pointerdown", (event) => {
      held = true;
      this.svg.setPointerCapture(event.pointerId);
      choose(this.at(event));
    });
    this.svg.addEventListener("pointermove", (event) => {
      const mode = this.at(event);
      if (held) choose(mode);
      this.hint(mode);
    });
    for (const name of ["pointerup", "pointercancel"]) this.svg.addEventListener(name, () => (held = false));
    this.svg.addEventListener("pointerleave", () => this.hint(null));
    this.layout();
  }

  at(event) {
    const x = event.clientX - this.svg.getBoundingClientRect().left;
    const mode = Math.round(((x - LEFT) / this.width) * (this.k - 1));
    return Math.min(Math.max(mode, 0), this.k - 1);
  }

  x(mode) {
    return LEFT + (this.k > 1 ? mode / (this.k - 1) : 0.5) * this.width;
  }

  layout() {
    const { clientWidth, clientHeight } = this.host;
    if (clientWidth < 80 || clientHeight < 80) return;
    this.width = clientWidth - LEFT - RIGHT;
    this.bottom = clientHeight - BOTTOM;
    const room = this.bottom - TOP;
    const compared = Boolean(this.facts.comparison);
    this.split = compared ? TOP + (room - GAP) * 0.66 : this.bottom;
    this.svg.replaceChildren();
    this.svg.setAttribute("viewBox", `0 0 ${clientWidth} ${clientHeight}`);
    this.marks.cursor.style.height = `${this.bottom - TOP + 4}px`;
    this.values();
    if (compared) this.errors();
    this.numbers();
    this.show(this.mode);
  }

  add(name, attributes, parent = this.svg) {
    const made = element(name, attributes);
    parent.append(made);
    return made;
  }

  text(content, x, y, attributes = {}) {
    this.add("text", { x, y, ...attributes }).textContent = content;
  }

  /** The numbers of the modes below. */
  numbers() {
    const most = Math.max(Math.floor(this.width / 56), 1);
    for (const tick of ticks(0, this.k - 1, most).filter((t) => Number.isInteger(t)))
      this.text(count(tick), this.x(tick), this.bottom + 15, { class: "tick", "text-anchor": "middle" });
    this.text("mode", LEFT + this.width, this.bottom + 28, { class: "name", "text-anchor": "end" });
  }

  values() {
    const { exact, predicted } = this.facts;
    const { top } = this;
    this.y = (value) => this.split - ((this.split - TOP) * Math.min(Math.max(value, 0), top)) / (top || 1);
    for (const tick of ticks(0, top, Math.max((this.split - TOP) / 34, 2))) {
      this.add("line", { class: "grid", x1: LEFT, x2: LEFT + this.width, y1: this.y(tick), y2: this.y(tick) });
      this.text(axis(tick), LEFT - 8, this.y(tick) + 4, { class: "tick", "text-anchor": "end" });
    }
    const law = Array.from({ length: 101 }, (_, i) => ((this.k - 1) * i) / 100);
    const line = law.map((j) => `${this.x(j).toFixed(1)} ${this.y(weyl(this.facts, j)).toFixed(1)}`);
    if (this.k > 1) this.add("path", { class: "weyl", d: `M${line.join("L")}` });
    for (const [which, spectrum] of [["predicted", predicted], ["exact", exact]]) {
      if (!spectrum) continue;
      const bars = this.add("path", { class: `bars ${which}` });
      if (spectrum.residuals)
        bars.setAttribute(
          "d",
          spectrum.eigenvalues
            .map((value, mode) => {
              const [low, high] = [this.y(value - spectrum.residuals[mode]), this.y(value + spectrum.residuals[mode])];
              return low - high > 1 ? `M${this.x(mode).toFixed(1)} ${low.toFixed(1)}V${high.toFixed(1)}` : "";
            })
            .join(""),
        );
      const dots = this.add("g", { class: `dots ${which}` });
      const radius = Math.min(Math.max(this.width / this.k / 3.2, 1.4), 3.4) * (which === "exact" ? 0.8 : 1.25);
      spectrum.eigenvalues.forEach((value, mode) =>
        this.add("circle", { cx: this.x(mode).toFixed(1), cy: this.y(value).toFixed(1), r: radius.toFixed(1) }, dots),
      );
    }
  }

  /** Relative differences of the eigenvalues, in powers of ten. */
  errors() {
    const { eigenvalue_error: signed } = this.facts.comparison;
    const sizes = signed.map((e) => (e ? Math.log10(Math.abs(e)) : null));
    const known = sizes.filter((size) => size !== null);
    if (!known.length) known.push(0);
    const low = Math.floor(Math.min(...known));
    const high = Math.max(Math.ceil(Math.max(...known)), low + 1);
    const [above, below] = [this.split + GAP, this.bottom];
    const y = (power) => below - ((power - low) / (high - low)) * (below - above);
    this.change = (mode) => (sizes[mode] === null ? null : y(sizes[mode]));
    const every = Math.ceil((high - low) / Math.max(Math.floor((below - above) / 18), 1));
    for (let power = low; power <= high; power += every) {
      this.add("line", { class: "grid", x1: LEFT, x2: LEFT + this.width, y1: y(power), y2: y(power) });
      const label = this.add("text", { class: "tick", x: LEFT - 8, y: y(power) + 4, "text-anchor": "end" });
      label.textContent = power === 0 ? "1" : "10";
      if (power !== 0) {
        const raised = this.add("tspan", { dy: -4, class: "power" }, label);
        raised.textContent = String(power).replace("-", "−");
      }
    }
    let path = "";
    sizes.forEach((size, mode) => {
      if (size !== null) path += `M${this.x(mode).toFixed(1)} ${below}V${y(size).toFixed(1)}`;
    });
    this.add("path", { class: "stems", d: path });
    const dots = this.add("g", { class: "dots change" });
    sizes.forEach((size, mode) => {
      if (size !== null) this.add("circle", { cx: this.x(mode).toFixed(1), cy: y(size).toFixed(1), r: 1.6 }, dots);
    });
    this.text("relative difference", LEFT + 6, above - 9, { class: "name" });
  }

  /** Mark the mode that is shown. */
  show(mode) {
    this.mode = mode;
    if (!this.width) return;
    const { exact, predicted } = this.facts;
    const heights = {
      cursor: TOP - 4,
      predicted: predicted && this.y(predicted.eigenvalues[mode]),
      exact: this.y(exact.eigenvalues[mode]),
      change: this.change?.(mode),
    };
    for (const [kind, mark] of Object.entries(this.marks)) {
      mark.hidden = (heights[kind] ?? null) === null;
      mark.style.transform = `translate(${this.x(mode)}px, ${heights[kind] ?? 0}px)`;
    }
  }

  hint(mode) {
    this.tip.hidden = mode === null;
    if (mode === null) return;
    const { names, exact, predicted, comparison } = this.facts;
    const lines = [[`mode ${mode}`, ""], [names[0], short(exact.eigenvalues[mode], 5)]];
    if (predicted) {
      lines.push([names[1], short(predicted.eigenvalues[mode], 5)]);
      if (comparison.eigenvalue_error[mode] !== null) lines.push(["", change(this.facts, mode)]);
    }
    if (exact.residuals) lines.push(["certified to", `± ${short(exact.residuals[mode], 2)}`]);
    this.tip.replaceChildren(
      ...lines.flatMap(([name, value]) => [name, value].map((content, i) => cell(i ? "b" : "span", content))),
    );
    const x = this.x(mode);
    const right = x > LEFT + this.width * 0.6;
    this.tip.style.left = right ? "auto" : `${x + 14}px`;
    this.tip.style.right = right ? `${this.host.clientWidth - x + 14}px` : "auto";
    this.tip.style.top = `${Math.max(this.y(exact.eigenvalues[mode]) - 90, TOP)}px`;
  }
}

/** Weyl's law, the solution of j = (area lambda + boundary sqrt(lambda)) / 4 pi. */
function weyl({ area, boundary }, j) {
  const half = boundary / 2;
  return ((Math.sqrt(half ** 2 + 4 * Math.PI * area * j) - half) / area) ** 2;
}

function cell(name, content) {
  const made = document.createElement(name);
  made.textContent = content;
  return made;
}

function element(name, attributes) {
  const made = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

/** At most about `most` round numbers between low and high. */
function ticks(low, high, most) {
  const rough = (high - low) / most || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough * 0.999);
  const out = [];
  for (let i = Math.ceil(low / step); i * step <= high * (1 + 1e-9); i++) out.push(Number((i * step).toPrecision(12)));
  return out;
}
