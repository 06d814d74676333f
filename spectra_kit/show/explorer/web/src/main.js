// The page: reads its data, then shows one mode at a time in every part.

import { change, count, error, off, short } from "./format.js";
import { bytesOf, column16, readGeometry } from "./payload.js";
import { Plot } from "./plot.js";
import { ratioFor } from "./speed.js";
import { Stage } from "./stage.js";
import { Table } from "./table.js";

const PAUSE = 120; // milliseconds without a step, after which plot and table follow a slow machine

const $ = (id) => document.getElementById(id);

/** Say on the page why there is nothing to see. */
function fail(message) {
  $("notice").textContent = message;
  $("notice").hidden = false;
  document.body.classList.add("failed");
}

function theme() {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const use = (isDark) => {
    document.documentElement.dataset.theme = isDark ? "dark" : "light";
    $("theme").setAttribute("aria-pressed", String(isDark));
  };
  let chosen = false;
  use(dark.matches);
  dark.addEventListener("change", () => chosen || use(dark.matches));
  $("theme").addEventListener("click", () => {
    chosen = true;
    use(document.documentElement.dataset.theme !== "dark");
  });
}

function head(facts) {
  const k = facts.exact.eigenvalues.length;
  const shown = facts.decimated
    ? `shown: ${count(facts.shown)} of ${count(facts.points)} points`
    : `${count(facts.points)} ${facts.points === 1 ? "point" : "points"}`;
  $("title").textContent = facts.title || "Laplace–Beltrami spectrum";
  const [low, high] = [0, k - 1].map((mode) => short(facts.exact.eigenvalues[mode], 4));
  const modes = k === 1 ? `1 mode · λ = ${low}` : `${k} modes · λ from ${low} to ${high}`;
  $("subtitle").textContent = `${shown} · ${modes} / length²`;
  const notes = [];
  if (facts.decimated)
    notes.push(
      `Shown: ${count(facts.shown)} of ${count(facts.points)} points; eigenvalues, residuals and errors are those of all.`,
    );
  notes.push("Functions times √area; values rounded to 1/65,534 of the range of their mode.");
  if (facts.stars) notes.push("Nodal lines run over triangles between neighbouring points.");
  if (facts.predicted)
    notes.push(`Differences below ${short((8 / 32767) * 100, 2)} % of a mode are not shown.`);
  if (facts.predicted)
    notes.push(`Signs, and bases within clusters of near-equal λ, of “${facts.names[1]}” chosen to look like “${facts.names[0]}”.`);
  for (const [i, modes] of [facts.exact, facts.predicted].entries())
    if (modes?.completeness) notes.push(`Modes of “${facts.names[i]}”: ${modes.completeness}.`);
  $("note").textContent = notes.join(" ");
}

function law({ boundary }) {
  if (!boundary) return "Weyl’s law, λ = 4πj / area";
  const [sign, kind] = boundary > 0 ? ["+", "free"] : ["−", "held"];
  return `Weyl’s law, j = (area λ ${sign} length √λ) / 4π, for a ${kind} boundary of length ${short(Math.abs(boundary), 4)}`;
}

/** The legend of what the plot shows, up to this eigenvalue. */
function legend(facts, top) {
  const items = [["exact", facts.names[0]]];
  if (facts.predicted) items.push(["predicted", facts.names[1]]);
  if (facts.exact.eigenvalues.length > 1) items.push(["weyl", law(facts)]);
  const visible = (spectrum) => spectrum?.residuals?.some((r) => top && r > 0.005 * top);
  if (visible(facts.exact) || visible(facts.predicted)) items.push(["bars", "residual: a true λ lies within"]);
  $("legend").replaceChildren(
    ...items.map(([kind, name]) => {
      const item = document.createElement("li");
      item.className = kind;
      item.textContent = name;
      return item;
    }),
  );
}

/** The colours below each view. */
function ramps(facts) {
  const bytes = Uint8Array.from(atob(facts.palette), (c) => c.charCodeAt(0));
  const pixels = new ImageData(256, 1);
  for (let i = 0; i < 256; i++) pixels.data.set([...bytes.subarray(3 * i, 3 * i + 3), 255], 4 * i);
  for (const ramp of document.querySelectorAll(".ramp")) ramp.getContext("2d").putImageData(pixels, 0, 0);
}

/** What is written in and below each view. */
function captions(facts, mode, words) {
  const { exact, predicted, comparison, colours, names } = facts;
  const partner = comparison?.partner[mode];
  $("moved").textContent = partner !== undefined && partner !== mode ? `its mode ${partner}` : "";
  const residual = (spectrum) => (spectrum.relative ? `relative residual ${short(spectrum.relative[mode], 2)}${spectrum.errors ? `, ${`error ${off(spectrum, mode)}`.replaceAll(" ", "\u00a0")}` : ""}` : "not certified");
  const write = (view, title, first, second, limit) => {
    const part = (name) => $(view).querySelector(name);
    part("h2").firstChild.textContent = title;
    part(".first").textContent = first;
    part(".second").textContent = second;
    part(".low").textContent = `−${short(limit, 2)}`;
    part(".high").textContent = `+${short(limit, 2)}`;
  };
  write("view-exact", names[0], `λ = ${short(exact.eigenvalues[mode], 5)}`, residual(exact), colours.limit[mode]);
  words.textContent = `mode ${mode}, eigenvalue ${short(exact.eigenvalues[mode], 4)}`;
  if (!predicted) return;
  const relative = comparison.eigenvalue_error[mode] === null ? "" : ` (${change(facts, mode)})`;
  write(
    "view-predicted",
    names[1],
    `λ = ${short(predicted.eigenvalues[mode], 5)}${relative}`,
    residual(predicted),
    colours.limit[mode],
  );
  const size = comparison.cluster_size[mode];
  const hidden = colours.hidden[mode];
  write(
    "view-difference",
    "difference",
    hidden ? "below what this page can show" : `error ${error(comparison.cluster_error[mode])}${size > 1 ? `, cluster of ${size}` : ""}`,
    hidden ? `under ${short((8 / 32767) * 100, 2)} % of the mode` : `outside the span ${error(comparison.span_error[mode])}`,
    colours.difference[mode],
  );
}

async function main() {
  theme();
  const facts = JSON.parse($("facts").textContent);
  head(facts);
  if (typeof DecompressionStream === "undefined")
    return fail("This browser cannot unpack the data of this page: it has no DecompressionStream. Any browser of 2023 or later has.");
  const k = facts.exact.eigenvalues.length;
  const n = facts.shown;
  const [geometry, exact, predicted] = await Promise.all([
    bytesOf("geometry"),
    bytesOf("exact"),
    facts.predicted ? bytesOf("predicted") : null,
  ]);
  document.body.classList.toggle("single", !facts.predicted);
  let stage;
  try {
    stage = new Stage($("canvas"), facts, readGeometry(geometry, facts));
  } catch (error) {
    return fail(`This browser cannot draw in three dimensions: WebGL 2 is missing or switched off (${error.message}).`);
  }
  let mode = Math.min(facts.first, k - 1);
  const choose = (wanted) => {
    const next = Math.min(Math.max(Math.round(wanted) || 0, 0), k - 1);
    if (next === mode) return;
    mode = next;
    const { scale, limit, difference } = facts.colours;
    column16(exact, 0, n, mode, stage.surface.values[0]);
    if (predicted) column16(predicted, 0, n, mode, stage.surface.values[1]);
    stage.surface.change(scale[mode] / (limit[mode] || 1));
    for (const view of stage.views)
      view.gain = scale[mode] / ((view.which === 2 ? difference[mode] : limit[mode]) || 1);
    stage.invalidate();
    $("slider").value = mode;
    $("slider").setAttribute("aria-valuetext", `mode ${mode}, eigenvalue ${short(facts.exact.eigenvalues[mode], 5)}`);
    if (document.activeElement !== $("number") || Number($("number").value) !== mode) $("number").value = mode;
    $("previous").disabled = mode === 0;
    $("next").disabled = mode === k - 1;
    captions(facts, mode, $("words"));
    clearTimeout(following);
    if (stage.slow) following = setTimeout(follow, PAUSE);
    else follow();
  };
  // A processor that draws the views has no time left for the rest of the page at each step.
  let following;
  const follow = () => {
    plot.show(mode);
    table.show(mode);
  };
  const pick = (m) => {
    choose(m);
    clearTimeout(following);
    follow(); // what is clicked answers at once
  };
  const plot = new Plot($("plot"), facts, pick);
  const table = new Table($("table"), facts, pick);
  legend(facts, plot.top);
  ramps(facts);

  // Views that are on the page now.
  const arrange = () => {
    const views = [["view-exact", 0]];
    if (facts.predicted) views.push(["view-predicted", 1]);
    if (facts.predicted && $("difference").getAttribute("aria-pressed") === "true") views.push(["view-difference", 2]);
    document.body.dataset.views = views.length;
    $("view-difference").hidden = views.length < 3;
    stage.views = views.map(([id, which]) => ({ card: $(id), pane: $(id).querySelector(".pane"), which, gain: 1 }));
    const now = mode;
    mode = -1;
    choose(now);
    stage.resize();
  };
  controls(facts, stage, choose, () => mode, arrange);
  arrange();
  new ResizeObserver(() => stage.resize()).observe($("canvas"));
  document.body.classList.add("ready");
  window.explorer = { stage, choose, ratioFor }; // for the console, and for tests
}

function controls(facts, stage, choose, current, arrange) {
  const k = facts.exact.eigenvalues.length;
  for (const id of ["slider", "number"]) $(id).max = k - 1;
  $("of").textContent = `0 – ${k - 1}`;
  $("slider").addEventListener("input", () => choose($("slider").valueAsNumber));
  $("number").addEventListener("input", () => $("number").value !== "" && choose($("number").valueAsNumber));
  $("number").addEventListener("change", () => ($("number").value = current()));
  $("previous").addEventListener("click", () => choose(current() - 1));
  $("next").addEventListener("click", () => choose(current() + 1));
  const toggle = (id, act) =>
    $(id).addEventListener("click", () => {
      const on = $(id).getAttribute("aria-pressed") !== "true";
      $(id).setAttribute("aria-pressed", String(on));
      act(on);
    });
  $("difference").hidden = !facts.predicted;
  $("nodal").hidden = k === 1 || !(facts.faces || facts.stars); // the first mode has one sign
  toggle("difference", arrange);
  toggle("nodal", (on) => {
    stage.nodal = on;
    stage.invalidate();
  });
  const play = (on) => {
    stage.playing = on;
    $("play").setAttribute("aria-pressed", String(on));
    $("play").setAttribute("aria-label", on ? "Pause the wave" : "Play the wave");
    stage.invalidate();
  };
  toggle("wave", (on) => {
    stage.wave = on;
    stage.phase = 0;
    $("play").hidden = !on;
    play(on);
  });
  $("play").addEventListener("click", () => play(!stage.playing));
  $("reset").addEventListener("click", () => stage.reset());
  const keys = {
    ArrowLeft: () => choose(current() - 1),
    ArrowRight: () => choose(current() + 1),
    Home: () => choose(0),
    End: () => choose(k - 1),
    r: () => stage.reset(),
  };
  const tableKeys = { ArrowUp: () => choose(current() - 1), ArrowDown: () => choose(current() + 1) };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("input")) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const act = keys[key] ?? ($("table").contains(event.target) ? tableKeys[key] : undefined);
    if (!act) return;
    event.preventDefault();
    act();
  });
  $("slider").addEventListener("keydown", (event) => event.key.toLowerCase() === "r" && stage.reset());
}

main();
