// One row for each mode; a click shows it.

import { change, error, off, short } from "./format.js";

export class Table {
  constructor(host, facts, choose) {
    this.host = host;
    const { exact, predicted, comparison, names } = facts;
    const columns = [["mode", "Counted from 0", (m) => String(m)]];
    columns.push([`λ\u00a0${names[0]}`, "Eigenvalue, in 1 / length²", (m) => short(exact.eigenvalues[m], 5)]);
    if (predicted) {
      columns.push([`λ\u00a0${names[1]}`, "Eigenvalue of its partner, in 1 / length²", (m) => short(predicted.eigenvalues[m], 5)]);
      columns.push(["Δλ\u00a0/\u00a0λ", "Relative difference of the eigenvalues", (m) => change(facts, m)]);
    }
    const residual = "|L u − λ M u|, relative to λ or the spacing of eigenvalues";
    columns.push([predicted ? `residual ${names[0]}` : "relative residual", residual, (m) => short(exact.relative?.[m], 2)]);
    const known = "Relative error of the eigenvalue: at most (a bound, proved) or about (an estimate)";
    if (exact.errors) columns.push([predicted ? `error ${names[0]}` : "error", known, (m) => off(exact, m)]);
    if (!predicted) columns.push(["certified to ±", "Some true eigenvalue lies within this of λ", (m) => short(exact.residuals?.[m], 2)]);
    if (predicted) {
      columns.push([`residual ${names[1]}`, residual, (m) => short(predicted.relative?.[m], 2)]);
      if (predicted.errors) columns.push([`error ${names[1]}`, known, (m) => off(predicted, m)]);
      columns.push(["cluster error", "|u − v|², after the best rotation within the cluster of near-equal λ", (m) => error(comparison.cluster_error[m])]);
      columns.push(["span error", "Energy of the mode outside the span of the others’ modes", (m) => error(comparison.span_error[m])]);
    }
    const table = document.createElement("table");
    const head = table.createTHead().insertRow();
    for (const [name, meaning] of columns) {
      const cell = document.createElement("th");
      cell.scope = "col";
      cell.textContent = name;
      cell.title = meaning;
      head.append(cell);
    }
    const body = table.createTBody();
    this.rows = exact.eigenvalues.map((_, mode) => {
      const row = body.insertRow();
      row.dataset.mode = mode;
      for (const [, , text] of columns) row.insertCell().textContent = text(mode);
      return row;
    });
    body.addEventListener("click", (event) => {
      const row = event.target.closest("tr");
      if (row) choose(Number(row.dataset.mode));
    });
    host.append(table);
    this.head = table.tHead;
  }

  show(mode) {
    this.current?.removeAttribute("aria-current");
    this.current = this.rows[mode];
    this.current.setAttribute("aria-current", "true");
    // Scrolled within the table alone: the page stays where it is.
    const { offsetTop: top, offsetHeight: height } = this.current;
    const hidden = this.head.offsetHeight;
    const room = this.host.clientHeight;
    const above = top - this.host.scrollTop;
    if (above < hidden || above + height > room) this.host.scrollTop = top - hidden - (room - hidden - height) / 2;
  }
}
