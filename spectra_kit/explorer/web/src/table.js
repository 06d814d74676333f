// One row for each mode; a click shows it.

import { percent, short } from "./format.js";

export class Table {
  constructor(host, facts, choose) {
    this.host = host;
    const { exact, predicted, comparison, names } = facts;
    const columns = [["mode", (m) => String(m)]];
    columns.push([`λ ${names[0]}`, (m) => short(exact.eigenvalues[m], 5)]);
    if (predicted) {
      columns.push([`λ ${names[1]}`, (m) => short(predicted.eigenvalues[m], 5)]);
      columns.push(["difference of λ", (m) => percent(comparison.eigenvalue_error[m])]);
    }
    columns.push([predicted ? `residual ${names[0]}` : "relative residual", (m) => short(exact.relative?.[m], 2)]);
    if (!predicted) columns.push(["certified to ±", (m) => short(exact.residuals?.[m], 2)]);
    if (predicted) {
      columns.push([`residual ${names[1]}`, (m) => short(predicted.relative?.[m], 2)]);
      columns.push(["cluster error", (m) => short(comparison.cluster_error[m], 2)]);
      columns.push(["span error", (m) => short(comparison.span_error[m], 2)]);
    }
    const table = document.createElement("table");
    const head = table.createTHead().insertRow();
    for (const [name] of columns) {
      const cell = document.createElement("th");
      cell.scope = "col";
      cell.textContent = name;
      head.append(cell);
    }
    const body = table.createTBody();
    this.rows = exact.eigenvalues.map((_, mode) => {
      const row = body.insertRow();
      row.dataset.mode = mode;
      for (const [, text] of columns) row.insertCell().textContent = text(mode);
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
    if (top - hidden < this.host.scrollTop) this.host.scrollTop = top - hidden;
    else if (top + height > this.host.scrollTop + this.host.clientHeight)
      this.host.scrollTop = top + height - this.host.clientHeight;
  }
}
